"""Second opinions: the same programs through Clarabel, a general conic interior-point solver.

The program is handed over in its dual form, in the unknowns y of the sampled constraints: one equality for each
decision variable, and one matrix inequality sum_u y_u g(z_u) p_u p_u' >= 0 for each Gram matrix. The decision and the
Gram matrices come back as its multipliers. This has fewer unknowns than the Gram form and the same matrix cones.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerotube.sos.backends.result import Result
from aerotube.sos.domain import Array
from aerotube.sos.program import Constraint, Structure
from aerotube.sos.residuals import Arrays
from aerotube.sos.solution import Status

# Entries of a symmetric matrix in Clarabel's order: the lower triangle row by row, off-diagonal entries times sqrt(2).


def _packing(order: int) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    rows, columns = np.tril_indices(order)
    return rows, columns, np.where(rows == columns, 1.0, np.sqrt(2.0))


def _pack(matrix: Array) -> Array:
    rows, columns, scale = _packing(matrix.shape[-1])
    return np.asarray(matrix[..., rows, columns] * scale)


def _unpack(vector: Array, order: int) -> Array:
    rows, columns, scale = _packing(order)
    matrix = np.zeros((order, order))
    matrix[rows, columns] = matrix[columns, rows] = vector / scale
    return matrix


def _unknowns(c: Constraint) -> int:
    if c.kind in ("lmi", "logdet"):
        return c.size * (c.size + 1) // 2
    return c.size + 1 if c.kind == "norm" else c.size


def _column_data(c: Constraint, arrays: Any) -> tuple[Array, Array]:
    """Equality columns (unknowns, m) and objective (unknowns,) of a constraint's multiplier."""
    if c.kind == "sos":
        return arrays["C"], arrays["c"]
    if c.kind in ("lmi", "logdet"):
        return _pack(arrays["F"]).T, _pack(arrays["F0"])
    if c.kind == "norm":
        return np.vstack([arrays["g"], arrays["A"]]), np.concatenate([[arrays["h"]], arrays["b"]])
    return -arrays["A"], arrays["b"]


def solve_one(
    structure: Structure, objective: Array, arrays: Arrays, *, tolerance: float, seconds: float, iterations: int
) -> Result:
    """Solve one program.

    Parameters
    ----------
    structure : Structure
    objective : (m,)
    arrays : data of each constraint
    tolerance : float
        Relative gap and feasibility asked of Clarabel.
    seconds : float
        Time allowed (inf for no limit).
    iterations : int
        Iterations allowed.

    Raises
    ------
    ValueError
        If the program has log-determinant terms.
    """
    import clarabel
    from scipy import sparse

    if any(c.kind == "logdet" for c in structure.constraints):
        raise ValueError("the clarabel backend has no log-determinant terms; use backend='aerotube'.")
    m = structure.size
    objective, arrays, rows, column, beta = _balanced(structure, objective, arrays)
    starts: dict[str, int] = {}
    columns, costs = [], []
    total = 0
    for c in structure.constraints:
        starts[c.name] = total
        matrix, cost = _column_data(c, arrays[c.name])
        columns.append(matrix)
        costs.append(cost)
        total += _unknowns(c)
    scale = max(1e-300, float(np.max(np.abs(objective), initial=0.0))) if np.any(objective) else 1.0
    blocks = [sparse.csc_matrix(np.vstack(columns).T if columns else np.zeros((m, 0)))]
    right = [objective / scale]
    cones: list[Any] = [clarabel.ZeroConeT(m)]
    for c in structure.constraints:
        for matrix, cone in _cones(c, structure):
            place = sparse.csc_matrix(matrix)
            before = sparse.csc_matrix((matrix.shape[0], starts[c.name]))
            after = sparse.csc_matrix((matrix.shape[0], total - starts[c.name] - matrix.shape[1]))
            blocks.append(sparse.hstack([before, -place, after], format="csc"))
            right.append(np.zeros(matrix.shape[0]))
            cones.append(cone)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.direct_solve_method = "qdldl"
    settings.max_iter = iterations
    settings.tol_gap_rel = settings.tol_feas = tolerance
    # The data are scaled to one, but the optimum may be far smaller: only the relative gap counts.
    settings.tol_gap_abs = 1e-4 * tolerance
    settings.presolve_enable = settings.chordal_decomposition_enable = False
    cost = np.concatenate(costs) if costs else np.zeros(0)
    program = (
        sparse.csc_matrix((total, total)),
        cost,
        sparse.vstack(blocks, format="csc"),
        np.concatenate(right),
        cones,
    )
    begin = time.perf_counter()
    # Free unknowns have no pivot of their own, so the default regularisation of 1e-8 can stop at the first step.
    for regularisation in (1e-7, 1e-8, 1e-6):
        settings.static_regularization_constant = regularisation
        settings.time_limit = seconds - (time.perf_counter() - begin)
        answer = clarabel.DefaultSolver(*program, settings).solve()
        result = _result(structure, starts, answer, scale, tolerance)
        if result.status != Status.TROUBLE or settings.time_limit <= 0.0:
            break
    return _unbalanced(structure, result, rows, column, beta)


