"""The controller's side: takes measurements, flies the best law that is there, and has the next window computed."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from aerotube.compensation import COUPLED
from aerotube.compensation.tubes import regrouped
from aerotube.nominal import Nominal
from aerotube.runtime.commander import Beat, Commander
from aerotube.runtime.faults import Faults
from aerotube.runtime.guidance import Guidance
from aerotube.runtime.law import Laws
from aerotube.runtime.messages import Kind, Message, Rung, decode
from aerotube.runtime.record import Record, WindowTimes
from aerotube.runtime.session import Session
from aerotube.runtime.task import Task
from aerotube.runtime.windows import Window, compute
from aerotube.runtime.workers import Job, Workers

Array = NDArray[np.float64]

#: Share of a beat after which a measurement that has not come is done without.
WAIT = 0.15
_SOLVING = 0.85  # share of the time until a window is needed that its laws' design may take
_HEARTBEAT = 10  # beats between heartbeats
_REHEARSAL = 1.2e-3  # s before a measurement is expected
_ALERT = 7e-4  # s either side of that for which it is waited for without sleeping: waking up would take as long
_GONE = 10.0  # s without a measurement after which the aircraft is taken to be gone


@dataclass(frozen=True)
class Chosen:
    """What is flown in a beat: the law, and of each part its rung, its certified size and what stands behind that.

    Attributes
    ----------
    law : Laws
        Of the one beat.
    rungs, kinds : ndarray (parts,) of int
    size : ndarray (parts,)
    metric : ndarray (8, 8)
        In which the sizes are measured, part by part; zero where nothing is certified.
    """

    law: Laws
    rungs: NDArray[np.int64]
    size: Array
    kinds: NDArray[np.int64]
    metric: Array


class Pilot:
    """Flies one session.

    Parameters
    ----------
    session : Session
        With the aircraft.
    task : Task
    guidance : Guidance
    commander : Commander
    workers : Workers
    beats : int
        To fly, all manoeuvres together.
    speed : float
        Seconds of flight for one of the clock; infinite: no clock, every law is waited for.
    faults : Faults, optional
        That hit the workers.

    Attributes
    ----------
    record : Record
    stop : threading.Event
        Set from outside, ends the flight after the beat.
    """

    def __init__(
        self,
        session: Session,
        task: Task,
        guidance: Guidance,
        commander: Commander,
        workers: Workers,
        beats: int,
        speed: float,
        faults: Faults | None = None,
    ) -> None:
        self.session, self.task, self.guidance = session, task, guidance
        self.commander, self.workers, self.faults = commander, workers, faults
        self.beats, self.speed = beats, speed
        self.horizon = guidance.planned.beats
        self.length = guidance.planned.dt / speed if np.isfinite(speed) else 0.0
        self.record = Record(beats, 16, len(task.settings.parts), task.form)
        self.stop = threading.Event()
        self._nominal = guidance.planned
        self._windows = [
            (m * self.horizon + first, min(task.window, self.horizon - first))
            for m in range(-(-beats // self.horizon))
            for first in range(0, self.horizon, task.window)
        ]
        self._asked = 0
        self._needed: dict[int, int] = {}
        self._planned: dict[int, Chosen] = {}
        self._held: dict[int, Chosen] = {}
        self._lqr: dict[int, Array] = {}
        self._earlier: dict[int, tuple[Chosen, Nominal]] = {}
        self._earlier_lqr: dict[int, Array] = {}
        self._nominals: dict[int, Nominal] = {}
        self._asked_for: dict[int, Nominal] = {}
        self._memory: dict[int, Window] = {}
        self._offset = np.inf
        self._heard = np.inf
        self._lateness = 0.0
        self._now = -1
        self._longest = 0.1

    @property
    def clocked(self) -> bool:
        """Whether there is a clock."""
        return np.isfinite(self.speed)

    def prepare(self) -> float:
        """Compute the first window, before take-off; seconds it took."""
        clock = time.perf_counter()
        self._ask()
        while 0 not in self._planned and self._asked <= 1 and not self._collect(1.0):
            pass
        return time.perf_counter() - clock

    def fly(self) -> None:
        """Fly until the last beat, goodbye, or `stop`."""
        if not self._meet():
            return
        beat, early = 0, None
        while beat < self.beats and not self.stop.is_set():
            self._rehearse(beat)
            message, over = self._await(beat, early)
            early = None
            if over:
                break
            if message is not None and message.beat > beat:
                # measurements of the beats between are lost, and their commands would be too late
                while beat < min(message.beat, self.beats):
                    self._skip(beat)
                    beat += 1
                early = message
                continue
            self._beat(beat, message)
            beat += 1
        self.session.send(Kind.GOODBYE)
        self.record.refused.update(self.session.refused)
        self.record.events += self.workers.events

    def _meet(self) -> bool:
        """Answer the aircraft's hello; False if none comes."""
        while not self.stop.is_set():
            message = self.session.receive(0.25)
            if message is not None and message.kind == Kind.HELLO:
                lock = getattr(self.session.channel, "lock", None)
                if lock is not None:
                    lock()
                self.session.send(Kind.HELLO, values=message.values)
                return True
            if message is not None and message.kind == Kind.GOODBYE:
                return False
        return False

    def _due(self, beat: int) -> float:
        return self._offset + beat * self.length

    def _await(self, beat: int, early: Message | None) -> tuple[Message | None, bool]:
        """The measurement of a beat (or of a later one), or none in time; whether the session is over."""
        if early is not None:
            return early, False
        while True:
            now = time.monotonic()
            known = self.clocked and np.isfinite(self._offset)
            until = self._due(beat) + WAIT * self.length if known else now + _GONE
            message = None
            expected = self._due(beat) + self._lateness
            if known and abs(expected - now) < _REHEARSAL:
                alert = min(expected + _ALERT, until)
                while message is None and time.monotonic() < alert:
                    message = self.session.receive(0.0)
            if message is None:
                message = self.session.receive(max(until - time.monotonic(), 0.0))
            if message is None:
                quiet = now - self._heard > _GONE
                return None, not known or quiet
            self._heard = self.session.arrived
            if message.kind == Kind.GOODBYE:
                return None, True
            if message.kind == Kind.HELLO:  # our answer was lost, or it asks again
                self.session.send(Kind.HELLO, values=message.values)
            if message.kind == Kind.MEASUREMENT:
                if message.beat >= beat:
                    self._offset = min(self._offset, self._heard - message.beat * self.length)
                    late = min(self._heard - self._due(message.beat), WAIT * self.length)
                    self._lateness += 0.1 * (late - self._lateness)
                    return message, False
                self.record.refused["too late"] += 1

    def _beat(self, beat: int, message: Message | None) -> None:
        """One beat: from the measurement to the command, and then whatever can wait."""
        record, commander = self.record, self.commander
        arrived = self._heard if message is not None else time.monotonic()
        number = beat % self.horizon
        if number == 0:
            commander.begin()
        if beat not in self._planned:
            self._collect(0.0 if self.clocked else 60.0, beat)
        chosen, late = self._best(beat)
        flown = self._flown(beat, chosen)
        measured = None
        if message is not None:
            state = np.array(message.values[: len(commander.aircraft.state_names)])
            if commander.believes(state, flown):
                measured = state
            else:
                record.refused["unlikely" if np.isfinite(state).all() else "not finite"] += 1
        command = commander.command(number, measured, flown)
        self.session.send(Kind.COMMAND, beat, tuple(command.control.tolist()), int(command.rung))
        sent = time.monotonic()
        commander.after(number, flown, command.control)
        record.put(beat, command, chosen.rungs, chosen.size, chosen.kinds, measured)
        record.fly(beat, chosen.law, chosen.metric)
        record.law_late[beat] = late
        record.nominal_state[beat], record.nominal_end[beat] = flown.nominal_state[:13], flown.next_state[:13]
        record.nominal_control[beat] = flown.nominal_control
        record.due[beat] = self._due(beat) if self.clocked else arrived
        record.arrived[beat] = arrived if message is not None else np.nan
        record.sent[beat] = sent
        self._afterwards(beat)

    def _flown(self, beat: int, chosen: Chosen) -> Beat:
        number, nominal = beat % self.horizon, self._nominals.get(beat, self._nominal)
        estimator = self.commander.estimator
        if estimator is not None and estimator.nominal is not nominal:
            self.commander.estimator = replace(estimator, nominal=nominal)
        return Beat(
            nominal.states[number],
            nominal.controls[number],
            chosen.law,
            Rung(int(chosen.rungs.max())),
            nominal.states[number + 1],
        )

    def _rehearse(self, beat: int) -> None:
        """Just before a measurement is due, go through the beat's motions, so that it finds everything at hand."""
        left = self._due(beat) + self._lateness - _REHEARSAL - time.monotonic()
        if not self.clocked or not np.isfinite(self._offset) or left < 0 or beat % self.horizon == 0:
            return
        time.sleep(left)
        if beat not in self._planned:
            self._collect(0.0)
        chosen, _ = self._best(beat)
        message = Message(Kind.MEASUREMENT, 0, 0, values=tuple(np.zeros(16).tolist())).encode()
        np.array(decode(message).values[:13])
        self.commander.rehearse(beat % self.horizon, self._flown(beat, chosen))

    def _skip(self, beat: int) -> None:
        """A beat whose measurement and moment have passed."""
        self.record.due[beat] = self._due(beat)
        self.record.flown = beat + 1
        number = beat % self.horizon
        nominal = self._nominals.get(beat, self._nominal)
        self.record.nominal_state[beat] = nominal.states[number][:13]
        self.record.nominal_end[beat] = nominal.states[number + 1][:13]
        self.record.nominal_control[beat] = nominal.controls[number]
        self._afterwards(beat)

    def _best(self, beat: int) -> tuple[Chosen, bool]:
        """Down the ladder: what is flown, and whether the beat's window is late.

        A last law is that of the window before, where it was certified for this beat, or that of the manoeuvre before
        at this beat, if the nominal is the very same.
        """
        found = self._planned.get(beat)
        if found is not None:
            return found, False
        found = self._held.get(beat)
        if found is not None:
            return found, True
        number = beat % self.horizon
        earlier = self._earlier.get(number)
        if earlier is not None and earlier[1] is self._nominals.get(beat):
            return replace(earlier[0], rungs=np.maximum(earlier[0].rungs, Rung.LAST)), True
        gain = self._lqr.get(beat, self._earlier_lqr.get(number))
        if gain is not None:
            return self._uncertified(gain, Rung.LQR), True
        return self._uncertified(np.zeros((4, 8)), Rung.NOMINAL), True

    def _uncertified(self, gains: Array, rung: Rung) -> Chosen:
        parts = len(self.task.settings.parts)
        law = Laws.linear(self.task.form, gains[None])[0]
        return Chosen(law, np.full(parts, int(rung)), np.full(parts, np.nan), np.full(parts, -1), np.zeros((8, 8)))

    def _afterwards(self, beat: int) -> None:
        """Ask for the next window, take in what is done, look after the workers."""
        self._now = beat
        self.workers.supervise()
        self._collect(0.0)
        if self._asked < len(self._windows) and beat >= self._windows[self._asked - 1][0]:
            self._ask()
        for store in (self._planned, self._held, self._lqr, self._nominals):
            store.pop(beat - 1, None)
        if beat % _HEARTBEAT == 0:
            self.session.send(Kind.HEARTBEAT, beat)

    def _ask(self) -> None:
        """Decide on the nominal of the next window and have its laws computed."""
        start, count = self._windows[self._asked]
        manoeuvre, first = divmod(start, self.horizon)
        nominal = self.guidance.update(manoeuvre, first)
        for beat in range(start, (manoeuvre + 1) * self.horizon):
            self._nominals[beat] = nominal
        self._asked_for[start] = nominal
        lead = np.inf
        if self.clocked and self._asked:
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
        begin = first + max(0, self._now + 1 - start) if self.clocked and start else first
        if begin >= first + count:
            return None
        beats = range(begin, first + count)
        return compute(self.task, nominal, beats, before=self._memory.get(begin), budget=budget)

    def _collect(self, timeout: float, wanted: int | None = None) -> bool:
        """Take in finished windows; with a wanted beat, wait for the one that holds it."""
        until = time.monotonic() + timeout
        while True:
            done = self.workers.finished()
            for job in done:
                self._install(job)
            if wanted is not None and wanted not in self._planned and time.monotonic() < until:
                waiting = any(w.first <= wanted < w.first + w.beats for w in self.record.windows)
                if not waiting:
                    self.workers.supervise()
                    time.sleep(1e-3)
                    continue
            if done or time.monotonic() >= until:
                return bool(done)
            self.workers.supervise()
            time.sleep(1e-3)

    def _install(self, job: Job) -> None:
        """Put the laws of a window where the beats will look for them."""
        start = int(str(job.key))
        manoeuvre, first = divmod(start, self.horizon)
        count = next(beats for at, beats in self._windows if at == start)
        times = WindowTimes(start, count, job.asked, job.started, job.done, start, job.attempts, error=job.error)
        self.record.windows.append(times)
        nominal = self._asked_for.pop(start)
        window: Window | None = job.result
        if window is None:
            times.error = times.error or "overtaken by the flight before its turn came"
            return
        first = int(window.beats[0])
        times.computed = window.window
        self._longest = max(0.7 * self._longest, job.done - job.started)
        times.designed, times.kept, times.seconds = window.designed, int(window.kept.sum()), window.seconds
        self.record.events += [(job.done, message) for message in window.messages]
        self._memory[first] = window
        (metric,) = regrouped(window.metric, self.task.settings.parts, COUPLED)
        for j, beat in enumerate(window.beats + manoeuvre * self.horizon):
            own, certified = j < window.window, bool((window.rungs[j] <= Rung.LAST).all())
            chosen = Chosen(window.laws[j], window.rungs[j], window.size[j], window.kinds[j], metric[j])
            if own or certified:
                (self._planned if own else self._held)[int(beat)] = chosen
            if own and certified:
                self._earlier[int(beat) % self.horizon] = chosen, nominal
        for j, gain in enumerate(window.lqr):
            self._lqr[manoeuvre * self.horizon + first + j] = self._earlier_lqr[first + j] = gain
