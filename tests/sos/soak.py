"""Random and deliberately nasty programs. A few in the tests, all of them by `python -m tests.sos.soak`.

Each seed is one program with one or several ailments. What must hold: no crash; every claimed optimum is feasible and
dual feasible in the program's own units, and agrees with the second solver where that claims one too; every claimed
infeasibility or unboundedness comes with a proof; data that are not finite are refused by name.
"""

from __future__ import annotations

import sys
from collections import Counter
from functools import lru_cache

import numpy as np
import pytest

from aerotube import sos
from aerotube.sos import Status
from aerotube.sos.residuals import adjoint, gram_values, matrix_value, moment_matrices

AILMENTS = (
    "none", "row scale", "column scale", "objective scale", "zero column", "infeasible", "nearly infeasible",
    "unbounded", "no objective", "equality", "everything scaled", "not finite",
)  # fmt: skip


@lru_cache(maxsize=1)
def structures():
    """A few shapes that hold every kind of constraint, with repeated ones among them."""
    out = []
    for domain, degree, size in (
        (sos.Sphere(3), 2, 3), (sos.Sphere(3), 4, 4), (sos.Ball(2), 4, 3), (sos.Interval(), 6, 4),
        (sos.Product(sos.Sphere(2), sos.Interval()), 4, 5), (sos.Product(sos.Ball(1), sos.Ball(1)), 2, 2),
    ):  # fmt: skip
        program = sos.Program()
        program.matrix("d", (size,))
        program.sos("first", domain, degree)
        program.sos("second", domain, degree)
        program.lmi("matrix", 3)
        program.norm("length", size)
        program.linear("rows", 4)
        out.append(program.compile())
    return tuple(out)


def program(seed):
    """Data of one program and its ailments; feasible and bounded before the ailments set in."""
    rng = np.random.default_rng([2024, seed])
    structure = structures()[rng.integers(len(structures()))]
    m = structure.size
    inside = rng.standard_normal(m)
    constraints = {}
    repeat = rng.random() < 0.2
    for c in structure.constraints:
        if c.kind == "sos":
            basis = structure.sampling(c.name).basis(structure.nodes(c.name))
            C = basis @ rng.standard_normal((basis.shape[1], m))
            square = 0.0
            for block in structure.sampling(c.name).blocks:
                L = rng.standard_normal((len(block.basis), len(block.basis)))
                square = square + block.weights * np.sum((block.rows @ L) ** 2, axis=1)
            constraints[c.name] = [square - C @ inside, C]
            if c.name == "second" and repeat:
                constraints["second"] = [a.copy() for a in constraints["first"]]
        elif c.kind == "lmi":
            F = rng.standard_normal((m, 3, 3)) * (rng.random((m, 1, 1)) < 0.7)
            F = F + np.swapaxes(F, 1, 2)
            L = rng.standard_normal((3, 3))
            constraints[c.name] = [L @ L.T - np.tensordot(inside, F, axes=1), F]
        elif c.kind == "norm":
            # A bound on all of d keeps the program bounded.
            constraints[c.name] = [np.eye(m), -inside, np.zeros(m), 1.0 + 3.0 * rng.random()]
        else:
            A = rng.standard_normal((4, m))
            constraints[c.name] = [A, A @ inside + rng.random(4)]
    objective = rng.standard_normal(m)
    names = rng.choice(AILMENTS, size=1 + (rng.random() < 0.4), replace=False)
    for name in names:
        objective = _sicken(str(name), rng, structure, objective, constraints, inside)
    return structure, objective, constraints, tuple(str(n) for n in names)


