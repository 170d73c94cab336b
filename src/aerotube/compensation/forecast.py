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
    beats = len(gain)
    fed_back = linear.B @ gain
    closed = step.copy()
    closed[:, :8, :8] = linear.A + fed_back
    added = fed_back @ noise @ np.swapaxes(fed_back, 1, 2)
    moment = np.empty((beats + 1, *start.shape))
    moment[0] = start
    for t in range(beats):
        moment[t + 1] = closed[t] @ moment[t] @ closed[t].T
        moment[t + 1, :8, :8] += added[t]
    return moment[:, :8, :8]


def _backward(
    linear: Linearisation, weights: Array, effort: Array, moment: Array, noise: Array, parts: tuple[Part, ...]
) -> tuple[Array, Array]:
    """Costs and best gains for given second moments: ndarrays (T + 1, 8, 8) and (T, 4, 8)."""
    beats = len(effort)
    cost, gain = np.empty((beats + 1, 8, 8)), np.zeros((beats, 4, 8))
    cost[beats] = weights[beats]
    blocks = []
    for part in parts:
        own, moved = np.ix_(part.errors, part.errors), np.ix_(part.controls, part.errors)
        controls = list(part.controls)
        heard = noise[:, part.errors][:, :, part.errors]
        best_guess = np.broadcast_to(np.eye(len(part.errors)), heard.shape)
        if heard.any():
            seen = moment[:beats, part.errors][:, :, part.errors]
            best_guess = np.swapaxes(np.linalg.solve(seen + heard, seen), 1, 2)
        # taken out of the whole matrices once, not in every step of the loop, which is short of time in flight
        A, B = linear.A[:, own[0], own[1]], linear.B[:, own[0], controls]
        blocks.append((own, moved, A @ best_guess, B, effort[:, controls][:, :, controls]))
    for t in range(beats - 1, -1, -1):
        for own, moved, A, B, R in blocks:
            pb = cost[t + 1][own] @ B[t]
            gain[t][moved] = -np.linalg.solve(R[t] + B[t].T @ pb, pb.T @ A[t])
        closed = linear.A[t] + linear.B[t] @ gain[t]
        value = weights[t] + closed.T @ cost[t + 1] @ closed + gain[t].T @ effort[t] @ gain[t]
        cost[t] = 0.5 * (value + value.T)
    return cost, gain
