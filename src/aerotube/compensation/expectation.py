r"""What a program of mean squares is told by the forecast, beyond the part's own motion.

A part's errors x at the start of a beat say something of everything else: the best linear guess of the other half's
errors and of what lasts (parameters) is :math:`C x` with :math:`C = M_{\cdot x} M_{xx}^{-1}`, see
:mod:`aerotube.compensation.forecast`. The state :math:`\xi^+` at the end of the beat is then

.. math:: \tilde r_\sigma(x) = r_\sigma(x) + D x, \qquad
          D = A_\xi C - A_{\xi x} + B_o K_o C_o ,

with the exact map :math:`r_\sigma` of the part's own errors at an extreme of the parameters, to which the guess of
everything else adds to first order; the other half flies the law that was forecast for it. It costs
:math:`\xi^{+T} P\, \xi^+`, of which the extremes' mean is taken: either sign of a parameter is as likely, what it
is likely to be given the error is in D. What is left beside the guess is uncorrelated with the error, and adds
nothing that a linear law can change.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerotube.compensation import carried
from aerotube.compensation.task import Task

Array = NDArray[np.float64]
Beats = NDArray[np.intp]


@dataclass(frozen=True)
class MeanSquare:
    """The expected cost at the end of beats: ``size + 2 cross u + u' own u`` for increments u, at points.

    Attributes
    ----------
    size : ndarray (b, c, U)
        For each of the c errors of the other parts that are carried.
    cross : ndarray (b, c, U, m)
    own : ndarray (b, m, m)
        Effort included.
    """

    size: Array
    cross: Array
    own: Array


def guess(task: Task, index: int, beats: Beats) -> Array:
    """Best linear guess C of the whole state from a part's errors: ndarray (b, N, n).

    Without the other parts' errors where the coupling is not the expected one.
    """
    part, moment = task.settings.parts[index], task.ground.expected.moment[beats]
    e, n = np.array(part.errors), len(part.errors)
    scale = 1.0 / np.sqrt(np.diagonal(moment, axis1=1, axis2=2)[:, e])
    seen = moment[:, e[:, None], e] * scale[:, :, None] * scale[:, None, :]
    out = np.swapaxes(np.linalg.solve(seen, scale[:, :, None] * moment[:, e]), 1, 2) * scale[:, None, :]
    out[:, e] = np.eye(n)
    if task.settings.coupling != "expected":
        out[:, [i for i in range(8) if i not in part.errors]] = 0.0
    return np.asarray(out)


def beyond_own(task: Task, index: int, beats: Beats) -> Array:
    """What the guess adds to the motion of a part's own errors: D, ndarray (b, N, n)."""
    part, expected = task.settings.parts[index], task.ground.expected
    e = list(part.errors)
    others = expected.gain[beats].copy()
    others[:, list(part.controls)] = 0.0
    guessed = guess(task, index, beats)
    out = expected.step[beats] @ guessed
    out[:, :8] += task.ground.linear.B[beats] @ others @ guessed[:, :8]
    out[:, :, :] -= expected.step[beats][:, :, e]
    return np.asarray(out)


def mean_square(task: Task, index: int, beats: Beats, points: Array, end: Array, input_map: Array) -> MeanSquare:
    """Expected cost of a part.

    Parameters
    ----------
    task : Task
    index : int
        Of the part.
    beats : ndarray (b,) of int
    points : ndarray (b, U, n)
        The part's errors at the start.
    end : ndarray (b, c k, U, 8)
        All errors at the end without compensation, as of :func:`aerotube.compensation.carried.map_values`.
    input_map : ndarray (b, k, 8, m)
        Their derivatives with respect to the part's controls, at the k extremes of the parameters.

    Returns
    -------
    MeanSquare
    """
    c = np.array(task.settings.parts[index].controls)
    metric = task.ground.parts[index].joint_metric[beats]
    count = carried.count(task)
    shape = len(beats), count, len(task.ground.vertices), points.shape[1], metric.shape[1]
    state = np.zeros(shape)
    state[..., :8] = end.reshape(*shape[:-1], 8)
    state += np.einsum("bij,buj->bui", beyond_own(task, index, beats), points)[:, None, None]
    priced = state @ metric[:, None, None]
    pushed = np.swapaxes(input_map, -1, -2) @ metric[:, None, :8, :8] @ input_map
    size = np.einsum("bckui,bckui->bcku", state, priced)
    cross = np.einsum("bckui,bkim->bckum", priced[..., :8], input_map, optimize=True)
    each = task.settings.extremes == "each"
    return MeanSquare(
        size=size.reshape(len(beats), -1, size.shape[3]) if each else size.mean(2),
        cross=cross.reshape(len(beats), -1, *cross.shape[3:]) if each else cross.mean(2),
        own=pushed.mean(1) + task.ground.effort[beats][:, c[:, None], c],
    )
