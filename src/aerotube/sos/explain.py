"""Why a program is infeasible, in words.

The certificate of infeasibility is a set of multipliers, one for each constraint, whose weighted sum of constraint
values does not depend on d and is negative: sum_i <Y_i, value_i(d)> = -v for every d. With the multipliers scaled to
total mass one, every decision violates some constraint by v at least.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from aerotube.sos.residuals import adjoint, constant, moment_matrices
from aerotube.sos.solution import Status

if TYPE_CHECKING:
    from collections.abc import Mapping

    from aerotube.sos.domain import Array
    from aerotube.sos.program import Constraint, Structure
    from aerotube.sos.solution import Solution


@dataclass(frozen=True, eq=False)
class Conflict:
    """A constraint's part in an infeasible program.

    Attributes
    ----------
    name : str
    share : float
        Its share of the multipliers' mass, 0 to 1.
    direction : array
        Where it binds: a point of the domain, the eigenvector of a matrix inequality, the direction of a norm's
        vector, or the weights of linear rows.
    """

    name: str
    share: float
    direction: Array


@dataclass(frozen=True, eq=False)
class Explanation:
    """Why a program is infeasible.

    Attributes
    ----------
    conflicts : tuple of Conflict
        Constraints that cannot hold together, the weightiest first.
    amount : float
        Every decision violates some constraint by at least this much, each in the units of its own data.
    doubt : float
        Largest coefficient of d that rounding left in the contradiction, over `amount`; small if the proof is sharp.
    """

    conflicts: tuple[Conflict, ...]
    amount: float
    doubt: float

    def __str__(self) -> str:
        parts = []
        for conflict in self.conflicts:
            place = np.array2string(conflict.direction, precision=3, suppress_small=True, max_line_width=200)
            parts.append(f"'{conflict.name}' (weight {conflict.share:.0%}, at {place})")
        what = parts[0] + " cannot hold" if len(parts) == 1 else ", ".join(parts) + " cannot hold together"
        return f"The program is infeasible: {what}; every decision violates one of them by {self.amount:.3g} at least."


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
    multipliers = {name: value[position] for name, value in solution.multipliers.items()}
    masses = {c.name: _mass(structure, c, multipliers[c.name]) for c in structure.constraints}
    total = sum(masses.values())
    amount = -constant(structure, arrays, multipliers) / total
    doubt = float(np.max(np.abs(adjoint(structure, arrays, multipliers)), initial=0.0)) / total / amount
    conflicts = [
        Conflict(c.name, masses[c.name] / total, _direction(structure, c, multipliers))
        for c in structure.constraints
        if masses[c.name] > 1e-4 * total
    ]
    conflicts.sort(key=lambda conflict: -conflict.share)
    return Explanation(tuple(conflicts), amount, doubt)


def _mass(structure: Structure, c: Constraint, multiplier: Array) -> float:
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
