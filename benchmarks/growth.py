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
CHAINS = (1, 3, 10, 30)


def _row(along: str, value: int, prepared: own.Prepared, solves: int, **options: int) -> dict[str, Any]:
    structure, data = prepared
    sos.solve(structure, data, **options)
    taken = []
    for _ in range(solves):
        start = time.perf_counter()
        solution = sos.solve(structure, data, **options)
        taken.append(time.perf_counter() - start)
    block = next(c for c in structure.constraints if c.kind == "sos")
    return {
        "along": along,
        "value": value,
        "nodes": block.size,
        "gram_order": len(structure.sampling(block.name).blocks[0].basis),
        "variables": structure.size,
        "programs": data.count,
        "threads": max(options.get("workers", 1), options.get("threads", 1)),
        "solves": solves,
        "median_ms": round(1e3 * float(np.median(taken)), 4),
        "iterations": round(float(np.mean(solution.iterations)), 2),
        "status": "optimal" if np.all(solution.optimal) else solution.describe(),
    }


def measure(programs: Sequence[Program], solves: int, say: Say, most_states: int = 10) -> list[dict[str, Any]]:
    """Rows for made-up systems of 2 to 10 states, degrees 2 to 8 at 4 states, and batches of the given programs.

    Also for threads inside one program of 8 states, and for programs that start from their neighbours.

    Parameters
    ----------
    programs : sequence of Program
        Beats of one shape, in the order of the manoeuvre, for the growth with beats, threads and chains.
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
            rows.append(_row("states", states, own.prepare(synthetic_map(states, 4)), solves))
    for degree in DEGREES:
        say(f"growth: degree {degree}")
        rows.append(_row("degree", degree, own.prepare(synthetic_map(4, degree)), solves))
    for beats in BEATS:
        chosen = [programs[i % len(programs)] for i in range(beats)]
        say(f"growth: {beats} beats")
        rows.append(_row("beats", beats, own.prepare_batch(chosen), solves))
    for threads in range(1, (os.cpu_count() or 1) + 1):
        say(f"growth: {threads} threads")
        chosen = [programs[i % len(programs)] for i in range(BEATS[-1])]
        rows.append(_row("threads", threads, own.prepare_batch(chosen), solves, workers=threads))
    eight = own.prepare(synthetic_map(min(8, most_states), 4))
    for threads in range(1, (os.cpu_count() or 1) + 1):
        say(f"growth: {threads} threads inside a program")
        rows.append(_row("threads inside", threads, eight, solves, threads=threads))
    for chain in CHAINS:
        say(f"growth: chains of {chain}")
        rows.append(_row("chain", chain, own.prepare_batch(programs[: BEATS[3]]), solves, chain=chain))
    return rows
