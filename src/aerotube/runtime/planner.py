"""Windows of laws ahead of the flight: which is asked for next and with what time, and taking in what is done."""

from __future__ import annotations

import time
from functools import partial

import numpy as np

from aerotube.nominal import Nominal
from aerotube.runtime.faults import Faults
from aerotube.runtime.guidance import Guidance
from aerotube.runtime.ladder import Ladder
from aerotube.runtime.record import Record, WindowTimes
from aerotube.runtime.task import Task
from aerotube.runtime.window import Window
from aerotube.runtime.windows import compute
from aerotube.runtime.workers import Job, Workers

_SOLVING = 0.85  # share of the time until a window is needed that its laws' design may take


def window_starts(beats: int, horizon: int, window: int) -> list[int]:
    """First beats, from take-off, of the windows of a flight of so many beats, manoeuvre by manoeuvre."""
    return [start for m in range(0, beats, horizon) for start in range(m, m + horizon, window)]


class Planner:
    """Has the windows of a flight computed, each while the one before it is flown, and puts them on the ladder.

    Parameters
    ----------
    task : Task
    guidance : Guidance
        Decides on the nominal of each window when it is asked for.
    workers : Workers
    ladder : Ladder
    record : Record
        Gets the times of the windows.
    length : float
        Of a beat on the clock, s; zero: there is no clock, and every law is waited for.
    faults : Faults, optional
        That hit the workers.
    """

    def __init__(
        self,
        task: Task,
        guidance: Guidance,
        workers: Workers,
        ladder: Ladder,
        record: Record,
        length: float,
        faults: Faults | None = None,
    ) -> None:
        self.task, self.guidance, self.workers = task, guidance, workers
        self.ladder, self.record, self.length, self.faults = ladder, record, length, faults
        self.horizon = guidance.planned.beats
        self._windows = [
            (start, min(task.window, self.horizon - start % self.horizon))
            for start in window_starts(record.beats, self.horizon, task.window)
        ]
        self._asked = 0
        self._asked_for: dict[int, Nominal] = {}
        self._memory: dict[int, Window] = {}
        self._now = -1
        self._longest = 0.1

    def first(self) -> float:
        """Compute the first window, before take-off; seconds it took."""
        clock = time.perf_counter()
        self._ask()
        while 0 not in self.ladder.planned and self._asked <= 1 and not self.collect(1.0):
            pass
        return time.perf_counter() - clock

    def follow(self, beat: int) -> None:
        """After a beat: ask for the next window, take in what is done, look after the workers."""
        self._now = beat
        self.workers.supervise()
        self.collect(0.0)
        if self._asked < len(self._windows) and beat >= self._windows[self._asked - 1][0]:
            self._ask()

    def collect(self, timeout: float, wanted: int | None = None) -> bool:
        """Take in finished windows; with a wanted beat, wait for the one that holds it."""
        until = time.monotonic() + timeout
        while True:
            done = self.workers.finished()
            for job in done:
                self._install(job)
            if wanted is not None and wanted not in self.ladder.planned and time.monotonic() < until:
                waiting = any(w.first <= wanted < w.first + w.beats for w in self.record.windows)
                if not waiting:
                    self.workers.supervise()
                    time.sleep(1e-3)
                    continue
            if done or time.monotonic() >= until:
                return bool(done)
            self.workers.supervise()
            time.sleep(1e-3)

    def _ask(self) -> None:
        """Decide on the nominal of the next window and have its laws computed."""
        start, count = self._windows[self._asked]
        manoeuvre, first = divmod(start, self.horizon)
        nominal = self.guidance.update(manoeuvre, first)
        self.ladder.decide(range(start, (manoeuvre + 1) * self.horizon), nominal)
        self._asked_for[start] = nominal
        lead = np.inf
        if self.length and self._asked:
            lead = self._windows[self._asked - 1][1] * self.length
        budget = max(_SOLVING * lead, 1e-3) if np.isfinite(lead) else None
        work = partial(self._compute, nominal, start, count, budget)
        job = Job(
            start,
            self.faults.wrap(work, start) if self.faults is not None and self._asked else work,
            patience=max(0.6 * lead, 2.0 * self._longest) if np.isfinite(lead) else np.inf,
        )
        self._asked += 1
        self.workers.submit(job)

    def _compute(self, nominal: Nominal, start: int, count: int, budget: float | None) -> Window | None:
        """Laws of what is left of a window when its turn comes; None if nothing is."""
        first = start % self.horizon
        begin = first + max(0, self._now + 1 - start) if self.length and start else first
        if begin >= first + count:
            return None
        beats = range(begin, first + count)
        return compute(self.task, nominal, beats, before=self._memory.get(begin), budget=budget)

    def _install(self, job: Job) -> None:
        """Take in a window, or write down why there is none."""
        start = int(str(job.key))
        count = next(beats for at, beats in self._windows if at == start)
        times = WindowTimes(start, count, job.asked, job.started, job.done, job.attempts, error=job.error)
        self.record.windows.append(times)
        nominal = self._asked_for.pop(start)
        window: Window | None = job.result
        if window is None:
            times.error = times.error or "overtaken by the flight before its turn came"
            return
        times.computed = window.window
        self._longest = max(0.7 * self._longest, job.done - job.started)
        times.designed, times.kept, times.seconds = window.designed, int(window.kept.sum()), window.seconds
        self.record.events += [(job.done, message) for message in window.messages]
        self._memory[int(window.beats[0])] = window
        self.ladder.install(window, start // self.horizon, nominal)
