"""A process of its own for each solver: it cannot hang the others, and it has one thread."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import pickle
import resource
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS", "NUMEXPR_NUM_THREADS")


class Failure(Exception):
    """A solver that cannot go on; the text is its status in the table."""


def _peak_memory() -> float:
    """Largest memory of this process, MiB; not that of the one that started it, which `getrusage` counts on Linux."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024.0
    except (OSError, StopIteration):
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def _serve(module: str, path: str, connection: Connection) -> None:
    try:
        solver = importlib.import_module(module)
    except ImportError as error:
        connection.send(("failed", "not installed" if isinstance(error, ModuleNotFoundError) else f"error: {error}"))
        return
    programs = pickle.loads(Path(path).read_bytes())
    prepared: list[Any] = []
    connection.send(("ready", None))
    while True:
        order, argument = connection.recv()
        try:
            if order == "prepare":
                start = time.perf_counter()
                prepared.append(solver.prepare(programs[argument]))
                connection.send(("done", time.perf_counter() - start))
            elif order == "solve":
                connection.send(("done", solver.solve(prepared[argument % len(prepared)])))
            elif order == "memory":
                connection.send(("done", _peak_memory()))
            else:
                return
        except Exception as error:  # whatever a peer raises is its result
            words = " ".join(str(error).split())[:80]
            connection.send(("failed", f"error: {type(error).__name__}: {words}"))
            return


class Worker:
    """A solver in a process of its own.

    Parameters
    ----------
    module : str
        Module of the solver, see `benchmarks.solvers`.
    path : Path
        Pickled list of programs.
    deadline : float
        Seconds allowed for any one order.

    Raises
    ------
    Failure
        In every method: if the solver is not installed, has failed, or is over the deadline.
    """

    def __init__(self, module: str, path: Path, deadline: float) -> None:
        self._deadline = deadline
        before = {name: os.environ.get(name) for name in THREADS}
        os.environ.update(dict.fromkeys(THREADS, "1"))
        try:
            context = multiprocessing.get_context("spawn")
            self._connection, other = context.Pipe()
            self._process = context.Process(target=_serve, args=(module, str(path), other), daemon=True)
            self._process.start()
            other.close()
        finally:
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value
        self._receive(max(deadline, 120.0))

    def ask(self, order: str, argument: int = 0, deadline: float | None = None) -> Any:
        """Give an order and wait for its answer."""
        self._connection.send((order, argument))
        return self._receive(self._deadline if deadline is None else deadline)

    def close(self) -> None:
        """End the process."""
        if self._process.is_alive():
            self._process.terminate()
        self._process.join(5.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def _receive(self, deadline: float) -> Any:
        try:
            if not self._connection.poll(deadline):
                self.close()
                raise Failure("timeout")
            word, value = self._connection.recv()
        except (EOFError, ConnectionResetError):
            self.close()
            raise Failure("error: the process ended") from None
        if word == "failed":
            self.close()
            raise Failure(value)
        return value
