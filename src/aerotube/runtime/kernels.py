"""The error of one state from the nominal, compiled: the same numbers as `ErrorCoordinates`, in a microsecond."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from aerotube.aircraft.rigid_body import flow_angles

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
