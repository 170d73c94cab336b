"""Climbs on fitted quadratic maps over products of balls, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def climb_fits(
    points: Array,
    centre: Array,
    slopes: Array,
    bends: Array,
    form: Array,
    free: NDArray[np.bool_],
    balls: NDArray[np.int64],
    steps: int,
) -> Array:
    """Climb to large sizes of quadratic maps, from many points of many beats at once.

    A step goes to where the product of balls supports the gradient of the size.

    Parameters
    ----------
    points : ndarray (b, s, k)
        Where to start; moved in place.
    centre, slopes, bends : ndarray (b, n), (b, n, k), (b, n, c, c)
        The maps: ``centre + slopes z + z' bends z / 2``, the last in the first c variables.
    form : ndarray (b, n, n)
    free : ndarray (k,) of bool
        Variables that are not held at zero.
    balls : ndarray of int
        Their dimensions, k in all.
    steps : int

    Returns
    -------
    ndarray (b, s)
        Sizes of the maps where the climbs end.
    """
    beats, starts, size = points.shape
    count, curved = bends.shape[1], bends.shape[3]
    sizes = np.empty((beats, starts))
    bent, ahead, gradient = np.empty((count, curved)), np.empty(count), np.empty(size)
    end = np.empty(count)
    for beat in range(beats):
        for start in range(starts):
            z = points[beat, start]
            for step in range(steps + 1):
                for i in range(count):
                    value = centre[beat, i]
                    for j in range(size):
                        value += slopes[beat, i, j] * z[j]
                    for j in range(curved):
                        bend = 0.0
                        for m in range(curved):
                            bend += bends[beat, i, j, m] * z[m]
                        bent[i, j] = bend
                        value += 0.5 * bend * z[j]
                    end[i] = value
                for i in range(count):
                    value = 0.0
                    for j in range(count):
                        value += form[beat, i, j] * end[j]
                    ahead[i] = value
                if step == steps:
                    break
                for j in range(size):
                    value = 0.0
                    for i in range(count):
                        value += slopes[beat, i, j] * ahead[i]
                        if j < curved:
                            value += bent[i, j] * ahead[i]
                    gradient[j] = value if free[j] else 0.0
                _supported(gradient, balls, z)
            total = 0.0
            for i in range(count):
                total += end[i] * ahead[i]
            sizes[beat, start] = total
    return sizes


@njit(cache=True, nogil=True)
def _supported(gradient: Array, balls: NDArray[np.int64], point: Array) -> None:
    """Write the point of a product of balls that is farthest along a gradient (k,); zero along a zero gradient."""
    first = 0
    for size in balls:
        if size == 1:
            point[first] = np.sign(gradient[first])
        else:
            length = 0.0
            for i in range(first, first + size):
                length += gradient[i] * gradient[i]
            scale = 1.0 / np.sqrt(length) if length > 0.0 else 0.0
            for i in range(first, first + size):
                point[i] = scale * gradient[i]
        first += size
