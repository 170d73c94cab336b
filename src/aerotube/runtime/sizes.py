"""What laws are worth on a nominal: sizes of their tubes, whether they help, and whether they keep the limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerotube.compensation import KINDS, flown_size
from aerotube.compensation.bounds import Beyond, whole_set
from aerotube.compensation.groundwork import control_room
from aerotube.compensation.sets import initial_ellipsoid
from aerotube.compensation.settings import Part
from aerotube.dynamics import flown_map
from aerotube.nominal import Nominal
from aerotube.runtime.law import Laws
from aerotube.runtime.task import Task
from aerotube.tube import DisturbanceBox, ellipsoid

Array = NDArray[np.float64]

_SMALL = 0.05  # share of the initial ellipsoids over which slopes are taken


@dataclass(frozen=True)
class Sized:
    """Certified sizes and what stands behind them, each (b, parts)."""

    size: Array
    kinds: NDArray[np.int64]


def sizes(task: Task, nominal: Nominal, beats: NDArray[np.intp], laws: Laws | None, metric: tuple[Array, ...]) -> Sized:
    """Sizes of the tubes of some beats, with laws of the whole nominal or without any."""
    law = None if laws is None else laws.batch(task.form, task.coordinates)
    size, names = flown_size(
        task.aircraft, nominal, task.disturbance, law, metric, task.settings, beats=beats, workers=task.workers
    )
    kinds = np.full(names.shape, -1)
    for number, kind in enumerate(KINDS):
        kinds[names == kind] = number
    return Sized(size, kinds)


def useful(
    task: Task, nominal: Nominal, beats: NDArray[np.intp], laws: Laws, metric: tuple[Array, ...]
) -> NDArray[np.bool_]:
    """Where laws leave errors no larger than the nominal alone, to first order and measured exactly: (b, parts)."""
    parts = task.settings.parts
    over = whole_set(task.aircraft, nominal.states[beats], task.disturbance, task.coordinates, parts, Beyond())
    side = np.zeros((2, 8, sum(over.balls)))
    side[0, :, :8] = _SMALL * np.eye(8)
    side[1] = -side[0]
    points = np.broadcast_to(side.reshape(16, -1), (len(beats), 16, side.shape[2]))
    largest = []
    for law in (laws.batch(task.form, task.coordinates), None):
        ends = flown_map(task.aircraft, nominal, beats, task.coordinates, over, points, law)
        slopes = (ends[:, :8] - ends[:, 8:]) / (2.0 * _SMALL)
        own = [slopes[:, over.columns(part.name)][:, :, list(part.errors)] for part in parts]
        sizes = [
            np.linalg.eigvalsh(x @ form @ np.swapaxes(x, 1, 2))[:, -1] for x, form in zip(own, metric, strict=True)
        ]
        largest.append(np.stack(sizes, axis=1))
    return np.asarray(largest[0] <= largest[1])


def whole(task: Task, nominal: Nominal, beats: NDArray[np.intp], some: Laws | None) -> Laws:
    """Laws of all beats of the nominal: some given ones, zero elsewhere, with the room that the nominal leaves."""
    out = Laws.none(task.form, nominal.beats)
    if some is not None:
        out.coefficients[beats], out.reach[beats] = some.coefficients, some.reach
    if task.settings.saturation > 1.0:
        _, rooms = _seen_and_room(task, nominal, np.arange(nominal.beats))
        for part, room in zip(task.settings.parts, rooms, strict=True):
            out.room[:, part.controls] = np.stack(room, axis=-1)
    return out


def _seen_and_room(task: Task, nominal: Nominal, beats: NDArray[np.intp]) -> tuple[Array, list[tuple[Array, Array]]]:
    """Half-widths (b, 8) of the box of errors as they are measured, and each part's room for its controls."""
    widths = (1.0 + task.settings.measurement_error) * task.disturbance.half_widths
    seen = task.coordinates.box(nominal.states[beats], widths)
    return seen, control_room(task.aircraft, nominal, task.settings, task.coordinates, seen, beats)


def within_limits(task: Task, nominal: Nominal, beats: NDArray[np.intp], laws: Laws) -> NDArray[np.bool_]:
    """Whether each part's law keeps its controls where the settings want them, limits of rate included: (b, parts).

    On the disturbance box as it is measured, or the ellipsoid around it. A law that saturates always does.
    """
    settings = task.settings
    if settings.saturation > 1.0:
        return np.ones((len(beats), len(settings.parts)), bool)
    seen, rooms = _seen_and_room(task, nominal, beats)
    inside = []
    for part, (lower, upper) in zip(settings.parts, rooms, strict=True):
        limit = np.minimum(-lower, upper)
        own = laws.coefficients[beats][:, list(part.controls)]
        most = _most_in_ellipsoid if settings.limits == "ellipsoid" else _most_in_box
        moved = most(task, nominal, beats, part, own, seen)
        inside.append((moved <= (1.0 + 1e-6) * limit + 1e-12).all(1))
    return np.stack(inside, axis=1)


def _most_in_box(
    task: Task, _nominal: Nominal, _beats: NDArray[np.intp], _part: Part, coefficients: Array, seen: Array
) -> Array:
    """Bound of the increments over a box of errors: (b, m); no monomial is larger there than at its corner."""
    largest = np.prod(seen[:, None] ** task.form.exponents, axis=2)
    return np.asarray(np.sum(np.abs(coefficients) * largest[:, None, :], axis=-1))


def _most_in_ellipsoid(
    task: Task, nominal: Nominal, beats: NDArray[np.intp], part: Part, coefficients: Array, seen: Array
) -> Array:
    """The same over the ellipsoid around the disturbances as they are measured; a norm for the linear terms."""
    states, errors = nominal.states[beats], list(part.errors)
    initial = initial_ellipsoid(task.disturbance, task.coordinates, states, part)
    if isinstance(task.disturbance, DisturbanceBox):
        growth = (seen[:, errors] / initial.widths).max(-1)
    else:
        widths = task.settings.measurement_error * task.disturbance.half_widths
        growth = initial.seen_growth(task.coordinates.box(states, widths)[:, errors])
    linear = task.form.exponents.sum(axis=1) == 1
    slopes = coefficients[:, :, linear] @ task.form.exponents[linear].astype(float)
    moved = growth[:, None] * np.linalg.norm(slopes[:, :, errors] @ initial.whitening, axis=-1)
    around = np.zeros_like(seen)
    around[:, errors] = growth[:, None] * ellipsoid.half_widths(initial.shape, initial.rho)
    return np.asarray(moved + _most_in_box(task, nominal, beats, part, np.where(linear, 0.0, coefficients), around))
