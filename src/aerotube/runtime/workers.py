"""Threads that compute windows while others fly: watched over, replaced when they die or stall."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any

_LET_GO = 3  # stalled workers that may be there at once


class Killed(BaseException):
    """Ends a worker without a word, as a fault does."""


@dataclass
class Job:
    """Work to be done once, by whichever worker finishes it first.

    Attributes
    ----------
    key : hashable
    work : callable
        Without arguments; what it returns is the result.
    patience : float
        Seconds after which a worker that has not finished is taken to be stalled.
    asked, started, done : float
        Moments (monotonic s); infinite until they come. ``started`` is that of the last attempt.
    attempts : int
    result : object
    error : str
        One sentence; empty where it went well.
    """

    key: Hashable
    work: Callable[[], Any]
    patience: float
    asked: float = field(default_factory=time.monotonic)
    started: float = float("inf")
    done: float = float("inf")
    attempts: int = 0
    result: Any = None
    error: str = ""


class Workers:
    """A few threads and their supervision.

    Parameters
    ----------
    count : int
        Threads.
    attempts : int
        How often a job is tried.

    Attributes
    ----------
    events : list of (float, str)
        Deaths, stalls and failures: when, and a sentence.
    """

    def __init__(self, count: int = 1, attempts: int = 3) -> None:
        self._attempts = attempts
        self._waiting: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        self._finished: queue.SimpleQueue[Job] = queue.SimpleQueue()
        self._busy: dict[threading.Thread, Job | None] = {}
        self._open: dict[Hashable, Job] = {}
        self._lock = threading.Lock()
        self._let_go: list[threading.Thread] = []
        self._number = 0
        self.events: list[tuple[float, str]] = []
        for _ in range(count):
            self._hire()

    def submit(self, job: Job) -> None:
        """Ask for a job."""
        self._open[job.key] = job
        self._waiting.put(job)

    def finished(self) -> list[Job]:
        """Jobs finished since the last call, each once; failures among them."""
        found: list[Job] = []
        while True:
            try:
                job = self._finished.get_nowait()
            except queue.Empty:
                return found
            if self._open.pop(job.key, None) is not None:
                found.append(job)

    def wait(self, timeout: float) -> list[Job]:
        """Wait for a job to finish; see :meth:`finished`."""
        until = time.monotonic() + timeout
        while not (found := self.finished()) and time.monotonic() < until:
            self.supervise()
            time.sleep(2e-3)
        return found

    def supervise(self) -> None:
        """Replace workers that died or stalled, and give their jobs to others."""
        now = time.monotonic()
        self._let_go = [thread for thread in self._let_go if thread.is_alive()]
        with self._lock:
            busy = list(self._busy.items())
        for thread, job in busy:
            dead = not thread.is_alive()
            stalled = not dead and job is not None and now - job.started > job.patience and job.key in self._open
            if not (dead or stalled):
                continue
            if stalled and len(self._let_go) >= _LET_GO:
                continue  # as many as that are not stalled: the machine is short of time, and more would make it worse
            with self._lock:
                self._busy.pop(thread, None)  # a stalled one ends by itself when it finds that it was let go
            if stalled:
                self._let_go.append(thread)
            what = f"{thread.name} {'died' if dead else 'stalled'}"
            self._hire()
            if job is None or job.key not in self._open:
                self.events.append((now, f"{what}; replaced"))
            elif job.attempts < self._attempts:
                self.events.append((now, f"{what} at {job.key}; replaced, and the work given to another"))
                job.patience *= 2.0
                self._waiting.put(job)
            else:
                self.events.append((now, f"{what} at {job.key}; replaced, and the work given up"))
                job.error = "the work was given up after its workers died or stalled"
                self._finished.put(job)

    def close(self) -> None:
        """Send everybody home; nobody is waited for."""
        for _ in range(len(self._busy)):
            self._waiting.put(None)

    def _hire(self) -> None:
        self._number += 1
        thread = threading.Thread(target=self._work, name=f"worker {self._number}", daemon=True)
        with self._lock:
            self._busy[thread] = None
        thread.start()

    def _work(self) -> None:
        me = threading.current_thread()
        while True:
            job = self._waiting.get()
            if job is None:
                return
            if job.key not in self._open:
                continue
            with self._lock:
                if me not in self._busy:
                    self._waiting.put(job)
                    return
                self._busy[me] = job
                job.attempts += 1
                job.started = time.monotonic()
            error, result = "", None
            try:
                result = job.work()
            except Killed:
                return
            except Exception as reason:
                error = f"{type(reason).__name__}: {reason}"
                self.events.append((time.monotonic(), f"{me.name} at {job.key}: {error}"))
            if job.key in self._open and job.done == float("inf"):
                job.result, job.error, job.done = result, error, time.monotonic()
                self._finished.put(job)
            with self._lock:
                if me not in self._busy:
                    return
                self._busy[me] = None
