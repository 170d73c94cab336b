"""The project's own interior-point method over a batch: threads, deadlines, and answers by name."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from aerotube.sos.domain import Array
from aerotube.sos.interior import run
from aerotube.sos.interior.layout import (
    FIRST,
    KIND,
    LAST,
    MATRICES,
    MATRIX,
    ORDER,
    ROWS,
    SOS,
    SPACE,
    VECTOR,
    VECTORS,
    Layout,
    State,
    flatten,
    layout,
    memory,
)  # fmt: skip
from aerotube.sos.program import Data, Structure
from aerotube.sos.solution import Status

# By the method's own number; its last, -1, is that of a solve that was still running.
_STATUS = np.array(
    [Status.OPTIMAL, Status.TROUBLE, Status.INFEASIBLE, Status.UNBOUNDED, Status.TROUBLE, Status.TROUBLE]
).astype(np.int64)
_PRIMAL, _DUAL, _GAP = 0, 1, 2
_LARGE = 150
"""Nodes of a constraint that is worth handing to another thread."""
_rooms: dict[tuple[Structure, int], list[State]] = {}
_lock = threading.Lock()


@contextmanager
def _room(structure: Structure, lay: Layout) -> Iterator[State]:
    """Memory of one solve, kept for the next one of the same structure."""
    key = (structure, 0)
    with _lock:
        free = _rooms.setdefault(key, [])
        state = free.pop() if free else None
    if state is None:
        state = memory(lay)
    try:
        yield state
    finally:
        with _lock:
            if len(free) < 8:
                free.append(state)


class _Together:
    """Threads that reduce the sampled constraints of one program at the same time.

    Most of an iteration goes into that where constraints are large; what one constraint's reduction yields does not
    depend on the others, so that the numbers are the same for any number of threads.
    """

    def __init__(self, lay: Layout, threads: int) -> None:
        sampled = np.flatnonzero(lay.con[KIND] == SOS)
        # The slowest first.
        self._order = [int(i) for i in sampled[np.argsort(-lay.con[ROWS, sampled], kind="stable")]]
        self._rooms = [np.empty(int(lay.at[SPACE])) for _ in range(min(threads, len(self._order)))]
        self._pool = ThreadPoolExecutor(max(1, len(self._rooms) - 1))

    @staticmethod
    def pays(lay: Layout) -> bool:
        """Whether two constraints at least are large enough to be worth handing over."""
        return int(np.sum((lay.con[KIND] == SOS) & (lay.con[ROWS] >= _LARGE))) > 1

    def proceed(self, lay: Layout, state: State, feasibility: float, optimality: float, limit: int) -> bool:
        """Take one iteration, as `run.proceed`."""
        if run.open_step(lay, state, feasibility, optimality):
            waiting = iter(self._order)

            def work(room: Array) -> None:
                # The iterator's next is one step of the interpreter, so that no two threads get the same constraint.
                for i in waiting:
                    run.reduce_one(lay, state, i, room)

            others = [self._pool.submit(work, room) for room in self._rooms[1:]]
            work(self._rooms[0])
            for other in others:
                other.result()
        return bool(run.close_step(lay, state, optimality, limit))

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown()


@dataclass(frozen=True)
class _Limits:
    """Accuracy asked for, seconds and iterations allowed, of each program."""

    tolerance: float
    seconds: float
    iterations: int


def _solve_one(
    lay: Layout, state: State, flat: Array, out: Array, limits: _Limits, together: _Together | None, warm: bool
) -> tuple[float, bool]:
    """Solve one program into `out`; return the seconds taken and whether the deadline stopped it.

    If warm, it starts from where the program that was solved before in this memory was on its way. Where that does
    not lead to an optimum, the program is solved afresh.
    """
    start = time.perf_counter()
    feasibility = min(1e-8, 0.1 * limits.tolerance)
    if np.isinf(limits.seconds) and together is None:
        run.through(lay, state, flat, warm, feasibility, limits.tolerance, limits.iterations, out)
        return time.perf_counter() - start, False
    warm, late = run.begin(lay, state, flat, warm), False
    # The clock is read after every iteration, and the next one is taken to last as long as the longest so far.
    longest, before = 0.0, time.perf_counter()
    while True:
        most = min(run.WARM_MOST, limits.iterations) if warm else limits.iterations
        if together is None:
            done = run.proceed(lay, state, feasibility, limits.tolerance, most, 1)
        else:
            done = together.proceed(lay, state, feasibility, limits.tolerance, most)
        if run.astray(lay, state, warm, done):
            warm = run.begin(lay, state, flat, False)
        elif done:
            break
        now = time.perf_counter()
        longest, before = max(longest, now - before), now
        if now - start + longest > limits.seconds:
            late = True
            break
    run.finish(lay, state, out)
    return time.perf_counter() - start, late


def solve(
    structure: Structure,
    data: Data,
    *,
    tolerance: float,
    seconds: float,
    iterations: int,
    workers: int,
    threads: int,
    chain: int,
) -> dict[str, Any]:
    """Solve a batch; fields of `aerotube.sos.Solution` by name.

    Parameters
    ----------
    structure, data : as in `aerotube.sos.solve`
    tolerance : float
        Relative gap; feasibility is asked to a tenth of it, and to 1e-8 at least.
    seconds : float
        Deadline of each program, from its own start (inf for none).
    iterations : int
        Iterations allowed for each variant of the method.
    workers : int
        Threads over the batch.
    threads : int
        Threads over the constraints of each program.
    chain : int
        Programs in a row of which each starts from the one before.
    """
    lay = layout(structure)
    flat = flatten(data, lay)
    count, m = data.count, structure.size
    length = run.NUMBERS + m + int(lay.at[MATRICES]) + int(lay.at[VECTORS])
    out = np.empty((count, length))
    taken, late = np.zeros(count), np.zeros(count, dtype=bool)
    limits = _Limits(tolerance, seconds, iterations)
    together = threads > 1 and _Together.pays(lay)

    def work(first: int) -> None:
        others = _Together(lay, threads) if together else None
        try:
            with _room(structure, lay) as state:
                for k in range(first, min(first + chain, count)):
                    taken[k], late[k] = _solve_one(lay, state, flat[k], out[k], limits, others, k > first)
        finally:
            if others is not None:
                others.close()

    # BLAS threads would fight with one another and with ours; one solve keeps to one core.
    with _single_threaded_blas:
        if count and not _compiled(together, np.isinf(seconds)):
            _compile(structure, lay, flat[0], out[0], together)
        if workers == 1 or count <= chain:
            for k in range(0, count, chain):
                work(k)
        else:
            with ThreadPoolExecutor(min(workers, -(-count // chain))) as pool:
                list(pool.map(work, range(0, count, chain)))
    return _answers(structure, data, out, taken, late)


def _compiled(together: bool, unhurried: bool) -> bool:
    """Whether what a solve calls has been compiled or loaded."""
    if together:
        return bool(run.close_step.nopython_signatures)
    return bool((run.through if unhurried else run.astray).nopython_signatures)


def _compile(structure: Structure, lay: Layout, flat: Array, out: Array, together: bool) -> None:
    """Compile, or load what was compiled: no part of a solve's time, nor of its deadline."""
    _fill_cache(together)
    _compile_here(structure, lay, flat, out, together)


