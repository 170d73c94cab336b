"""The flights of a session once more, on the nominal controls alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aerotube.dynamics.errors import ErrorCoordinates, euler_error
from aerotube.dynamics.step import step
from aerotube.runtime.record import Record
from aerotube.runtime.world import Truth, World

Array = NDArray[np.float64]


def fly_alone(world: World, truth: Truth, record: Record) -> Array:
    """The same manoeuvres, wind and parameters on the nominal controls alone: errors (manoeuvre, T + 1, 8)."""
    runs, beats = truth.flown_manoeuvres, world.beats
    nominal = nominal_of(record.nominal_state, record.nominal_end, runs, beats)
    controls = record.nominal_control[: runs * beats].reshape(runs, beats, 4)
    state = ErrorCoordinates("euler").retract(world.start, world.draws.initial_error[:runs])
    out = np.empty((runs, beats + 1, 8))
    out[:, 0] = euler_error(state, nominal[:, 0])
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for k in range(beats):
            state = step(
                world.aircraft,
                state,
                controls[:, k],
                world.dt,
                parameters=truth.parameters,
                wind=truth.wind[:, k],
                substeps=world.substeps,
            )
            out[:, k + 1] = euler_error(state, nominal[:, k + 1])
    return out


def nominal_of(state: Array, end: Array, manoeuvres: int, beats: int) -> Array:
    """The nominal as it was flown, of whole manoeuvres.

    Parameters
    ----------
    state, end : ndarray (g, 13)
        At the start and at the end of every beat.
    manoeuvres, beats : int

    Returns
    -------
    ndarray (manoeuvre, T + 1, 13)
    """
    count = manoeuvres * beats
    first = state[:count].reshape(manoeuvres, beats, -1)
    last = end[:count].reshape(manoeuvres, beats, -1)
    return np.concatenate([first, last[:, -1:]], axis=1)
