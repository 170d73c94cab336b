"""The controller's side: takes measurements, flies the best law that is there, and has the next window computed."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np

from aerotube.runtime.commander import Beat, Commander
from aerotube.runtime.faults import Faults
from aerotube.runtime.guidance import Guidance
from aerotube.runtime.ladder import Chosen, Ladder
from aerotube.runtime.listener import Listener
from aerotube.runtime.messages import Kind, Message, Rung, decode
from aerotube.runtime.planner import Planner
from aerotube.runtime.record import Record
from aerotube.runtime.session import Session
from aerotube.runtime.task import Task
from aerotube.runtime.workers import Workers

_HEARTBEAT = 10  # beats between heartbeats


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
    met : threading.Event
        Set when the aircraft has said hello: take-off.
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
        self.session, self.guidance, self.commander, self.workers = session, guidance, commander, workers
        self.beats, self.clocked = beats, bool(np.isfinite(speed))
        self.horizon = guidance.planned.beats
        self.record = Record(beats, 16, len(task.settings.parts), task.form)
        self.met, self.stop = threading.Event(), threading.Event()
        length = guidance.planned.dt / speed if self.clocked else 0.0
        self._ladder = Ladder(task, guidance.planned)
        self._planner = Planner(task, guidance, workers, self._ladder, self.record, length, faults)
        self._listener = Listener(session, length, self.record.refused)

    def prepare(self) -> float:
        """Compute the first window, before take-off; seconds it took."""
        return self._planner.first()

    def fly(self) -> None:
        """Fly until the last beat, goodbye, or `stop`."""
        if not self._listener.meet(self.stop):
            return
        self.met.set()
        beat, early = 0, None
        while beat < self.beats and not self.stop.is_set():
            self._rehearse(beat)
            message, over = (early, False) if early is not None else self._listener.wait(beat)
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

    def _beat(self, beat: int, message: Message | None) -> None:
        """One beat: from the measurement to the command, and then whatever can wait."""
        record, commander = self.record, self.commander
        arrived = self._listener.heard if message is not None else time.monotonic()
        number = beat % self.horizon
        if number == 0:
            commander.begin()
        if beat not in self._ladder.planned:
            self._planner.collect(0.0 if self.clocked else 60.0, beat)
        chosen, late = self._ladder.best(beat)
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
        record.due[beat] = self._listener.due(beat) if self.clocked else arrived
        record.arrived[beat] = arrived if message is not None else np.nan
        record.sent[beat] = sent
        self._afterwards(beat)

    def _flown(self, beat: int, chosen: Chosen) -> Beat:
        number, nominal = beat % self.horizon, self._ladder.nominal(beat)
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
        left = self._listener.left(beat)
        if left < 0 or beat % self.horizon == 0:
            return
        time.sleep(left)
        if beat not in self._ladder.planned:
            self._planner.collect(0.0)
        chosen, _ = self._ladder.best(beat)
        message = Message(Kind.MEASUREMENT, 0, 0, values=tuple(np.zeros(16).tolist())).encode()
        np.array(decode(message).values[:13])
        self.commander.rehearse(beat % self.horizon, self._flown(beat, chosen))

    def _skip(self, beat: int) -> None:
        """A beat whose measurement and moment have passed."""
        self.record.due[beat] = self._listener.due(beat)
        self.record.flown = beat + 1
        number, nominal = beat % self.horizon, self._ladder.nominal(beat)
        self.record.nominal_state[beat] = nominal.states[number][:13]
        self.record.nominal_end[beat] = nominal.states[number + 1][:13]
        self.record.nominal_control[beat] = nominal.controls[number]
        self._afterwards(beat)

    def _afterwards(self, beat: int) -> None:
        """What can wait until the command is out."""
        self._planner.follow(beat)
        self._ladder.forget(beat - 1)
        if beat % _HEARTBEAT == 0:
            self.session.send(Kind.HEARTBEAT, beat)
