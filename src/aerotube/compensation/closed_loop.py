"""Where errors are at the end of a beat, with a law in the loop or without."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.compensation.settings import Part
from aerotube.dynamics import ErrorCoordinates, error_map
from aerotube.nominal import Nominal

Array = NDArray[np.float64]


class BatchLaw(Protocol):
    """A law that can be asked for many beats at once."""

    @property
    def coordinates(self) -> ErrorCoordinates:
        """Coordinates in which the law is given the error."""

    def increments(self, beats: NDArray[np.intp], error: Array) -> Array:
        """Increments of the virtual controls (b, ..., 4) for errors (b, ..., 8)."""


def end_errors(
    aircraft: Aircraft,
    nominal: Nominal,
    beats: NDArray[np.intp],
    coordinates: ErrorCoordinates,
    part: Part,
    start: Array,
    vertices: Array,
    law: BatchLaw | None = None,
    others: Array | None = None,
    of: tuple[int, ...] | None = None,
) -> Array:
    """Errors of a part at the end of beats.

    Parameters
    ----------
    aircraft : Aircraft
    nominal : Nominal
    beats : ndarray (b,) of int
    coordinates : ErrorCoordinates
    part : Part
    start : ndarray (b, u, n)
        Errors of the part at the start.
    vertices : ndarray (k, p)
        Values of the uncertain parameters.
    law : BatchLaw, optional
        None: the nominal controls alone.
    others : ndarray (b, 8), optional
        The other parts' errors at the start; zero by default.
    of : tuple of int, optional
        Indices of the errors that are asked for; the part's by default.

    Returns
    -------
    ndarray (b, k, u, n)
    """
    error = np.zeros((len(beats), 1, start.shape[1], 8))
    if others is not None:
        error += others[:, None, None]
    error[..., part.errors] = start[:, None]
    end = error_map(
        aircraft,
        nominal,
        beats,
        coordinates,
        error,
        increment=None if law is None else law.increments(beats, error),
        parameters=np.broadcast_to(vertices[None, :, None, :], (len(beats), len(vertices), 1, vertices.shape[1])),
    )
    return np.ascontiguousarray(end[..., part.errors if of is None else of])
