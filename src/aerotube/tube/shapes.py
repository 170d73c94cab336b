r"""In which shape the error at the end of a beat is measured: the matrix :math:`E_1` of the terminal ellipsoid.

Two choices are offered. ``riccati`` is the paper's (Eq. 8, in discrete time): the cost of the linear-quadratic
regulator that would fly on for ever as at this beat. ``cost-to-go`` is the cost of what will come: the backward
recursion along the trajectory,

.. math:: P_t = Q_t + A_t^T P_{t+1} A_t
          - A_t^T P_{t+1} B_t \left(R + (1+\nu) B_t^T P_{t+1} B_t\right)^{-1} B_t^T P_{t+1} A_t ,

in which :math:`\nu` counts what measurement noise, fed back, will add; the shape of beat t is
:math:`P_{t+1}`.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from aerotube.dynamics.components import split
from aerotube.dynamics.errors import ErrorCoordinates
from aerotube.errors import ComputationError, InputError
from aerotube.numerics import attitude

Array = NDArray[np.float64]

_DOUBLINGS = 40


def tracking_weights(states: Array, coordinates: ErrorCoordinates) -> Array:
    """Weights that make ``x' Q x`` the square of the paper's tracking error (Eq. 18), to first order.

    Parameters
    ----------
    states : ndarray (..., 13 or more)
        Nominal states.
    coordinates : ErrorCoordinates
        A tilt is ``cos(theta)`` times a roll difference; where the cosine is below a tenth, the roll difference
        means little and a tenth is taken.

    Returns
    -------
    ndarray (..., 8, 8)
        Diagonal. The metric is in hundreds of m/s and in degrees, and a mean over the eight components.
    """
    states = np.asarray(states, dtype=float)
    degrees = np.degrees(1.0)
    scale = np.broadcast_to([0.01, *[degrees] * 7], (*states.shape[:-1], 8)).copy()
    if coordinates.kind == "relative":
        _, pitch, _ = attitude.euler_from_quaternion(split(states[..., 3:7]))
        scale[..., 7] /= np.maximum(np.abs(np.cos(pitch)), 0.1)
    weights = np.zeros((*scale.shape, 8))
    weights[..., np.arange(8), np.arange(8)] = scale**2 / 8.0
    return weights


def riccati(A: Array, B: Array, Q: Array, R: Array) -> Array:
    """Cost matrices of the stationary regulator at each beat (Eq. 8, discrete).

    Parameters
    ----------
    A : ndarray (T, n, n)
    B : ndarray (T, n, m)
    Q : ndarray (T, n, n)
        Positive definite.
    R : ndarray (T, m, m)
        Positive definite.

    Returns
    -------
    ndarray (T, n, n)

    Raises
    ------
    ComputationError
        If the equation of a beat has no stabilising solution.
    """
    out, there = _doubled(A, B, Q, R)
    for beat in np.flatnonzero(~there):
        try:
            out[beat] = solve_discrete_are(A[beat], B[beat], Q[beat], R[beat])
        except (np.linalg.LinAlgError, ValueError) as error:
            raise ComputationError(
                f"shape: the Riccati equation of beat {beat} has no stabilising solution ({error}); use the "
                "shape 'cost-to-go', or other weights."
            ) from None
    return 0.5 * (out + np.swapaxes(out, -1, -2))


def _doubled(A: Array, B: Array, Q: Array, R: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Solutions of many equations at once by doubling, and where they are: residual small, closed loop stable.

    E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, C.-S. Wang, *Int. J. Control* 77 (2004) 767-788: each step doubles the horizon
    of the regulator whose cost it holds.
    """
    n = A.shape[-1]
    identity = np.eye(n)
    unit = 1.0 / np.sqrt(np.maximum(np.diagonal(Q, axis1=1, axis2=2), np.finfo(float).tiny))
    moved, pushed = A * unit[:, None, :] / unit[:, :, None], B / unit[:, :, None]
    weights = Q * unit[:, None, :] * unit[:, :, None]
    with np.errstate(all="ignore"):
        try:
            a, h = moved, weights
            g = pushed @ np.linalg.solve(R, np.swapaxes(pushed, 1, 2))
            for _ in range(_DOUBLINGS):
                inverse = np.linalg.solve(identity + g @ h, np.concatenate([a, g], axis=2))
                back = np.swapaxes(a, 1, 2)
                grown = h + back @ h @ inverse[:, :, :n]
                g = g + a @ inverse[:, :, n:] @ back
                a = a @ inverse[:, :, :n]
                done = np.abs(grown - h).max() <= 1e-15 * np.abs(grown).max()
                h = 0.5 * (grown + np.swapaxes(grown, 1, 2))
                if done:
                    break
            ph = np.swapaxes(pushed, 1, 2) @ h
            gain = np.linalg.solve(R + ph @ pushed, ph @ moved)
            closed = moved - pushed @ gain
            left = weights + np.swapaxes(moved, 1, 2) @ h @ closed - h
            small = np.abs(left).max((1, 2)) <= 1e-10 * np.abs(h).max((1, 2))
            there = small & np.isfinite(h).all((1, 2))
            stable = np.abs(np.linalg.eigvals(np.where(there[:, None, None], closed, 0.0))).max(1) < 1.0
        except np.linalg.LinAlgError:
            return np.empty_like(A), np.zeros(len(A), dtype=bool)
    return h / (unit[:, None, :] * unit[:, :, None]), there & stable


def cost_to_go(A: Array, B: Array, Q: Array, R: Array, noise_weight: float = 0.0) -> tuple[Array, Array]:
    """Backward Riccati recursion along a trajectory.

    Parameters
    ----------
    A : ndarray (T, n, n)
    B : ndarray (T, n, m)
    Q : ndarray (T + 1, n, n)
        The last is the cost at the end.
    R : ndarray (T, m, m)
        Positive definite.
    noise_weight : float
        The weight nu of fed-back noise, see the module's text; not negative.

    Returns
    -------
    cost : ndarray (T + 1, n, n)
        Cost matrices, the first at the start of beat 0.
    gain : ndarray (T, m, n)
        Gains K of the optimal law ``du = K x``.
    """
    if noise_weight < 0:
        raise InputError(f"shape: the noise weight is {noise_weight}; it must not be negative.")
    beats, n, m = B.shape
    cost, gain = np.empty((beats + 1, n, n)), np.empty((beats, m, n))
    cost[beats] = Q[beats]
    A, B, Q, R = (np.ascontiguousarray(x, dtype=float) for x in (A, B, Q, R))
    _recur(A, B, Q, R, float(noise_weight), cost, gain)
    return cost, gain


@njit(cache=True, nogil=True)
def _recur(A: Array, B: Array, Q: Array, R: Array, noise_weight: float, cost: Array, gain: Array) -> None:
    for t in range(len(B) - 1, -1, -1):
        back = np.ascontiguousarray(A[t].T)
        pb = cost[t + 1] @ B[t]
        met, seen = np.ascontiguousarray(B[t].T) @ pb, np.ascontiguousarray(pb.T) @ A[t]
        gain[t] = -np.linalg.solve(R[t] + (1.0 + noise_weight) * met, seen)
        value = Q[t] + back @ cost[t + 1] @ A[t] + back @ pb @ gain[t]
        cost[t] = 0.5 * (value + value.T)
