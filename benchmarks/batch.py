"""A batch over beats and threads, beside compiled code that shares nothing between threads.

What two threads give depends on the machine as much as on the program: cores may share caches, clock and power, or be
other people's at times. The control does nothing but small Cholesky factorisations in its own memory, in as many pieces
of about the same length as the batch has programs, so that its scaling is what the machine has to offer.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numba import njit

from aerotube import sos
from benchmarks.neutral import Array, Program
from benchmarks.solvers import own

Say = Callable[[str], None]
ORDER = 48


@njit(cache=True, nogil=True)
def _control(matrix: Array, work: Array, repeats: int) -> float:
    """Factorise a matrix again and again, without memory of anyone else's."""
    n = matrix.shape[0]
    total = 0.0
    for _ in range(repeats):
        for j in range(n):
            for i in range(j, n):
                value = matrix[i, j]
                for k in range(j):
                    value -= work[i, k] * work[j, k]
                work[i, j] = np.sqrt(value) if i == j else value / work[j, j]
        total += work[n - 1, n - 1]
    return total


class Control:
    """The control kernel, in pieces of a given length.

    Parameters
    ----------
    pieces : int
    seconds : float
        Length of a piece, about.
    """

    def __init__(self, pieces: int, seconds: float) -> None:
        self._pieces = pieces
        self._matrix = np.eye(ORDER) + 0.5 / ORDER
        _control(self._matrix, np.zeros((ORDER, ORDER)), 1)
        start = time.perf_counter()
        _control(self._matrix, np.zeros((ORDER, ORDER)), 200)
        self._repeats = max(1, round(200 * seconds / (time.perf_counter() - start)))

    def run(self, threads: int) -> float:
        """Seconds for all pieces."""
        start = time.perf_counter()

        def piece(_: int) -> float:
            return float(_control(self._matrix, np.zeros((ORDER, ORDER)), self._repeats))

        if threads == 1:
            for k in range(self._pieces):
                piece(k)
        else:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(piece, range(self._pieces)))
        return time.perf_counter() - start


def measure(programs: Sequence[Program], threads: Sequence[int], solves: int | None, say: Say) -> list[dict[str, Any]]:
    """Rows of the table: the batch and the control, alternating, for each number of threads.

    Parameters
    ----------
    programs : sequence of Program
        Of one shape.
    threads : sequence of int
    solves : int or None
        Batches to be timed; by default as many as the table's rule asks for.
    say : callable
    """
    from benchmarks.timing import wanted

    start = time.perf_counter()
    structure, data = own.prepare_batch(programs)
    setup = time.perf_counter() - start
    sos.solve(structure, data)
    solution = sos.solve(structure, data)
    control = Control(len(programs), float(np.median(solution.seconds)))
    seconds: dict[tuple[str, int], list[float]] = {(w, t): [] for w in ("aerotube", "control") for t in threads}
    start = time.perf_counter()
    sos.solve(structure, data)
    rounds = wanted(time.perf_counter() - start)
    rounds = rounds if solves is None else min(rounds, solves)
    for k in range(rounds):
        say(f"batch: round {k} of {rounds}")
        for count in threads:
            start = time.perf_counter()
            solution = sos.solve(structure, data, workers=count)
            seconds["aerotube", count].append(time.perf_counter() - start)
            seconds["control", count].append(control.run(count))
    bound = float(np.sum(solution.certificate().bound))
    rows = []
    for (what, count), taken in seconds.items():
        times = 1e3 * np.array(taken)
        mine = what == "aerotube"
        rows.append(
            {
                "program": "batch",
                "solver": what,
                "threads": count,
                "solves": len(times),
                "setup_ms": round(1e3 * setup, 3) if mine else None,
                "median_ms": round(float(np.median(times)), 4),
                "p99_ms": round(float(np.percentile(times, 99)), 4) if len(times) >= 100 else None,
                "objective": float(np.sum(solution.objective)) if mine else None,
                "certified": bound if mine and np.isfinite(bound) else None,
                "status": _outcome(solution) if mine else "ran",
            }
        )
    return rows


def scaling(rows: Sequence[dict[str, Any]]) -> dict[int, tuple[float, float]]:
    """For each number of threads above one, how many times faster the batch and the control became."""
    found = {(row["solver"], row["threads"]): row["median_ms"] for row in rows}
    return {
        count: (found[what, 1] / found[what, count], found["control", 1] / found["control", count])
        for what, count in found
        if what == "aerotube" and count > 1 and (what, 1) in found
    }


def _outcome(solution: sos.Solution) -> str:
    words = solution.describe().partition(": ")[2].rstrip(".")
    return "optimal" if np.all(solution.optimal) else words