def _sicken(name, rng, structure, objective, constraints, inside):
    m = structure.size
    columns = {"first": 1, "second": 1, "matrix": 1, "rows": 0, "length": 0}
    if name == "row scale":
        key = str(rng.choice(list(columns)))
        factor = 10.0 ** rng.uniform(-8, 8)
        constraints[key] = [np.asarray(a) * factor for a in constraints[key]]
    elif name == "column scale":
        j, factor = rng.integers(m), 10.0 ** rng.uniform(-8, 8)
        objective = objective.copy()
        objective[j] *= factor
        for key in ("first", "second"):
            constraints[key][1][:, j] *= factor
        constraints["matrix"][1][j] *= factor
        constraints["length"][0][:, j] *= factor
        constraints["rows"][0][:, j] *= factor
    elif name == "objective scale":
        objective = objective * 10.0 ** rng.uniform(-8, 8)
    elif name == "zero column":
        j = rng.integers(m)
        for key in ("first", "second"):
            constraints[key][1][:, j] = 0.0
        constraints["matrix"][1][j] = 0.0
    elif name in ("infeasible", "nearly infeasible"):
        gap = 10.0 ** rng.uniform(-1, 1) if name == "infeasible" else 10.0 ** rng.uniform(-9, -5)
        sign = 1.0 if name == "infeasible" or rng.random() < 0.5 else -1.0
        a = rng.standard_normal(m)
        constraints["rows"][0][:2] = [a, -a]
        constraints["rows"][1][:2] = [a @ inside - sign * gap, -(a @ inside) - sign * gap]
    elif name == "unbounded":
        # Take away the bound on d; what is left may or may not hold the objective.
        constraints["length"][0][:] = 0.0
        constraints["length"][1] = np.zeros(m)
    elif name == "no objective":
        objective = np.zeros(m)
    elif name == "equality":
        a = rng.standard_normal(m)
        constraints["rows"][0][:2] = [a, -a]
        constraints["rows"][1][:2] = [a @ inside, -(a @ inside)]
    elif name == "everything scaled":
        factor = 10.0 ** rng.uniform(-8, 8)
        for key in constraints:
            constraints[key] = [np.asarray(a) * factor for a in constraints[key]]
        objective = objective * 10.0 ** rng.uniform(-8, 8)
    elif name == "not finite":
        constraints["matrix"][0] = constraints["matrix"][0].copy()
        constraints["matrix"][0][0, 1] = rng.choice([np.nan, np.inf, -np.inf])
    return objective


def check_optimum(structure, data, solution):
    """Feasibility from the certificate, dual feasibility and gap from the multipliers, in the program's own units."""
    objective, arrays = data.one(0)
    certificate = solution.certificate()
    for c in structure.constraints:
        size = _size(c.kind, arrays[c.name], solution.values)
        assert certificate.margins[c.name] >= -1e-6 * size, (c.name, float(certificate.margins[c.name]), size)
    inner = 0.0
    for c in structure.constraints:
        y, a = solution.multipliers[c.name], arrays[c.name]
        if c.kind == "sos":
            moments = moment_matrices(structure.sampling(c.name), y)
            assert all(np.linalg.eigvalsh(z)[0] >= -1e-7 * np.abs(z).max() for z in moments)
            inner += gram_values(structure.sampling(c.name), solution.grams[c.name]) @ y
        elif c.kind == "lmi":
            assert np.linalg.eigvalsh(y)[0] >= -1e-9 * np.abs(y).max()
            inner += np.sum(y * matrix_value(a, solution.values))
        elif c.kind == "norm":
            assert y[0] >= (1 - 1e-9) * np.linalg.norm(y[1:])
            inner += y[0] * (a["g"] @ solution.values + a["h"]) + y[1:] @ (a["A"] @ solution.values + a["b"])
        else:
            assert np.all(y >= 0)
            inner += y @ (a["b"] - a["A"] @ solution.values)
    # What the multipliers leave of stationarity moves the lower bound that they prove by left'd.
    left = np.abs(adjoint(structure, arrays, solution.multipliers) - objective) @ np.abs(solution.values)
    scale = np.abs(objective) @ np.abs(solution.values)
    # Without an objective there is nothing to bound.
    assert scale == 0.0 or left <= 1e-6 * scale, (left, scale)
    assert scale == 0.0 or inner <= 1e-6 * scale, (inner, scale)


