"""Times of several solvers on one program, alternating."""

from __future__ import annotations

import pickle
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.neutral import Program
from benchmarks.solvers import SOLVERS
from benchmarks.worker import Failure, Worker

DEADLINE = 120.0
"""Seconds a peer may take for one set-up or one solve."""
COMPILATION = 600.0
"""Seconds allowed for the first solve of compiled code."""
TURN = 0.25
"""Seconds of solves before it is the next solver's turn."""
SET_UP = 12.0
"""Seconds of set-up after which no further beat is prepared."""

Say = Callable[[str], None]


def wanted(seconds: float) -> int:
    """How many solves are timed when one takes so long."""
    if seconds < 0.01:
        return 1000
    return 100 if seconds < 1.0 else 3


@dataclass
class Timed:
    """What is known of one solver on one program.

    Attributes
    ----------
    solver : str
    status : str
        Empty while all is well.
    setup : float
        Seconds of the first set-up.
    seconds : list of float
        Of each timed solve.
    objectives : dict
        Objective by beat.
    certified : dict
        Certified bound by beat, or None.
    outcomes : Counter
        Statuses of the solves.
    beats : int
        How many were prepared.
    most, wanted : int
        Most solves allowed, and solves to be timed.
    iterations : list of int
        Of each solve, where the solver tells.
    memory : float
        Peak memory of the process, MiB.
    """

    solver: str
    status: str = ""
    setup: float | None = None
    beats: int = 0
    most: int | None = None
    wanted: int = 0
    seconds: list[float] = field(default_factory=list)
    objectives: dict[int, float | None] = field(default_factory=dict)
    certified: dict[int, float | None] = field(default_factory=dict)
    outcomes: Counter[str] = field(default_factory=Counter)
    iterations: list[int] = field(default_factory=list)
    memory: float | None = None
    worker: Worker | None = None

    def want(self, seconds: float) -> None:
        """Ask for the number of solves that belongs to a time, if it is more than before."""
        number = wanted(seconds)
        self.wanted = max(self.wanted, number if self.most is None else min(number, self.most))

    def take(self, answer: dict[str, Any], beat: int, timed: bool = True) -> None:
        """Keep an answer; the beat is its place in the list of programs."""
        if timed:
            self.seconds.append(answer["seconds"])
        self.objectives[beat] = answer["objective"]
        self.certified[beat] = answer["certified"]
        self.outcomes[answer["status"]] += 1
        self.iterations += [answer["iterations"]] if "iterations" in answer else []

    def row(self, program: str) -> dict[str, Any]:
        """The row of the table, times in milliseconds."""
        times = 1e3 * np.array(self.seconds)
        status = self.status
        if not status:
            total = sum(self.outcomes.values())
            found = self.outcomes.most_common()
            status = found[0][0] if len(found) == 1 else ", ".join(f"{count}/{total} {word}" for word, count in found)
        return {
            "program": program,
            "solver": self.solver,
            "threads": 1,
            "solves": len(times),
            "setup_ms": None if self.setup is None else round(1e3 * self.setup, 3),
            "median_ms": round(float(np.median(times)), 4) if len(times) else None,
            "p99_ms": round(float(np.percentile(times, 99)), 4) if len(times) >= 100 else None,
            "objective": self.objectives.get(0),
            "certified": self.certified.get(0),
            "status": status,
        }


def compare(
    programs: Sequence[Program], solvers: Sequence[str], folder: Path, most: int | None, deadline: float, say: Say
) -> list[Timed]:
    """Time solvers on programs of one shape, each in its own process, turn by turn.

    Parameters
    ----------
    programs : sequence of Program
        The beats; solves go round them.
    solvers : sequence of str
        Names of `benchmarks.solvers.SOLVERS`.
    folder : Path
        Where the programs are put for the processes to read.
    most : int or None
        At most so many solves.
    deadline : float
        Seconds a peer may take for one set-up or one solve.
    say : callable
        Told what is going on.
    """
    path = folder / "programs.pickle"
    path.write_bytes(pickle.dumps(list(programs)))
    found = [Timed(name) for name in solvers]
    try:
        for timed in found:
            say(f"{timed.solver}: set-up")
            _guard(timed, partial(_start, timed, path, len(programs), most, deadline))
        running = [timed for timed in found if not timed.status]
        while running:
            for timed in running:
                say(f"{timed.solver}: {len(timed.seconds)} of {timed.wanted} solves")
                _guard(timed, partial(_turn, timed))
            running = [timed for timed in running if not timed.status and len(timed.seconds) < timed.wanted]
        for timed in found:
            if not timed.status:
                _guard(timed, partial(_weigh, timed))
    finally:
        for timed in found:
            if timed.worker is not None:
                timed.worker.close()
    return found


def _guard(timed: Timed, action: Callable[[], None]) -> None:
    try:
        action()
    except Failure as failure:
        timed.status = str(failure)


def _start(timed: Timed, path: Path, beats: int, most: int | None, deadline: float) -> None:
    timed.worker = worker = Worker(SOLVERS[timed.solver], path, deadline)
    own = timed.solver == "aerotube"
    spent = 0.0
    for beat in range(beats if most is None else min(beats, most)):
        taken = worker.ask("prepare", beat)
        timed.beats += 1
        timed.setup = taken if timed.setup is None else timed.setup
        spent += taken
        if spent > SET_UP:
            break
    # The first solve loads or compiles code and is not counted, unless solves are too slow for that to matter.
    answer = worker.ask("solve", 0, COMPILATION if own else None)
    if own:
        answer = worker.ask("solve", 0)
    timed.most = most
    timed.want(answer["seconds"])
    timed.take(answer, 0, timed=timed.wanted <= 3)


def _weigh(timed: Timed) -> None:
    assert timed.worker is not None
    timed.memory = timed.worker.ask("memory")


def _turn(timed: Timed) -> None:
    assert timed.worker is not None
    until = time.perf_counter() + TURN
    while len(timed.seconds) < timed.wanted:
        beat = len(timed.seconds) % timed.beats
        timed.take(timed.worker.ask("solve", beat), beat)
        timed.want(float(np.median(timed.seconds)))
        if time.perf_counter() > until:
            return
