"""Solving one program or a batch."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from typing import Any

import numpy as np

from aerotube.sos.backends.result import Result
from aerotube.sos.domain import Array
from aerotube.sos.program import Data, Structure
from aerotube.sos.residuals import Arrays, adjoint, constant, log_determinants, primal_violation
from aerotube.sos.solution import Solution

BACKENDS = ("aerotube", "clarabel")


def solve(
    structure: Structure,
    data: Data,
    backend: str = "aerotube",
    *,
    deadline: float | None = None,
    workers: int = 1,
    threads: int = 1,
    chain: int = 1,
    tolerance: float = 1e-7,
    iterations: int = 100,
) -> Solution:
    """Solve a program, or every program of a batch.

    Parameters
    ----------
    structure : Structure
    data : Data
        Of this structure.
    backend : str
        ``"aerotube"``, the project's own interior-point method, or ``"clarabel"``, where that is installed.
    deadline : float, optional
        Seconds allowed for each program.
    workers : int
        Threads over the batch.
    threads : int
        Threads over the constraints of each program, where they are large (``"aerotube"`` only). The numbers do not
        depend on it.
    chain : int
        Programs of a batch in a row of which each starts from where the one before was on its way (``"aerotube"``
        only), which saves a quarter of the iterations where neighbours are alike, as the beats of a manoeuvre are.
        The numbers depend on it within the tolerance, not on `workers`: directions in which the objective is flat may
        come out otherwise, which is why laws are designed without.
    tolerance : float
        Gap asked for, over the larger of the objective and its bound (of a thousandth of what the data are scaled to,
        where both are smaller); feasibility is asked to a tenth of it. An offset in the data counts: of a function
        that varies little about a large value, the optimum is known to a share of the value.
    iterations : int
        Iterations allowed for each program.

    Returns
    -------
    Solution
        With the batch axes of `data`.

    Raises
    ------
    ValueError
        If the data are of another structure, hold a number that is not finite, or an option is unknown or not
        installed.
    """
    if data.structure != structure:
        raise ValueError("the data were made for another structure; make them with this structure's own data().")
    check_backend(backend)
    if deadline is not None and not deadline > 0.0:
        raise ValueError(f"the deadline must be positive, got {deadline} s.")
    if min(workers, threads, chain) < 1:
        raise ValueError(f"workers, threads and chain must be at least 1, got {workers}, {threads} and {chain}.")
    seconds = np.inf if deadline is None else deadline
    if backend == "aerotube":
        from aerotube.sos.backends import interior

        found = interior.solve(
            structure,
            data,
            tolerance=tolerance,
            seconds=seconds,
            iterations=iterations,
            workers=workers,
            threads=threads,
            chain=chain,
        )
        return Solution(structure, data, objective=objectives(data, found["values"]), backend=backend, **found)
    from aerotube.sos.backends import clarabel

    data.check()
    options: dict[str, Any] = {"tolerance": tolerance, "seconds": seconds, "iterations": iterations}

    def run(position: int) -> tuple[Result, float, tuple[float, float, float, float]]:
        objective, arrays = data.one(position)
        start = time.perf_counter()
        result = clarabel.solve_one(structure, objective, arrays, **options)
        seconds = time.perf_counter() - start
        return result, seconds, figures(structure, objective, arrays, result)

    if workers == 1 or data.count == 1:
        results = [run(i) for i in range(data.count)]
    else:
        from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

        with threadpool_limits(limits=1), ThreadPoolExecutor(workers) as pool:
            results = list(pool.map(run, range(data.count)))
    return _gather(structure, data, backend, results)


def check_backend(backend: str) -> None:
    """Refuse a backend that does not exist or is not installed.

    Raises
    ------
    ValueError
    """
    if backend not in BACKENDS:
        raise ValueError(f"there is no backend '{backend}'; choose one of {BACKENDS}.")
    if backend == "clarabel" and find_spec("clarabel") is None:
        raise ValueError("the backend 'clarabel' is not installed; install aerotube[clarabel], or choose 'aerotube'.")


def objectives(data: Data, values: Array) -> Array:
    """Objectives (...) of decisions (..., m), log-determinant terms included."""
    total = np.einsum("...j,...j->...", data.objective, values)
    for c in data.structure.constraints:
        if c.kind == "logdet":
            arrays = data.constraints[c.name]
            matrix = arrays["F0"] + np.einsum("...j,...jkl->...kl", values, arrays["F"])
            sign, size = np.linalg.slogdet(matrix)
            total = total - np.where(sign > 0, c.factor * size, -np.inf)
    return np.asarray(total)


def figures(
    structure: Structure, objective: Array, arrays: Arrays, result: Result
) -> tuple[float, float, float, float]:
    """Objective, relative primal residual, dual residual and gap of a result, from the program's own data."""
    primal = float(objective @ result.values) - log_determinants(structure, arrays, result.values)
    dual = -constant(structure, arrays, result.multipliers)
    for c in structure.constraints:
        if c.kind == "logdet":
            sign, size = np.linalg.slogdet(result.multipliers[c.name])
            dual += c.factor * (size + c.size * (1.0 - np.log(c.factor))) if sign > 0 else -np.inf
    stationarity = np.abs(adjoint(structure, arrays, result.multipliers) - objective)
    size = max(float(np.max(np.abs(objective), initial=0.0)), np.finfo(float).tiny)
    violation = primal_violation(structure, arrays, result.values, result.grams)
    gap = abs(primal - dual) / max(1.0, abs(primal), abs(dual)) if np.isfinite(primal) and np.isfinite(dual) else np.inf
    return primal, violation, float(np.max(stationarity, initial=0.0)) / size, gap


def _gather(structure: Structure, data: Data, backend: str, results: list[Any]) -> Solution:
    batch = data.batch

    def stack(parts: list[Any]) -> Array:
        array = np.asarray(parts, dtype=np.float64)
        return array.reshape(batch + array.shape[1:])

    first: Result = results[0][0]
    found = [r[0] for r in results]
    grams = {
        name: tuple(stack([r.grams[name][k] for r in found]) for k in range(len(blocks)))
        for name, blocks in first.grams.items()
    }
    return Solution(
        structure=structure,
        data=data,
        values=stack([r.values for r in found]),
        objective=stack([r[2][0] for r in results]),
        status=np.array([int(r.status) for r in found], dtype=np.int64).reshape(batch),
        iterations=np.array([r.iterations for r in found], dtype=np.int64).reshape(batch),
        seconds=stack([r[1] for r in results]),
        grams=grams,
        multipliers={name: stack([r.multipliers[name] for r in found]) for name in first.multipliers},
        primal_residual=stack([r[2][1] for r in results]),
        dual_residual=stack([r[2][2] for r in results]),
        gap=stack([r[2][3] for r in results]),
        backend=backend,
    )