def _compile_here(structure: Structure, lay: Layout, flat: Array, out: Array, together: bool) -> None:
    with _room(structure, lay) as state:
        for seconds in (np.inf, 0.0):
            _solve_one(lay, state, flat, out, _Limits(1e-7, seconds, 1), None, False)
        if together:
            others = _Together(lay, 2)
            _solve_one(lay, state, flat, out, _Limits(1e-7, np.inf, 1), others, False)
            others.close()


def _fill_cache(together: bool) -> None:
    """Compile in a process of its own where nothing has been compiled yet, so that this one loads what others will.

    What is compiled in a process is not quite what it would load: functions that were compiled by themselves, before
    those that use them, take the place of the copies which were optimised along with these. Sums are then added up in
    another order, and numbers differ in the last digits between the first run on a machine and all others.
    """
    asked = run.close_step if together else run.through
    folder = asked.stats.cache_path
    if folder is None or any(Path(folder).glob(f"*.{asked.py_func.__name__}-*.nbi")):
        return
    program = f"from aerotube.sos.backends import interior; interior.fill_cache({together})"
    try:
        subprocess.run([sys.executable, "-c", program], check=False, capture_output=True)
    except OSError:  # then it is compiled here
        return


def fill_cache(together: bool) -> None:
    """Compile what solves call, in the process that calls this, and leave it in the cache.

    Parameters
    ----------
    together : bool
        What solves with threads inside a program call, too.
    """
    from aerotube.sos.domain import Sphere
    from aerotube.sos.program import Program

    program = Program()
    program.scalar("bound")
    program.sos("above", Sphere(3), degree=2)
    structure = program.compile()
    count = len(structure.nodes("above"))
    data = structure.data(objective=np.ones(1), constraints={"above": (np.zeros(count), np.ones((count, 1)))})
    lay = layout(structure)
    out = np.empty(run.NUMBERS + structure.size + int(lay.at[MATRICES]) + int(lay.at[VECTORS]))
    _compile_here(structure, lay, flatten(data, lay)[0], out, together)