def _balanced(
    structure: Structure, objective: Array, arrays: Arrays
) -> tuple[Array, Arrays, dict[str, Array], Array, float]:
    """Scale rows, columns and constants to about one: objective, arrays, row scales, column scales, constant scale."""
    m = structure.size
    tables: list[Array] = []
    constants: list[Array] = []
    for c in structure.constraints:
        matrix, constant = _column_data(c, arrays[c.name])
        lines = np.abs(matrix) if c.kind == "linear" else np.max(np.abs(matrix), axis=0, keepdims=True)
        tables.append(lines)
        constants.append(np.abs(constant) if c.kind == "linear" else np.max(np.abs(constant), keepdims=True))
    table = np.concatenate([np.zeros((0, m)), *tables])
    constant = np.concatenate([np.zeros(0), *constants])
    used = table > 0.0
    logarithm = np.log(np.where(used, table, 1.0))
    column, row = np.zeros(m), np.zeros(len(table))
    for _ in range(6):
        row = -np.sum(used * (logarithm + column), axis=1) / np.maximum(np.sum(used, axis=1), 1)
        column = -np.sum(used * (logarithm + row[:, None]), axis=0) / np.maximum(np.sum(used, axis=0), 1)
    column = np.exp(column)
    row = np.max(table * column, axis=1, initial=0.0)
    row = 1.0 / np.where(row > 0.0, row, np.where(constant > 0.0, constant, 1.0))
    largest = float(np.max(constant * row, initial=0.0))
    beta = 1.0 / largest if largest > 0.0 else 1.0
    scaled: dict[str, dict[str, Array]] = {}
    rows: dict[str, Array] = {}
    at = 0
    for c, lines in zip(structure.constraints, tables, strict=True):
        e, a = row[at : at + len(lines)], arrays[c.name]
        at += len(lines)
        rows[c.name] = e
        if c.kind == "sos":
            scaled[c.name] = {"c": a["c"] * e * beta, "C": a["C"] * e * column}
        elif c.kind == "lmi":
            scaled[c.name] = {"F0": a["F0"] * e * beta, "F": a["F"] * e * column[:, None, None]}
        elif c.kind == "norm":
            scaled[c.name] = {
                "A": a["A"] * e * column, "b": a["b"] * e * beta, "g": a["g"] * e * column, "h": a["h"] * e[0] * beta,
            }  # fmt: skip
        else:
            scaled[c.name] = {"A": a["A"] * e[:, None] * column, "b": a["b"] * e * beta}
    return objective * column, scaled, rows, column, beta


def _unbalanced(structure: Structure, result: Result, rows: dict[str, Array], column: Array, beta: float) -> Result:
    """Undo the scaling of `_balanced`."""
    grams = {
        name: tuple(gram / (float(rows[name][0]) * beta) for gram in found) for name, found in result.grams.items()
    }
    multipliers = {
        c.name: result.multipliers[c.name] * (rows[c.name] if c.kind == "linear" else float(rows[c.name][0]))
        for c in structure.constraints
    }
    return Result(result.values * column / beta, grams, multipliers, result.status, result.iterations)


def _cones(c: Constraint, structure: Structure) -> list[tuple[Array, Any]]:
    """Rows (entries, unknowns) that must lie in a cone, and the cone, for one constraint's multiplier."""
    import clarabel

    if c.kind == "sos":
        out = []
        for block in structure.sampling(c.name).blocks:
            rows, cols, scale = _packing(block.rows.shape[1])
            entries = block.rows[:, rows] * block.rows[:, cols] * (block.weights[:, None] * scale)
            out.append((entries.T, clarabel.PSDTriangleConeT(block.rows.shape[1])))
        return out
    identity = np.eye(_unknowns(c))
    if c.kind == "lmi":
        return [(identity, clarabel.PSDTriangleConeT(c.size))]
    if c.kind == "norm":
        return [(identity, clarabel.SecondOrderConeT(c.size + 1))]
    return [(identity, clarabel.NonnegativeConeT(c.size))]


def _result(structure: Structure, starts: dict[str, int], answer: Any, scale: float, tolerance: float) -> Result:
    """Translate an answer: Clarabel's dual variables are the program's decision and Gram matrices."""
    x, z = np.array(answer.x), np.array(answer.z)
    status = {
        "Solved": Status.OPTIMAL,
        "DualInfeasible": Status.INFEASIBLE,
        "PrimalInfeasible": Status.UNBOUNDED,
        "MaxTime": Status.DEADLINE,
    }.get(str(answer.status), Status.TROUBLE)
    gap = abs(answer.obj_val - answer.obj_val_dual) / max(1e-3, abs(answer.obj_val), abs(answer.obj_val_dual))
    # Stalled, but within the factor that this project's own method allows itself as well.
    if status == Status.TROUBLE and max(gap, answer.r_prim, answer.r_dual) <= 10.0 * tolerance:
        status = Status.OPTIMAL
    values = z[: structure.size]
    offset = structure.size
    grams: dict[str, tuple[Array, ...]] = {}
    multipliers: dict[str, Array] = {}
    for c in structure.constraints:
        y = scale * x[starts[c.name] : starts[c.name] + _unknowns(c)]
        multipliers[c.name] = _unpack(y, c.size) if c.kind == "lmi" else y
        if c.kind == "sos":
            found = []
            for block in structure.sampling(c.name).blocks:
                order = block.rows.shape[1]
                length = order * (order + 1) // 2
                found.append(_unpack(z[offset : offset + length], order))
                offset += length
            grams[c.name] = tuple(found)
        else:
            offset += _unknowns(c)
    return Result(values, grams, multipliers, status, int(answer.iterations))
