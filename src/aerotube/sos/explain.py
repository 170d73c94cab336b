"""Why a program is infeasible, in words, and for which decisions that is proven.

A solver's certificate of infeasibility is a set of multipliers Y_i, one for each constraint, whose weighted sum of
constraint values is sum_i <Y_i, value_i(d)> = -v + r'd, with v > 0 and a residual r that would be zero in exact
arithmetic. Multipliers in the dual cones make the sum non-negative wherever all constraints hold, so no decision with
|d|_1 < v / |r|_inf satisfies them: that radius is all that is proven, and beyond it there may be decisions that do.
With the multipliers scaled to total mass one, a decision violates some constraint by v - |r|_inf |d|_1 at least.

The multipliers are first moved into the cones, by as much as rounding may have left them outside, and v and r are
bounded with the rounding of their own evaluation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from aerotube.sos.accuracy import TINY, UNIT, accuracy
from aerotube.sos.certificate import least_eigenvalue
from aerotube.sos.residuals import adjoint, constant, moment_matrices
from aerotube.sos.solution import Status

# Share of the radius within which `Explanation.amount` is claimed.
_NEAR = 1e-3

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from aerotube.sos.basis import Sampling
    from aerotube.sos.domain import Array
    from aerotube.sos.program import Constraint, Structure
    from aerotube.sos.residuals import Arrays
    from aerotube.sos.solution import Solution


@dataclass(frozen=True, eq=False)
class Conflict:
    """A constraint's part in an infeasible program.

    Attributes
    ----------
    name : str
    kind : str
    share : float
        Its share of the multipliers' mass, 0 to 1.
    direction : array
        Where it binds: a point of the domain, the eigenvector of a matrix inequality, the direction of a norm's
        vector, or the weights of linear rows.
    """

    name: str
    kind: str
    share: float
    direction: Array


@dataclass(frozen=True, eq=False)
class Explanation:
    """Why a program is infeasible.

    Attributes
    ----------
    conflicts : tuple of Conflict
        Constraints that cannot hold together, the weightiest first.
    radius : float
        No decision whose entries add up in magnitude to less than this satisfies the constraints (sum-of-squares
        constraints: as sums of squares). inf where that is proven for every decision, 0 where nothing is proven.
    amount : float
        Decisions whose entries add up in magnitude to a thousandth of `radius` at most violate some constraint by at
        least this much, each in the units of its own data; a sum-of-squares constraint is violated by what must be
        added to the polynomial to make it one. 0 where nothing is proven.
    """

    conflicts: tuple[Conflict, ...]
    radius: float
    amount: float

    @property
    def doubt(self) -> float:
        """Inverse of the radius: 0 if the proof is for every decision, inf if there is none."""
        return float(np.inf) if self.radius == 0.0 else 1.0 / self.radius

    def __str__(self) -> str:
        parts = []
        for conflict in self.conflicts:
            place = np.array2string(conflict.direction, precision=3, suppress_small=True, max_line_width=200)
            squares = "as a sum of squares, " if conflict.kind == "sos" and len(self.conflicts) > 1 else ""
            parts.append(f"'{conflict.name}' ({squares}weight {conflict.share:.0%}, at {place})")
        what = ", ".join(parts)
        if len(parts) > 1:
            what += " cannot hold together"
        else:
            only_squares = any(conflict.kind == "sos" for conflict in self.conflicts)
            what += " cannot be written as a sum of squares" if only_squares else " cannot hold"
        if self.radius == 0.0:
            return f"The solver found the program infeasible, without proof after rounding: it seems that {what}."
        which = "it" if len(parts) == 1 else "one of them"
        least = f"by {self.amount:.3g} at least"
        if np.isinf(self.radius):
            return f"The program is infeasible: {what}; every decision violates {which} {least}."
        return (
            f"The program is infeasible for decisions below {self.radius:.3g} (sum of the entries' magnitudes): "
            f"{what}; those below {_NEAR * self.radius:.3g} violate {which} {least}."
        )


def explain(solution: Solution, position: tuple[int, ...] = ()) -> Explanation:
    """Explain an infeasible program of a batch.

    Raises
    ------
    ValueError
        If that program was not found infeasible.
    """
    status = Status(int(solution.status[position]))
    if status != Status.INFEASIBLE:
        raise ValueError(f"the program at {position} is not infeasible but {status}; there is nothing to explain.")
    data, structure = solution.data, solution.structure
    place = int(np.ravel_multi_index(position, data.batch)) if data.batch else 0
    _, arrays = data.one(place)
    multipliers = {name: np.asarray(value[position]) for name, value in solution.multipliers.items()}
    masses = {c.name: _mass(c, multipliers[c.name]) for c in structure.constraints}
    total = sum(masses.values())
    if not (np.isfinite(total) and total > 0.0 and all(np.all(np.isfinite(y)) for y in multipliers.values())):
        return Explanation((), 0.0, 0.0)
    scaled = {name: value / total for name, value in multipliers.items()}
    radius, amount = _proven(structure, arrays, scaled)
    conflicts = [
        Conflict(c.name, c.kind, masses[c.name] / total, _direction(structure, c, scaled))
        for c in structure.constraints
        if masses[c.name] > 1e-4 * total
    ]
    conflicts.sort(key=lambda conflict: -conflict.share)
    return Explanation(tuple(conflicts), radius, amount)


def _proven(structure: Structure, arrays: Arrays, multipliers: Mapping[str, Array]) -> tuple[float, float]:
    """Radius and amount that multipliers prove, all rounding taken against them; zeros if they prove nothing."""
    inside = {}
    for c in structure.constraints:
        moved = _into_cone(structure, c, multipliers[c.name])
        if moved is None:
            return 0.0, 0.0
        inside[c.name] = moved
    # The same sums with every term's magnitude: linear rows count negatively in the adjoint.
    sizes = {
        c.name: {
            key: -np.abs(x) if c.kind == "linear" and key == "A" else np.abs(x) for key, x in arrays[c.name].items()
        }
        for c in structure.constraints
    }
    magnitudes = {name: np.abs(y) for name, y in inside.items()}
    count = sum(y.size for y in inside.values()) + len(inside) + 4
    slip = UNIT * count * constant(structure, sizes, magnitudes) + TINY * count
    slips = UNIT * count * adjoint(structure, sizes, magnitudes)
    active = adjoint(structure, sizes, {name: np.ones_like(y) for name, y in inside.items()}) > 0.0
    value = -constant(structure, arrays, inside) - slip
    residual = np.max((np.abs(adjoint(structure, arrays, inside)) + slips + TINY * count) * active, initial=0.0)
    mass = sum(_mass(c, inside[c.name]) for c in structure.constraints) * (1.0 + UNIT * count)
    if not (value > 0.0 and mass > 0.0):
        return 0.0, 0.0
    radius = float(np.inf) if residual == 0.0 else (1.0 - 1e-9) * value / float(residual)
    return radius, (1.0 - _NEAR - 1e-9) * value / mass


def _into_cone(structure: Structure, c: Constraint, multiplier: Array) -> Array | None:
    """Nearby multiplier that is in the dual cone, rounding allowed for; None if none is found."""
    if c.kind == "linear":
        return np.maximum(multiplier, 0.0)
    if c.kind == "norm":
        inside = multiplier.copy()
        inside[0] = max(inside[0], float(np.linalg.norm(inside[1:])) * (1.0 + UNIT * (len(inside) + 4)) + TINY)
        return inside
    least: Callable[[Array], Array]
    if c.kind == "sos":
        found = structure.sampling(c.name)
        direction, least = found.interior, partial(_least_moments, found)
    else:
        multiplier = 0.5 * (multiplier + multiplier.T)
        direction, least = np.eye(c.size), least_eigenvalue
    own, reach = least(multiplier), least(direction)
    if not np.all(reach > 0.0):
        return None
    step = float(np.max(-own / reach, initial=0.0))
    for _ in range(8):
        inside = multiplier + step * direction
        if np.all(least(inside) >= 0.0):
            return np.asarray(inside)
        step = 1.5 * step + TINY
    return None


def _least_moments(found: Sampling, functional: Array) -> Array:
    """Lower bound of the least eigenvalue of every moment matrix of a functional on values at the nodes."""
    result = []
    for block, own in zip(moment_matrices(found, functional), accuracy(found).blocks, strict=True):
        slip = np.abs(functional) @ (own.slip + UNIT * (len(functional) + 4) * own.length)
        result.append(least_eigenvalue(block) - 1.000001 * slip - TINY * len(functional))
    return np.array(result)


def _mass(c: Constraint, multiplier: Array) -> float:
    if c.kind == "sos":
        # The functional's value at the constant polynomial 1.
        return max(float(np.sum(multiplier)), 0.0)
    if c.kind in ("lmi", "logdet"):
        return float(np.trace(multiplier))
    return float(multiplier[0]) if c.kind == "norm" else float(np.sum(multiplier))


def _direction(structure: Structure, c: Constraint, multipliers: Mapping[str, Array]) -> Array:
    multiplier = multipliers[c.name]
    if c.kind == "sos":
        return _point(structure, c, multiplier)
    if c.kind in ("lmi", "logdet"):
        return np.asarray(np.linalg.eigh(multiplier)[1][:, -1])
    if c.kind == "norm":
        return np.asarray(-multiplier[1:] / max(float(np.linalg.norm(multiplier[1:])), np.finfo(float).tiny))
    return np.asarray(multiplier / max(float(np.sum(multiplier)), np.finfo(float).tiny))


def _point(structure: Structure, c: Constraint, functional: Array) -> Array:
    """Return the point where the multiplier weighs most: the largest p'Mp over a fixed sample of the domain."""
    found = structure.sampling(c.name)
    moment = moment_matrices(found, functional)[0]
    points = np.concatenate([found.nodes, found.domain.sample(4000, seed=2)])
    rows = found.blocks[0].basis(points)
    return np.asarray(points[int(np.argmax(np.einsum("ui,ij,uj->u", rows, moment, rows, optimize=True)))])
