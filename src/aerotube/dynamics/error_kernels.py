"""Error coordinates compiled: the same numbers as `ErrorCoordinates`, in a microsecond a state."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from aerotube.aircraft.rigid_body import flow_angles, velocity_from_flow
from aerotube.numerics import quaternion_product

Array = NDArray[np.float64]


@njit(cache=True, nogil=True, forceinline=True)
def _down(q0: float, q1: float, q2: float, q3: float) -> tuple[float, float, float]:
    return 2.0 * (q1 * q3 - q0 * q2), 2.0 * (q2 * q3 + q0 * q1), q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3


@njit(cache=True, nogil=True)
def _difference(state: Array, nominal: Array, relative: bool, out: Array) -> None:
    speed, alpha, beta = flow_angles((state[0], state[1], state[2]))
    speed_n, alpha_n, beta_n = flow_angles((nominal[0], nominal[1], nominal[2]))
    d0, d1, d2 = _down(state[3], state[4], state[5], state[6])
    n0, n1, n2 = _down(nominal[3], nominal[4], nominal[5], nominal[6])
    if relative:
        level = np.hypot(n1, n2)
        cos_roll, sin_roll = (1.0, 0.0) if level < 1e-9 else (n2 / level, n1 / level)
        t0, t1, t2 = -n1 * sin_roll - n2 * cos_roll, n0 * sin_roll, n0 * cos_roll
        scale = 2.0 / (1.0 + (d0 * n0 + d1 * n1 + d2 * n2))
        theta = scale * (d0 * t0 + d1 * t1 + d2 * t2)
        phi = scale * (d1 * cos_roll - d2 * sin_roll)
    else:
        theta = np.arctan2(-d0, np.sqrt(d1 * d1 + d2 * d2)) - np.arctan2(-n0, np.sqrt(n1 * n1 + n2 * n2))
        phi = np.arctan2(d1 * n2 - d2 * n1, d1 * n1 + d2 * n2)
    out[0], out[1], out[2], out[3] = speed - speed_n, alpha - alpha_n, state[8] - nominal[8], theta
    out[4], out[5], out[6], out[7] = beta - beta_n, state[7] - nominal[7], state[9] - nominal[9], phi


@njit(cache=True, nogil=True)
def difference(state: Array, nominal: Array, relative: bool) -> Array:
    """Error (8,) of a state (n,) from a nominal one: `ErrorCoordinates.difference` of one state.

    Parameters
    ----------
    state, nominal : ndarray (13 or more,)
    relative : bool
        Attitude as a relative rotation, or else as differences of Euler angles.

    Returns
    -------
    ndarray (8,)
    """
    out = np.empty(8)
    _difference(state, nominal, relative, out)
    return out


@njit(cache=True, nogil=True)
def difference_each(state: Array, nominal: Array, relative: bool) -> Array:
    """Errors (b, u, 8) of states (b, u, n) from nominal ones (b, n)."""
    beats, count = state.shape[:2]
    out = np.empty((beats, count, 8))
    for beat in range(beats):
        for row in range(count):
            _difference(state[beat, row], nominal[beat], relative, out[beat, row])
    return out


@njit(cache=True, nogil=True)
def _moved(nominal: Array, error: Array, out: Array) -> None:
    speed, alpha, beta = flow_angles((nominal[0], nominal[1], nominal[2]))
    out[0], out[1], out[2] = velocity_from_flow((speed + error[0]), alpha + error[1], beta + error[4])
    d0, d1, d2 = _down(nominal[3], nominal[4], nominal[5], nominal[6])
    level = np.hypot(d1, d2)
    cos_roll, sin_roll = (1.0, 0.0) if level < 1e-9 else (d2 / level, d1 / level)
    half_theta, half_phi = 0.5 * error[3], 0.5 * error[7]
    scale = 1.0 / np.sqrt(1.0 + half_theta * half_theta + half_phi * half_phi)
    turn = (
        scale,
        -scale * half_phi * (-d1 * sin_roll - d2 * cos_roll),
        scale * (half_theta * cos_roll - half_phi * d0 * sin_roll),
        scale * (-half_theta * sin_roll - half_phi * d0 * cos_roll),
    )
    out[3], out[4], out[5], out[6] = quaternion_product((nominal[3], nominal[4], nominal[5], nominal[6]), turn)
    out[7], out[8], out[9] = nominal[7] + error[5], nominal[8] + error[2], nominal[9] + error[6]


@njit(cache=True, nogil=True)
def moved(nominal: Array, error: Array) -> Array:
    """State components (10,), without position, at a relative error (8,) from a nominal: `ErrorCoordinates.retract`."""
    out = np.empty(10)
    _moved(nominal, error, out)
    return out


@njit(cache=True, nogil=True)
def moved_each(nominal: Array, error: Array) -> Array:
    """States (b, u, n) at relative errors (b, u, 8) from nominal ones (b, n), what is no error as there."""
    beats, count = error.shape[:2]
    out = np.empty((beats, count, nominal.shape[1]))
    for beat in range(beats):
        for row in range(count):
            _moved(nominal[beat], error[beat, row], out[beat, row])
            out[beat, row, 10:] = nominal[beat, 10:]
    return out


@njit(cache=True, nogil=True)
def largest_tilts(nominal: Array, turns: Array, out: Array) -> None:
    """Largest tilts (b, 2) of states (b, n) turned by quaternions (b, k, 4): parts theta and phi of their errors."""
    error, state = np.empty(8), np.empty(nominal.shape[1])
    for beat in range(len(nominal)):
        state[:] = nominal[beat]
        out[beat] = 0.0
        for row in range(turns.shape[1]):
            state[3:7] = turns[beat, row]
            _difference(state, nominal[beat], True, error)
            out[beat, 0] = max(out[beat, 0], abs(error[3]))
            out[beat, 1] = max(out[beat, 1], abs(error[7]))