class _SingleThreadedBlas:
    """Keeps BLAS to one thread while any solve runs; much cheaper than a fresh look at the loaded libraries."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0
        self._libraries: list[Any] | None = None
        self._before: list[int] = []

    def __enter__(self) -> None:
        with self._lock:
            if self._libraries is None:
                from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]

                found = ThreadpoolController().lib_controllers
                self._libraries = [lib for lib in found if lib.user_api == "blas"]
            self._inside += 1
            if self._inside == 1:
                self._before = [lib.get_num_threads() for lib in self._libraries]
                for lib in self._libraries:
                    lib.set_num_threads(1)

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                for lib, count in zip(self._libraries or [], self._before, strict=True):
                    lib.set_num_threads(count)


_single_threaded_blas = _SingleThreadedBlas()


@lru_cache(maxsize=64)
def _places(structure: Structure) -> list[tuple[str, str, list[tuple[int, int]], tuple[int, int]]]:
    """Name and kind of every constraint; offset and order of its matrices, offset and length of its multiplier."""
    lay, found = layout(structure), []
    matrices = run.NUMBERS + structure.size
    vectors = matrices + int(lay.at[MATRICES])
    for i, c in enumerate(structure.constraints):
        blocks = range(int(lay.con[FIRST, i]), int(lay.con[LAST, i]))
        own = [(matrices + int(lay.blk[MATRIX, b]), int(lay.blk[ORDER, b])) for b in blocks]
        found.append((c.name, c.kind, own, (vectors + int(lay.con[VECTOR, i]), int(lay.con[ROWS, i]))))
    return found


def _answers(structure: Structure, data: Data, out: Array, taken: Array, late: Array) -> dict[str, Any]:
    batch, m = data.batch, structure.size
    grams: dict[str, tuple[Array, ...]] = {}
    multipliers: dict[str, Array] = {}
    for name, kind, places, (at, rows) in _places(structure):
        found = [out[:, start : start + n * n].reshape(*batch, n, n) for start, n in places]
        if kind == "sos":
            grams[name] = tuple(found)
        multipliers[name] = found[0] if kind in ("lmi", "logdet") else out[:, at : at + rows].reshape(*batch, rows)
    status = _STATUS[out[:, 3].astype(np.int64)]
    status[late.astype(bool)] = Status.DEADLINE
    return {
        "values": out[:, run.NUMBERS : run.NUMBERS + m].reshape(*batch, m),
        "status": status.reshape(batch),
        "iterations": out[:, 4].astype(np.int64).reshape(batch),
        "seconds": taken.reshape(batch),
        "grams": grams,
        "multipliers": multipliers,
        "primal_residual": out[:, _PRIMAL].reshape(batch),
        "dual_residual": out[:, _DUAL].reshape(batch),
        "gap": out[:, _GAP].reshape(batch),
    }
