r"""A decoupled synthesis that carries the other half's errors as a parameter.

Where the halves are designed apart, each takes the other's errors as zero. Carried, the other half's errors are an
uncertain parameter that ranges over the whole of its ellipsoid; of its boundary the two opposite points are taken
whose linear effect on the part is worst in its metric: the first right singular vector of
:math:`E_1^{1/2} A_{12} T_2`, either way. A program then has its constraints at both, twice as many as without: a mean
square is above both of them, a worst case above both at every extreme of the parameters.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aerotube.compensation.closed_loop import end_errors
from aerotube.compensation.task import Task

Array = NDArray[np.float64]
Beats = NDArray[np.intp]


def count(task: Task) -> int:
    """How many errors of the other parts a program is asked to withstand."""
    return 2 if task.settings.coupling == "carried" and len(task.settings.parts) > 1 else 1


def others_at_worst(task: Task, index: int, beats: Beats) -> Array:
    """Errors (b, 2, 8) of the other parts whose linear effect on a part is worst, its own zero."""
    part, ground = task.settings.parts[index], task.ground
    reach = np.zeros((len(beats), 8, 8))
    for other, own in zip(task.settings.parts, ground.parts, strict=True):
        if other is not part:
            errors = np.array(other.errors)
            reach[:, errors[:, None], errors] = own.initial.whitening[beats]
    root = np.swapaxes(np.linalg.cholesky(ground.parts[index].metric[beats]), 1, 2)
    effect = root @ ground.linear.A[beats][:, list(part.errors)] @ reach
    worst = np.linalg.svd(effect, full_matrices=False)[2][:, 0]
    point = (reach @ worst[..., None])[..., 0]
    return np.stack([point, -point], axis=1)


def map_values(task: Task, index: int, beats: Beats, points: Array) -> Array:
    """All errors (b, c k, U, 8) at the end without compensation, from points (b, U, n) of a part's own.

    One for each extreme of the parameters, for each of the `count` errors of the other parts in turn.
    """
    ground, part = task.ground, task.settings.parts[index]
    others: list[Array | None] = [None]
    if count(task) > 1:
        others = list(np.moveaxis(others_at_worst(task, index, beats), 1, 0))
    return np.concatenate(
        [
            end_errors(
                task.aircraft,
                task.nominal,
                beats,
                ground.coordinates,
                part,
                points,
                ground.vertices,
                others=other,
                of=tuple(range(8)),
            )
            for other in others
        ],
        axis=1,
    )
