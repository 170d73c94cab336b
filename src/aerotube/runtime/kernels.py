"""What is done in every beat, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from aerotube.dynamics.error_kernels import difference, moved

Array = NDArray[np.float64]


@njit(cache=True)
def corrected(state: Array, nominal: Array, estimate: Array, gains: Array) -> tuple[Array, Array]:
    """A Kalman filter's estimate (8 + p + g,) after a measured state (n,), in relative coordinates, and its state."""
    innovation = difference(state, nominal, True) - estimate[:8]
    out = estimate + gains @ innovation
    guess = state.copy()
    guess[:10] = moved(nominal, out[:8])
    return out, guess


@njit(cache=True)
def plausible(state: Array, expected: Array, gate: Array, relative: bool) -> bool:
    """Whether a measured state (n,) is finite, an attitude and an airspeed, and within a gate (8,) of the expected."""
    if not np.isfinite(state).all():
        return False
    # so far from the unit sphere no attitude is measured; the airspeed is divided by
    length = state[3] ** 2 + state[4] ** 2 + state[5] ** 2 + state[6] ** 2
    speed = state[0] ** 2 + state[1] ** 2 + state[2] ** 2
    if abs(length - 1.0) > 0.1 or not 1.0 < speed < 1e8:
        return False
    return bool((np.abs(difference(state, expected, relative)) <= gate).all())


@njit(cache=True)
def increments(
    coefficients: Array,
    room: Array,
    reach: Array,
    factors: NDArray[np.int64],
    part_of: NDArray[np.int64],
    state: Array,
    nominal: Array,
    relative: bool,
) -> tuple[Array, Array]:
    """Error (8,) and increments (4,) of a law; see `aerotube.runtime.law` for its numbers and its form."""
    error = difference(state, nominal, relative)
    values = np.empty(coefficients.shape[1])
    values[:8] = error
    if len(factors):
        _monomials(error, reach, factors, part_of, values)
    out = np.zeros(4)
    for i in range(4):
        for j in range(len(values)):
            out[i] += coefficients[i, j] * values[j]
        # what is no number stays none, and is seen for it
        if out[i] < room[i, 0]:
            out[i] = room[i, 0]
        elif out[i] > room[i, 1]:
            out[i] = room[i, 1]
    return error, out


@njit(cache=True)
def _monomials(
    error: Array, reach: Array, factors: NDArray[np.int64], part_of: NDArray[np.int64], values: Array
) -> None:
    """Write the monomials (M,) of an error: beyond the set, of the error brought back, times how far it is out."""
    beyond = np.zeros(8)
    for i in range(8):
        z = 0.0
        for j in range(8):
            z += reach[i, j] * error[j]
        beyond[part_of[i]] += z * z
    for i in range(8):
        beyond[i] = max(np.sqrt(beyond[i]), 1.0)
    for i in range(8):
        values[i] = error[i] / beyond[part_of[i]]
    for row in range(len(factors)):
        values[8 + row] = values[factors[row, 0]] * values[factors[row, 1]]
    for i in range(8):
        values[i] = error[i]
    for row in range(len(factors)):
        values[8 + row] *= beyond[part_of[factors[row, 1]]]


@njit(cache=True)
def clamp(control: Array, nominal: Array, increment: Array, low: Array, high: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Controls (4,) within their limits, whatever was asked for, and where a limit that the nominal is off holds them.

    A control that is not finite becomes the nominal's.
    """
    out, held = np.empty(4), np.zeros(4, np.bool_)
    for i in range(4):
        wanted = control[i] if np.isfinite(control[i]) else nominal[i]
        out[i] = min(max(wanted, low[i]), high[i])
        inside = low[i] < nominal[i] < high[i]
        held[i] = inside and increment[i] != 0.0 and (out[i] <= low[i] or out[i] >= high[i])
    return out, held
