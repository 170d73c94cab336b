"""How the time of the project's solver grows with states, degree, beats and threads."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from aerotube import sos
from benchmarks.neutral import Program
from benchmarks.programs import synthetic_map
from benchmarks.solvers import own

Say = Callable[[str], None]
STATES = (2, 3, 4, 5, 6, 7, 8, 9, 10)
DEGREES = (2, 4, 6, 8)
BEATS = (1, 15, 30, 60, 120)


def _row(along: str, value: int, prepared: own.Prepared, workers: int, solves: int) -> dict[str, Any]:
    structure, data = prepared
    sos.solve(structure, data, workers=workers)
    taken = []
    for _ in range(solves):
        start = time.perf_counter()
        solution = sos.solve(structure, data, workers=workers)
        taken.append(time.perf_counter() - start)
    block = next(c for c in structure.constraints if c.kind == "sos")
    return {
        "along": along,
        "value": value,
        "nodes": block.size,
        "gram_order": len(structure.sampling(block.name).blocks[0].basis),
        "variables": structure.size,
        "programs": data.count,
        "threads": workers,
        "solves": solves,
        "median_ms": round(1e3 * float(np.median(taken)), 4),
        "iterations": round(float(np.mean(solution.iterations)), 2),
        "status": "optimal" if np.all(solution.optimal) else solution.describe(),
    }


def measure(programs: Sequence[Program], solves: int, say: Say, most_states: int = 10) -> list[dict[str, Any]]:
    """Rows for made-up systems of 2 to 10 states, degrees 2 to 8 at 4 states, and batches of the given programs.

    Parameters
    ----------
    programs : sequence of Program
        Beats of one shape, for the growth with beats and threads.
    solves : int
        Solves for each row; a third of it where they are slow.
    say : callable
    most_states : int
        Leave out larger systems.
    """
    rows = []
    for states in STATES:
        if states <= most_states:
            say(f"growth: {states} states")
            rows.append(_row("states", states, own.prepare(synthetic_map(states, 4)), 1, solves))
    for degree in DEGREES:
        say(f"growth: degree {degree}")
        rows.append(_row("degree", degree, own.prepare(synthetic_map(4, degree)), 1, solves))
    for beats in BEATS:
        chosen = [programs[i % len(programs)] for i in range(beats)]
        say(f"growth: {beats} beats")
        rows.append(_row("beats", beats, own.prepare_batch(chosen), 1, solves))
    for threads in range(1, (os.cpu_count() or 1) + 1):
        say(f"growth: {threads} threads")
        chosen = [programs[i % len(programs)] for i in range(BEATS[-1])]
        rows.append(_row("threads", threads, own.prepare_batch(chosen), threads, solves))
    return rows
