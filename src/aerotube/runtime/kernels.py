"""The error of one state from the nominal, compiled: the same numbers as `ErrorCoordinates`, in a microsecond."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from aerotube.aircraft.rigid_body import flow_angles, velocity_from_flow
from aerotube.numerics import quaternion_product

Array = NDArray[np.float64]


@njit(cache=True)
def _down(q0: float, q1: float, q2: float, q3: float) -> tuple[float, float, float]:
    return 2.0 * (q1 * q3 - q0 * q2), 2.0 * (q2 * q3 + q0 * q1), q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3


@njit(cache=True)
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
    out = np.empty(8)
    out[0], out[1], out[2], out[3] = speed - speed_n, alpha - alpha_n, state[8] - nominal[8], theta
    out[4], out[5], out[6], out[7] = beta - beta_n, state[7] - nominal[7], state[9] - nominal[9], phi
    return out


@njit(cache=True)
def moved(nominal: Array, error: Array) -> Array:
    """State components (10,), without position, at a relative error (8,) from a nominal: `ErrorCoordinates.retract`."""
    speed, alpha, beta = flow_angles((nominal[0], nominal[1], nominal[2]))
    u, v, w = velocity_from_flow(speed + error[0], alpha + error[1], beta + error[4])
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
    q0, q1, q2, q3 = quaternion_product((nominal[3], nominal[4], nominal[5], nominal[6]), turn)
    rates = (nominal[7] + error[5], nominal[8] + error[2], nominal[9] + error[6])
    return np.array([u, v, w, q0, q1, q2, q3, rates[0], rates[1], rates[2]])


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
def increments(gains: Array, state: Array, nominal: Array, relative: bool) -> tuple[Array, Array]:
    """Error (8,) and increments (4,) of a linear law (4, 8)."""
    error = difference(state, nominal, relative)
    out = np.zeros(4)
    for i in range(4):
        for j in range(8):
            out[i] += gains[i, j] * error[j]
    return error, out


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
