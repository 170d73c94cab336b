r"""What is to be expected along the manoeuvre: which errors come, and what each will cost.

A law that is best for one beat alone must be told two things about the others: how large an error of each kind is
likely to be when the beat begins (noise is worth fighting only where the error is larger than the noise), and
what an error left at its end will cost. Both follow from the linearised loop. Its state
:math:`\xi = (x, \sigma, 1)` holds the errors and what lasts: the uncertain parameters, whose effect on a beat is
:math:`c_t`, and the constant, whose effect is the nominal's offset. With the law :math:`\hat a = K_t(x + v)`, noise
of covariance :math:`V_t` on the measurement, fresh errors of covariance :math:`W_t` at every beat (a small share of
the disturbance set: gusts, and whatever else no model knows of) and :math:`F_t = A_t + B_t K_t` in all of
:math:`\xi`,

.. math::

   M_{t+1} &= F_t M_t F_t^T + B_t K_t V_t K_t^T B_t^T + W_{t+1}, &\qquad
   P_t &= Q_t + F_t^T P_{t+1} F_t + K_t^T R K_t .

The law of a part i sees its own errors :math:`x_i` and moves its own controls :math:`B_i`; best for given M and P is

.. math::

   K_i = -(R_i + B_i^T P B_i)^{-1} B_i^T P \Bigl(A M_{\cdot i} + \sum_{j \ne i} B_j K_j M_{ji}\Bigr)
         (M_{ii} + V_{ii})^{-1} ,

where :math:`M_{\cdot i}` holds what a part's own error tells of everything else: of the other half's errors, which
went through the same coupled motion, and of the parameters, which made much of them. Forward and backward passes
are repeated, from the regulator on, and a step that would raise the expected cost is shortened; the fixed point is a
stationary point of that cost (static output feedback, W. S. Levine and M. Athans, *IEEE Trans. Automatic Control* 15
(1970) 44-48, in discrete time over a finite horizon, for the information pattern of the parts). The laws themselves
come from the programs on the nonlinear map, which know the limits and the worst case.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from aerotube.compensation.settings import Part
from aerotube.dynamics import Linearisation
from aerotube.tube.shapes import cost_to_go

Array = NDArray[np.float64]

_SHORTENINGS = 8


@dataclass(frozen=True)
class Forecast:
    """Expected errors and costs along a nominal trajectory.

    The state has the eight errors first, then what lasts: p parameters in units of their largest change, and one.

    Attributes
    ----------
    cost : ndarray (T + 1, 8 + p + 1, 8 + p + 1)
        P: what a state at the start of each beat will cost from there on.
    moment : ndarray (T + 1, 8 + p + 1, 8 + p + 1)
        M: its second moments.
    noise : ndarray (T, 8, 8)
        V: covariance of the measurement noise.
    step : ndarray (T, 8 + p + 1, 8 + p + 1)
        What a beat makes of the state without compensation.
    gain : ndarray (T, 4, 8)
        K, the law that was forecast.
    """

    cost: Array
    moment: Array
    noise: Array
    step: Array
    gain: Array


class _Loop(NamedTuple):
    """The linear system with its costs, all contiguous: N is the size of the state."""

    step: Array  # (T, N, N)
    moved: Array  # (T, N, 4)
    priced: Array  # (T + 1, N, N)
    effort: Array  # (T, 4, 4)
    noise: Array  # (T, 8, 8)
    fresh: Array  # (T + 1, N, N)
    start: Array  # (N, N)


def forecast(
    linear: Linearisation,
    weights: Array,
    effort: Array,
    half_widths: Array,
    effects: Array,
    noise_weight: float,
    fresh: float,
    parts: tuple[Part, ...],
    passes: int = 30,
    tolerance: float = 1e-4,
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
    fresh : float
        The same of the errors that come at every beat; positive.
    parts : tuple of Part
        The law of a part sees its errors and moves its controls only.
    passes : int
        Most rounds of forward and backward passes.
    tolerance : float
        They end when one lowers the expected cost by less than this share.

    Returns
    -------
    Forecast
    """
    beats, size = len(linear.A), 8 + effects.shape[1] + 1
    spread = np.zeros((beats + 1, size, size))
    spread[:beats, np.arange(8), np.arange(8)] = half_widths**2 / 3.0
    spread[beats] = spread[beats - 1]
    noise = noise_weight * spread[:beats, :8, :8]
    step = np.broadcast_to(np.eye(size), (beats, size, size)).copy()
    step[:, :8, :8] = linear.A
    step[:, :8, 8:-1] = np.swapaxes(effects, 1, 2)
    step[:, :8, -1] = linear.offset
    moved = np.zeros((beats, size, 4))
    moved[:, :8] = linear.B
    priced = np.zeros((beats + 1, size, size))
    priced[:, :8, :8] = weights
    spread[:] *= fresh
    start = spread[0] / fresh
    start[np.arange(8, size), np.arange(8, size)] = [*[1.0 / 3.0] * effects.shape[1], 1.0]
    errors, controls = (np.full((len(parts), most), -1) for most in (8, 4))
    mask = np.zeros((4, 8))
    for i, part in enumerate(parts):
        errors[i, : len(part.errors)], controls[i, : len(part.controls)] = part.errors, part.controls
        mask[np.ix_(part.controls, part.errors)] = 1.0
    loop = _Loop(*map(np.ascontiguousarray, (step, moved, priced, effort, noise, spread, start)))
    gain = cost_to_go(linear.A, linear.B, weights, effort, noise_weight)[1] * mask
    moment, expected = _forward(loop, gain)
    cost = np.empty_like(moment)
    for _ in range(passes):
        better = _backward(loop, moment, errors, controls, gain, cost)
        for shortening in range(_SHORTENINGS):
            tried = gain + 0.5**shortening * (better - gain)
            moment_tried, expected_tried = _forward(loop, tried)
            if expected_tried <= expected:
                break
        else:
            break
        gain, moment, before, expected = tried, moment_tried, expected, expected_tried
        if before - expected < tolerance * expected:
            break
    _costs(loop, gain, cost)
    return Forecast(cost=cost, moment=moment, noise=noise, step=step, gain=gain)


