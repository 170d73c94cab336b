r"""Control limits on a law, where the law sees the errors.

A linear law's are closed forms: on a box of errors its largest increment is at a corner, on an ellipsoid it is a norm.
A polynomial law's go through the S-procedure (Eq. 12, of which the paper's Eq. 13 is the converse): for every control
and each side, :math:`a_{max} - \bar a - \hat a` is a sum of squares where the errors are, with a multiplier for every
weight of that domain: the ball of the ellipsoid, or the product of intervals of the box.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.compensation import monomials

if TYPE_CHECKING:
    from aerotube.compensation.law_program import GroupData, Scaling, Shape

Array = NDArray[np.float64]

_FEW = 5  # states up to which a box's corners are counted one by one
_EVEN = 0.75  # of a limit, shared out evenly to start from


def declare(program: sos.Program, shape: Shape) -> None:
    """Add the constraints to a program with a variable ``K``."""
    for i in range(shape.controls):
        if shape.limits == "none":
            return
        if shape.law_degree == 1:
            if _by_reach(shape):
                program.matrix(f"reach/{i}", (1, shape.states))
                program.linear(f"limit/{i}", rows=2 * shape.states + 1)
            elif shape.limits == "box":
                program.linear(f"limit/{i}", rows=2 * shape.corners or 2**shape.states)
            else:
                program.norm(f"limit/{i}", size=shape.states)
            continue
        box = [sos.Interval()] * shape.states
        domain = sos.Product(*box) if shape.limits == "box" else sos.Ball(shape.states)
        for side in ("above", "below"):
            program.sos(f"{side}/{i}", domain, degree=2 * ((shape.law_degree + 1) // 2))


def data(structure: sos.Structure, shape: Shape, group: GroupData, scaling: Scaling) -> dict[str, tuple[Array, ...]]:
    """Data of the constraints for a batch of programs."""
    if shape.limits == "none":
        return {}
    if shape.law_degree > 1:
        return _polynomial(structure, shape, group, scaling)
    relative = scaling.gain / np.minimum(-group.lower, group.upper)[:, :, None]
    if _by_reach(shape):
        return _reach(structure, group, relative)
    return _corners(structure, group, relative) if shape.limits == "box" else _norms(structure, group, relative)


def _by_reach(shape: Shape) -> bool:
    """Whether a linear law's limits on a box are written by what each error moves a control at most.

    A program has one row for each corner otherwise, which is less for few states, and far too many for eight.
    """
    return shape.limits == "box" and shape.law_degree == 1 and not shape.corners and shape.states > _FEW


def _reach(structure: sos.Structure, group: GroupData, relative: Array) -> dict[str, tuple[Array, ...]]:
    """Error j moves control i by some share of the limit at most, either way, and the shares add up to one at most.

    A share is ``reach_j`` more than an even one of less than the whole, so that where all are zero nothing is tight.
    """
    batch, m, _ = relative.shape
    n, K = group.seen.shape[-1], structure.variable("K")
    points = group.unwhitening * group.seen[:, None, :]  # (b, law's coordinates, errors)
    out: dict[str, tuple[Array, ...]] = {}
    for i in range(m):
        reach = structure.variable(f"reach/{i}")
        rows = np.zeros((batch, 2 * n + 1, structure.size))
        moved = np.einsum("ba,bkj->bjak", relative[:, i], points).reshape(batch, n, m * n)
        rows[:, :n, K.slice], rows[:, n : 2 * n, K.slice] = moved, -moved
        for j in range(n):
            rows[:, [j, n + j], reach.start + j] = -1.0
        rows[:, 2 * n, reach.slice] = 1.0
        room = np.full(2 * n + 1, _EVEN / n)
        room[2 * n] = 1.0 - _EVEN
        out[f"limit/{i}"] = (rows, room)
    return out


def _corners(structure: sos.Structure, group: GroupData, relative: Array) -> dict[str, tuple[Array, ...]]:
    batch, m, _ = relative.shape
    n, K = group.seen.shape[-1], structure.variable("K")
    signs = np.array([(1.0, *s) for s in itertools.product((1.0, -1.0), repeat=n - 1)])
    if group.corners.shape[1]:
        points = np.einsum("bij,bvj->bvi", group.unwhitening, group.corners)
    else:
        points = np.einsum("bij,bvj->bvi", group.unwhitening, signs * group.seen[:, None, :])
    points = np.concatenate([points, -points], axis=1)
    out: dict[str, tuple[Array, ...]] = {}
    for i in range(m):
        rows = np.zeros((batch, len(points[0]), structure.size))
        rows[..., K.slice] = np.einsum("ba,bvj->bvaj", relative[:, i], points).reshape(batch, -1, m * n)
        out[f"limit/{i}"] = (rows, np.ones(len(points[0])))
    return out


def _norms(structure: sos.Structure, group: GroupData, relative: Array) -> dict[str, tuple[Array, ...]]:
    batch, m, _ = relative.shape
    n, K = group.seen.shape[-1], structure.variable("K")
    out: dict[str, tuple[Array, ...]] = {}
    for i in range(m):
        rows = np.zeros((batch, n, structure.size))
        for j in range(n):
            rows[:, j, K.index[:, j]] = group.growth[:, None] * relative[:, i]
        out[f"limit/{i}"] = (rows, np.zeros(n), np.zeros(structure.size), np.ones(()))
    return out


def _polynomial(
    structure: sos.Structure, shape: Shape, group: GroupData, scaling: Scaling
) -> dict[str, tuple[Array, ...]]:
    nodes = structure.nodes("above/0")
    if shape.limits == "box":
        points = np.einsum("bij,buj->bui", group.unwhitening, nodes * group.seen[:, None, :])
    else:
        points = group.growth[:, None, None] * nodes
    table = monomials.values(points, monomials.exponents(shape.states, shape.law_degree))
    K, span = structure.variable("K"), 0.5 * (group.upper - group.lower)
    out: dict[str, tuple[Array, ...]] = {}
    for i in range(shape.controls):
        rows = np.zeros((*table.shape[:2], structure.size))
        relative = scaling.gain[:, i] / span[:, i, None]
        rows[..., K.slice] = np.einsum("ba,buj->buaj", relative, table).reshape(*table.shape[:2], -1)
        room = np.broadcast_to((group.upper / span)[:, i, None], table.shape[:2])
        out[f"above/{i}"] = (room, -rows)
        room = np.broadcast_to((-group.lower / span)[:, i, None], table.shape[:2])
        out[f"below/{i}"] = (room, rows)
    return out


def into(shape: Shape, group: GroupData, scaling: Scaling, solution: sos.Solution) -> Array:
    """Factors, at most one, that take out what the solver's tolerance left beyond the limits: ndarray (b, m).

    A polynomial law's come from the certificate of its limits, so that the limits hold whatever the solver said; a
    law for which it proves nothing gets zero.
    """
    values = scaling.gain @ solution["K"]
    if shape.limits == "none":
        return np.ones(values.shape[:2])
    if shape.law_degree > 1:
        return proven(solution, group.lower, group.upper)
    if shape.limits == "box" and shape.corners:
        most = np.abs(np.einsum("bij,bjk,bvk->biv", values, group.unwhitening, group.corners)).max(axis=-1)
    elif shape.limits == "box":
        most = np.sum(np.abs(values @ group.unwhitening) * group.seen[:, None, :], axis=-1)
    else:
        most = group.growth[:, None] * np.linalg.norm(values, axis=-1)
    limit = np.minimum(-group.lower, group.upper)
    return np.asarray(limit / np.maximum(most, limit))


def proven(solution: sos.Solution, lower: Array, upper: Array) -> Array:
    """Factors, at most one, that bring polynomial laws into limits which a certificate proves: ndarray (b, m).

    Parameters
    ----------
    solution : sos.Solution
        With constraints ``above/i`` and ``below/i`` in units of half the range of control i.
    lower, upper : ndarray (b, m)
    """
    span, margins = 0.5 * (upper - lower), solution.certificate().margins
    factors = []
    for side, room in (("above", upper), ("below", -lower)):
        beyond = np.stack([-margins[f"{side}/{i}"] for i in range(room.shape[1])], axis=1) * span
        beyond = np.maximum(np.nan_to_num(beyond, nan=np.inf), 0.0)
        factors.append(np.where(room > 0, room / np.where(room > 0, room + beyond, 1.0), beyond == 0))
    return np.asarray(np.minimum(*factors))
