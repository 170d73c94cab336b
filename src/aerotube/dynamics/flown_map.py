r"""The error map of beats over whole sets, as it is flown: measured, realised as controls, stepped.

With z a point of a product of unit balls (`aerotube.dynamics.enclosure.BeatSet`), the error at the start, the
parameters, the measurement error v and the wind are affine in z; the law sees ``x + v``, its increments are realised as
controls within their limits at the state that is seen, and the aircraft flies one step with them held.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.dynamics.enclosure import BeatSet
from aerotube.dynamics.error_kernels import difference_each
from aerotube.dynamics.errors import ErrorCoordinates
from aerotube.dynamics.step import step

if TYPE_CHECKING:
    from aerotube.nominal import Nominal

Array = NDArray[np.float64]


class _Law(Protocol):
    def increments(self, beats: NDArray[np.intp], error: Array) -> Array:
        """Increments of the virtual controls (b, ..., 4) for errors (b, ..., 8)."""


def flown_map(
    aircraft: Aircraft,
    nominal: Nominal,
    beats: Sequence[int] | NDArray[np.intp],
    coordinates: ErrorCoordinates,
    over: BeatSet,
    points: Array,
    law: _Law | None = None,
) -> Array:
    """Errors at the end of beats, flown from points of their sets.

    Parameters
    ----------
    aircraft : Aircraft
        Any that can be stepped; by its compiled step where it has one.
    nominal : Nominal
    beats : sequence of int, length b
    coordinates : ErrorCoordinates
    over : BeatSet
        Of those beats, k variables.
    points : ndarray (b, u, k)
    law : optional
        With ``increments(beats, error)``; the nominal controls alone by default.

    Returns
    -------
    ndarray (b, u, 8)
        Not finite where the flight is not.
    """
    beats = np.asarray(beats)
    before, after = nominal.states[beats], nominal.states[beats + 1]

    def image(matrix: Array) -> Array:
        return np.asarray(points @ np.swapaxes(matrix, -1, -2))

    error = image(over.error)
    start, held = (
        coordinates.retract_each(before, error),
        np.repeat(nominal.controls[beats][:, None], points.shape[1], axis=1),
    )
    if law is not None:
        measured, seen = error, start
        if over.measurement is not None:
            measured = error + image(over.measurement)
            seen = coordinates.retract_each(before, measured)
        held = _realised(aircraft, seen, held, law.increments(beats, measured))
    sigma = over.parameters + image(over.parameter_reach)
    air = None if over.wind is None else image(over.wind)
    end = step(aircraft, start, held, nominal.dt, parameters=sigma, wind=air)
    return difference_each(end, after, coordinates.kind == "relative")


def _realised(aircraft: Aircraft, seen: Array, control: Array, increment: Array) -> Array:
    quick = aircraft.compiled_realise()
    if quick is None:
        return aircraft.realise(seen, control, increment)
    states, controls, moves = (
        np.ascontiguousarray(part).reshape(-1, part.shape[-1]) for part in (seen, control, increment)
    )
    moved = np.clip(quick(states, controls, moves), aircraft.control_lower, aircraft.control_upper)
    return np.asarray(moved.reshape(control.shape))