def _size(kind, a, d):
    if kind == "sos":
        return float(np.max(np.abs(a["c"]) + np.abs(a["C"]) @ np.abs(d)))
    if kind == "lmi":
        return float(np.max(np.abs(a["F0"]) + np.tensordot(np.abs(d), np.abs(a["F"]), axes=1)))
    if kind == "norm":
        rows = np.abs(a["b"]) + np.abs(a["A"]) @ np.abs(d)
        return float(np.linalg.norm(rows) + np.abs(a["g"]) @ np.abs(d) + abs(a["h"]))
    return float(np.max(np.abs(a["b"]) + np.abs(a["A"]) @ np.abs(d)))


def _magnitudes(structure, arrays, solution):
    """Largest sum of magnitudes in the adjoint at the multipliers, their mass taken as one."""
    sizes = {
        c.name: {
            key: -np.abs(x) if c.kind == "linear" and key == "A" else np.abs(x) for key, x in arrays[c.name].items()
        }
        for c in structure.constraints
    }
    mass = sum(
        float(np.trace(y) if c.kind == "lmi" else y[0] if c.kind == "norm" else np.sum(y))
        for c in structure.constraints
        for y in (solution.multipliers[c.name],)
    )
    return float(np.max(adjoint(structure, sizes, {k: np.abs(y) for k, y in solution.multipliers.items()}))) / mass


def _price(structure, arrays, solution):
    """What relative violations of one would change the objective by, to first order."""
    total = 0.0
    for c in structure.constraints:
        y = solution.multipliers[c.name]
        mass = np.trace(y) if c.kind == "lmi" else y[0] if c.kind == "norm" else np.sum(np.abs(y))
        total += float(mass) * _size(c.kind, arrays[c.name], solution.values)
    return total


def trial(seed, second_opinion=True):
    """Run one seed; raise AssertionError if what must hold does not. Returns what happened."""
    structure, objective, constraints, names = program(seed)
    if "not finite" in names:
        with pytest.raises(ValueError, match="'matrix'"):
            structure.data(objective=objective, constraints=constraints)
        return "refused"
    data = structure.data(objective=objective, constraints=constraints)
    solution = sos.solve(structure, data)
    status = Status(int(solution.status))
    if status == Status.OPTIMAL:
        check_optimum(structure, data, solution)
    elif status == Status.INFEASIBLE:
        explanation = solution.explain()
        assert explanation.amount > 0
        # A proof reaches no further than the rounding of its own sums lets it.
        sums = _magnitudes(structure, data.one(0)[1], solution)
        assert explanation.doubt < max(1e-4, 1e3 * np.finfo(float).eps * sums / explanation.amount)
        assert not set(names) <= {"none", "no objective", "row scale", "objective scale"}
    elif status == Status.UNBOUNDED:
        assert "unbounded" in names
        assert objective @ solution.values < 0
    if second_opinion:
        other = sos.solve(structure, data, backend="clarabel")
        if status == Status.OPTIMAL and other.optimal and other.primal_residual < 1e-7:
            scale = max(float(np.abs(objective) @ np.abs(x.values)) for x in (solution, other))
            difference = abs(float(solution.objective - other.objective))
            # What the other solver's answer violates may gain it as much as our multipliers say.
            gained = other.primal_residual * _price(structure, data.one(0)[1], solution)
            assert difference <= 1e-5 * scale + gained, (solution.objective, other.objective)
        if {status, Status(int(other.status))} == {Status.OPTIMAL, Status.INFEASIBLE}:
            assert "nearly infeasible" in names or "scale" in " ".join(names), "the solvers disagree"
    return str(status)


def main(count=10_000):
    """Run all seeds, print what happened, and fail on the first broken promise."""
    outcomes = Counter()
    broken = []
    for seed in range(count):
        try:
            outcomes[trial(seed)] += 1
        except AssertionError as error:
            broken.append(seed)
            print(f"seed {seed} {program(seed)[3]}: {error}", flush=True)
        if (seed + 1) % 1000 == 0:
            print(f"{seed + 1} programs: {dict(outcomes)}, {len(broken)} broken", flush=True)
    print(f"{count} programs: {dict(outcomes)}; broken: {broken}")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main(*(int(x) for x in sys.argv[1:])))
