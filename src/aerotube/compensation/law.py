"""Compensation laws: what a flight evaluates every beat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerotube.dynamics.errors import ErrorCoordinates

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LinearLaw:
    """Increments of the virtual controls, linear in the error: ``du = K_t x``.

    Attributes
    ----------
    gains : ndarray (T, 4, 8)
        From SI errors to increments of the virtual controls.
    coordinates : ErrorCoordinates
        In which the error is measured.
    """

    gains: Array
    coordinates: ErrorCoordinates

    def increment(self, beat: int, error: Array) -> Array:
        """Increments at a beat.

        Parameters
        ----------
        beat : int
        error : ndarray (..., 8)
            Measured error in the law's coordinates.

        Returns
        -------
        ndarray (..., 4)
        """
        return np.asarray(error) @ self.gains[beat].T

    def increments(self, beats: NDArray[np.intp], error: Array) -> Array:
        """Increments at many beats.

        Parameters
        ----------
        beats : ndarray (b,) of int
        error : ndarray (b, ..., 8)

        Returns
        -------
        ndarray (b, ..., 4)
        """
        return np.einsum("bij,b...j->b...i", self.gains[beats], error)
