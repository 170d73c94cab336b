r"""What is to be expected along the manoeuvre: which errors come, and what each will cost.

A law that is best for one beat alone must be told two things about the others: how large an error of each kind is
likely to be when the beat begins (noise is worth fighting only where the error is larger than the noise), and
what an error left at its end will cost. Both follow from the linearised loop. With
:math:`F_t = A_t + B_t K_t`, noise of covariance :math:`V_t` on the measurement and the parameters' effect
:math:`c_t` on a beat (they last, so that errors and parameters grow correlated; second moments of
:math:`(x, \sigma)` are carried),

.. math::

   M_{t+1} &= F_t M_t F_t^T + B_t K_t V_t K_t^T B_t^T, &\qquad
   P_t &= Q_t + F_t^T P_{t+1} F_t + K_t^T R K_t, \\
   K_t &= -(R + B_t^T P_{t+1} B_t)^{-1} B_t^T P_{t+1} A_t M_t (M_t + V_t)^{-1} .

(and :math:`c_t` adds to the first line through the moments of :math:`(x, \sigma)`). The last line is the
regulator's gain times the best linear guess of the error from its measurement: the best gain for given M and P where
parameters and the other half leave the error alone. Forward and backward passes are repeated a few times, starting
from the regulator; without parameters and coupling, the fixed point is a stationary point of the expected cost (static
output feedback, W. S. Levine and M. Athans, *IEEE Trans. Automatic Control* 15 (1970) 44-48, in discrete time over a
finite horizon). Only M and P are handed on; the laws themselves come from the programs on the nonlinear map, which
know the limits and the worst case.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from aerotube.compensation.settings import Part
from aerotube.dynamics import Linearisation
from aerotube.tube.shapes import cost_to_go

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Forecast:
    """Expected errors and costs along a nominal trajectory.

    Attributes
    ----------
    cost : ndarray (T + 1, 8, 8)
        P: what an error at the start of each beat will cost from there on.
    moment : ndarray (T + 1, 8, 8)
        M: mean of ``x x'`` at the start of each beat.
    noise : ndarray (T, 8, 8)
        V: covariance of the measurement noise.
    """

    cost: Array
    moment: Array
    noise: Array


def forecast(
    linear: Linearisation,
    weights: Array,
    effort: Array,
    half_widths: Array,
    effects: Array,
    noise_weight: float,
    parts: tuple[Part, ...],
    passes: int = 3,
) -> Forecast:
    """Forecast errors and costs of a law yet to be computed.

    Parameters
    ----------
    linear : Linearisation
        Of T beats.
    weights : ndarray (T + 1, 8, 8)
        Q, the cost of an error.
    effort : ndarray (T, 4, 4)
        R, the cost of control; positive definite.
    half_widths : ndarray (T, 8)
        The disturbance box; errors at the start are uniform in it.
    effects : ndarray (T, p, 8)
        Error that each parameter's largest change adds in a beat; parameters are uniform and constant.
    noise_weight : float
        Mean square of the measurement noise over that of the disturbance box, not negative.
    parts : tuple of Part
        The law of a part sees its errors and moves its controls only.
    passes : int
        Rounds of forward and backward passes.

    Returns
    -------
    Forecast
    """
    beats, lasting = len(linear.A), effects.shape[1] + 1
    spread = np.zeros((beats, 8, 8))
    spread[:, np.arange(8), np.arange(8)] = half_widths**2 / 3.0
    noise = noise_weight * spread
    step = np.broadcast_to(np.eye(8 + lasting), (beats, 8 + lasting, 8 + lasting)).copy()
    step[:, :8, 8:-1] = np.swapaxes(effects, 1, 2)
    step[:, :8, -1] = linear.offset
    start = np.zeros((8 + lasting, 8 + lasting))
    start[:8, :8] = spread[0]
    start[np.arange(8, 8 + lasting), np.arange(8, 8 + lasting)] = [*[1.0 / 3.0] * effects.shape[1], 1.0]
    cost, gain = cost_to_go(linear.A, linear.B, weights, effort, noise_weight)
    moment = _forward(linear, step, start, gain, noise)
    for _ in range(passes):
        cost, gain = _backward(linear, weights, effort, moment, noise, parts)
        moment = _forward(linear, step, start, gain, noise)
    return Forecast(cost=cost, moment=moment, noise=noise)


def _forward(linear: Linearisation, step: Array, start: Array, gain: Array, noise: Array) -> Array:
    """Second moments of the errors under given gains: ndarray (T + 1, 8, 8)."""
    fed_back = linear.B @ gain
    closed = step.copy()
    closed[:, :8, :8] = linear.A + fed_back
    added = np.zeros_like(closed)
    added[:, :8, :8] = fed_back @ noise @ np.swapaxes(fed_back, 1, 2)
    moment = np.empty((len(gain) + 1, *start.shape))
    moment[0] = start
    _propagate(closed, added, moment)
    return moment[:, :8, :8]


@njit(cache=True, nogil=True)
def _propagate(closed: Array, added: Array, moment: Array) -> None:
    for t in range(len(closed)):
        moment[t + 1] = closed[t] @ moment[t] @ np.ascontiguousarray(closed[t].T) + added[t]


def _backward(
    linear: Linearisation, weights: Array, effort: Array, moment: Array, noise: Array, parts: tuple[Part, ...]
) -> tuple[Array, Array]:
    """Costs and best gains for given second moments: ndarrays (T + 1, 8, 8) and (T, 4, 8)."""
    beats = len(effort)
    cost, gain = np.empty((beats + 1, 8, 8)), np.zeros((beats, 4, 8))
    cost[beats] = weights[beats]
    guess = np.zeros((beats, 8, 8))
    errors, controls = (np.full((len(parts), size), -1) for size in (8, 4))
    for i, part in enumerate(parts):
        errors[i, : len(part.errors)], controls[i, : len(part.controls)] = part.errors, part.controls
        own = np.ix_(range(beats), part.errors, part.errors)
        guess[own] = np.eye(len(part.errors))
        heard = noise[own]
        if heard.any():
            seen = moment[:beats][own]
            guess[own] = np.swapaxes(np.linalg.solve(seen + heard, seen), 1, 2)
    A, B, weights, effort, guess = map(np.ascontiguousarray, (linear.A, linear.B, weights, effort, guess))
    _recur(A, B, weights, effort, guess, errors, controls, cost, gain)
    return cost, gain


@njit(cache=True, nogil=True)
def _recur(
    A: Array,
    B: Array,
    weights: Array,
    effort: Array,
    guess: Array,
    errors: NDArray[np.int64],
    controls: NDArray[np.int64],
    cost: Array,
    gain: Array,
) -> None:
    """Costs and gains, last beat first; a part is a row of errors and one of controls, -1 behind its last."""
    for t in range(len(A) - 1, -1, -1):
        for part in range(len(errors)):
            own, moved = errors[part][errors[part] >= 0], controls[part][controls[part] >= 0]
            n, m = len(own), len(moved)
            a, p, g = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
            b, r = np.empty((n, m)), np.empty((m, m))
            for i in range(n):
                for j in range(n):
                    a[i, j], p[i, j], g[i, j] = (
                        A[t, own[i], own[j]],
                        cost[t + 1, own[i], own[j]],
                        guess[t, own[i], own[j]],
                    )
                for j in range(m):
                    b[i, j] = B[t, own[i], moved[j]]
            for i in range(m):
                for j in range(m):
                    r[i, j] = effort[t, moved[i], moved[j]]
            turned = np.ascontiguousarray(b.T) @ p
            k = np.linalg.solve(r + turned @ b, turned @ (a @ g))
            for i in range(m):
                for j in range(n):
                    gain[t, moved[i], own[j]] = -k[i, j]
        closed = A[t] + B[t] @ gain[t]
        after, moves = np.ascontiguousarray(closed.T), np.ascontiguousarray(gain[t].T)
        value = weights[t] + after @ cost[t + 1] @ closed + moves @ effort[t] @ gain[t]
        cost[t] = 0.5 * (value + value.T)