@njit(cache=True, nogil=True)
def _forward(loop: _Loop, gain: Array) -> tuple[Array, float]:
    """Second moments (T + 1, N, N) under given gains, and the expected cost."""
    beats = len(gain)
    moment = np.empty((beats + 1, *loop.start.shape))
    moment[0] = loop.start
    expected = 0.0
    for t in range(beats):
        fed_back = loop.moved[t] @ gain[t]
        closed = loop.step[t].copy()
        closed[:, :8] += fed_back
        heard = fed_back @ loop.noise[t]
        moment[t + 1] = closed @ moment[t] @ np.ascontiguousarray(closed.T) + loop.fresh[t + 1]
        moment[t + 1] += heard @ np.ascontiguousarray(fed_back.T)
        seen = np.ascontiguousarray(moment[t][:8, :8]) + loop.noise[t]
        moves = loop.effort[t] @ gain[t] @ seen
        expected += np.sum(loop.priced[t] * moment[t]) + np.sum(moves * gain[t])
    return moment, expected + np.sum(loop.priced[beats] * moment[beats])


@njit(cache=True, nogil=True)
def _cost_before(loop: _Loop, t: int, gain: Array, after: Array) -> Array:
    """P at the start of beat t, from that at its end and the beat's gain."""
    closed = loop.step[t].copy()
    closed[:, :8] += loop.moved[t] @ gain
    value = loop.priced[t] + np.ascontiguousarray(closed.T) @ after @ closed
    value[:8, :8] += np.ascontiguousarray(gain.T) @ loop.effort[t] @ gain
    return 0.5 * (value + value.T)


@njit(cache=True, nogil=True)
def _costs(loop: _Loop, gain: Array, cost: Array) -> None:
    beats = len(gain)
    cost[beats] = loop.priced[beats]
    for t in range(beats - 1, -1, -1):
        cost[t] = _cost_before(loop, t, gain[t], cost[t + 1])


@njit(cache=True, nogil=True)
def _backward(
    loop: _Loop,
    moment: Array,
    errors: NDArray[np.int64],
    controls: NDArray[np.int64],
    gain: Array,
    cost: Array,
) -> Array:
    """Best gains (T, 4, 8) for given second moments, last beat first, one part after the other; fills the costs.

    A part is a row of errors and one of controls, -1 behind its last.
    """
    beats, out = len(gain), gain.copy()
    cost[beats] = loop.priced[beats]
    for t in range(beats - 1, -1, -1):
        pulled = np.ascontiguousarray(loop.moved[t].T) @ cost[t + 1]
        own = loop.effort[t] + pulled @ loop.moved[t]
        drift = pulled @ loop.step[t] @ moment[t]
        for part in range(len(errors)):
            e, c = errors[part][errors[part] >= 0], controls[part][controls[part] >= 0]
            n, m = len(e), len(c)
            others = out[t].copy()
            for i in range(m):
                others[c[i]] = 0.0
            cross = drift[:, :8] + (own - loop.effort[t]) @ others @ np.ascontiguousarray(moment[t][:8, :8])
            right, seen, square = np.empty((m, n)), np.empty((n, n)), np.empty((m, m))
            for j in range(n):
                for i in range(m):
                    right[i, j] = cross[c[i], e[j]]
                for i in range(n):
                    seen[i, j] = moment[t, e[i], e[j]] + loop.noise[t, e[i], e[j]]
            for i in range(m):
                for j in range(m):
                    square[i, j] = own[c[i], c[j]]
            # both sides brought to order one first: newtons beside radians, metres beside radians
            u, w = 1.0 / np.sqrt(np.diag(square)), 1.0 / np.sqrt(np.diag(seen))
            k = np.linalg.solve(square * np.outer(u, u), right * np.outer(u, w))
            k = np.linalg.solve(seen * np.outer(w, w), np.ascontiguousarray(k.T))
            for i in range(m):
                for j in range(n):
                    out[t, c[i], e[j]] = -u[i] * w[j] * k[j, i]
        cost[t] = _cost_before(loop, t, out[t], cost[t + 1])
    return out
