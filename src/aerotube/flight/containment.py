"""Whether flights keep what tubes promise: beats that start inside a tube's sets must end inside the tube.

A beat of a run *starts inside* if the errors of every part are in that part's initial ellipsoid, and the error of what
the law saw, the wind and the run's parameters are in their sets. Of those beats, any that ends outside a tube of its
beat is a *violation*; the others promise nothing, and are counted with the reason. (Altitude is no error state, and not
looked at: it moves the density a little.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from aerotube.flight.simulate import Trace

if TYPE_CHECKING:
    from aerotube.compensation import Tubes

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

#: Why a beat does not start inside.
REASONS = ("error", "measurement", "wind", "parameters")

#: The two shapes of a tube: its size in the synthesis's metric, and its terminal ellipsoid.
FORMS = ("size", "ellipsoid")

# Of sizes, and of the half-widths of boxes: beyond it a point is outside, within it is rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Containment:
    """Counts over runs, beat by beat.

    Attributes
    ----------
    flown : ndarray (T,) of int
        Runs that had not diverged at the start of the beat.
    inside : ndarray (T,) of int
        Of those, runs that started the beat inside every set.
    outside : ndarray (T, 4) of int
        Runs that did not, for each of `REASONS`; a run may have several.
    violated : ndarray (T, parts, 2) of int
        Of the runs that started inside, those that ended outside, for each of `FORMS`. None where there is no tube.
    worst : ndarray (T, parts, 2)
        Largest size at the end over the tube's, of the runs that started inside; NaN where there are none.
    """

    flown: Counts
    inside: Counts
    outside: Counts
    violated: Counts
    worst: Array


def containment(
    trace: Trace,
    parameters: Array,
    tubes: Tubes,
    ranges: Array,
    measurement: Array | None = None,
    wind: Array | None = None,
) -> Containment:
    """Count beats of flights that keep to the tubes of the law that was flown.

    Parameters
    ----------
    trace : Trace
        Of flights with that law, in its coordinates.
    parameters : ndarray (run, p)
        Of each run.
    tubes : Tubes
        Of all beats.
    ranges : ndarray (p, 2)
        For which the tubes hold.
    measurement : ndarray (8,) or (T, 8), optional
        Half-widths of the measurement errors for which they hold; none by default.
    wind : ndarray (6,) or (T, 6), optional
        Half-widths of the wind for which they hold; still air by default.

    Returns
    -------
    Containment
    """
    start, end = trace.error[:, :-1], trace.error[:, 1:]
    here = np.isfinite(start).all(axis=-1)
    tolerance = _ROUNDING * np.abs(ranges).max(axis=1)
    known = ((parameters >= ranges[:, 0] - tolerance) & (parameters <= ranges[:, 1] + tolerance)).all(axis=-1)
    within = {
        "error": _inside_all(start, tubes),
        "measurement": _inside_box(trace.seen - start, measurement),
        "wind": np.ones_like(here) if trace.wind is None else _inside_box(trace.wind, wind),
        "parameters": np.broadcast_to(known[:, None], here.shape),
    }
    inside = here & np.logical_and.reduce(list(within.values()))
    beats, parts = start.shape[1], len(tubes.parts)
    violated = np.zeros((beats, parts, len(FORMS)), dtype=np.int64)
    worst = np.full((beats, parts, len(FORMS)), np.nan)
    pairs = ((tubes.metric, tubes.size), (tubes.terminal_shape, tubes.terminal_rho))
    for i, part in enumerate(tubes.parts):
        for k, (shape, rho) in enumerate(pairs):
            ratio = _sizes(end[..., list(part.errors)], shape[:, i]) / rho[:, i]
            # a run that diverged within the beat is outside of any tube; without a tube the ratio is no number
            ratio = np.where(np.isfinite(end).all(axis=-1), ratio, np.where(np.isfinite(rho[:, i]), np.inf, np.nan))
            ratio = np.where(inside, ratio, np.nan)
            violated[:, i, k] = (ratio > 1.0 + _ROUNDING).sum(axis=0)
            worst[:, i, k] = np.where(np.isnan(ratio), -np.inf, ratio).max(axis=0)
    return Containment(
        flown=here.sum(axis=0),
        inside=inside.sum(axis=0),
        outside=np.stack([(here & ~within[reason]).sum(axis=0) for reason in REASONS], axis=-1),
        violated=violated,
        worst=np.where(np.isneginf(worst), np.nan, worst),
    )


def _inside_all(error: Array, tubes: Tubes) -> NDArray[np.bool_]:
    """Runs and beats (run, T) whose errors are in the initial ellipsoid of every part."""
    inside = [
        _sizes(error[..., list(part.errors)], tubes.initial_shape[:, i]) <= tubes.initial_rho[:, i] * (1 + _ROUNDING)
        for i, part in enumerate(tubes.parts)
    ]
    return np.asarray(np.logical_and.reduce(inside))


def _inside_box(values: Array, half_widths: Array | None) -> NDArray[np.bool_]:
    """Runs and beats (run, T) whose values (run, T, k) are in a box; of no width, if none is given."""
    widths = np.zeros(values.shape[-1]) if half_widths is None else np.asarray(half_widths, dtype=float)
    return np.asarray((np.abs(values) <= widths * (1 + _ROUNDING) + 1e-12).all(axis=-1))


def _sizes(error: Array, shape: Array) -> Array:
    """``x' E x`` of errors (run, T, n) with shapes (T, n, n): ndarray (run, T)."""
    return np.asarray(np.einsum("rti,tij,rtj->rt", error, shape, error, optimize=True))
