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
    rows = points.shape[:2]
    before, after = nominal.states[beats][:, None], nominal.states[beats + 1][:, None]
    held = np.broadcast_to(nominal.controls[beats][:, None], (*rows, nominal.controls.shape[1]))

    def image(matrix: Array) -> Array:
        return np.asarray(points @ np.swapaxes(matrix, -1, -2))

    error = image(over.error)
    start = coordinates.retract(before, error)
    if law is not None:
        measured, seen = error, start
        if over.measurement is not None:
            measured = error + image(over.measurement)
            seen = coordinates.retract(before, measured)
        held = aircraft.realise(seen, held, law.increments(beats, measured))
    sigma = over.parameters + image(over.parameter_reach)
    air = np.zeros((*rows, 6)) if over.wind is None else image(over.wind)
    quick = aircraft.compiled_step()
    if quick is None:
        end = step(aircraft, start, held, nominal.dt, parameters=sigma, wind=air)
    else:
        states, controls, parameters, wind = (
            np.ascontiguousarray(part.reshape(rows[0] * rows[1], -1)) for part in (start, held, sigma, air)
        )
        end = quick(states, controls, parameters, wind, nominal.dt, 1).reshape(*rows, -1)
    return coordinates.difference(end, after)
