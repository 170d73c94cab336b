"""Waiting for the aircraft: its hello, and the measurement of each beat, at the moment when it is due."""

from __future__ import annotations

import threading
import time
from collections import Counter

import numpy as np

from aerotube.runtime.messages import Kind, Message
from aerotube.runtime.session import Session

#: Share of a beat after which a measurement that has not come is done without.
WAIT = 0.15
_AHEAD = 1.2e-3  # s before a measurement is expected from which on nothing else is begun
_ALERT = 7e-4  # s either side of that for which it is waited for without sleeping: waking up would take as long
_GONE = 10.0  # s without a measurement after which the aircraft is taken to be gone


class Listener:
    """Hears the aircraft of one session, and learns from its measurements when the next ones are due.

    Parameters
    ----------
    session : Session
    length : float
        Of a beat on the clock, s; zero: there is no clock, and every measurement is waited for.
    refused : Counter
        Counts the measurements that are too late to be used.

    Attributes
    ----------
    heard : float
        When the last message came in (monotonic s).
    """

    def __init__(self, session: Session, length: float, refused: Counter[str]) -> None:
        self.session, self.length, self.refused = session, length, refused
        self.heard = np.inf
        self._offset = np.inf
        self._lateness = 0.0

    def meet(self, stop: threading.Event) -> bool:
        """Answer the aircraft's hello; False if none comes."""
        while not stop.is_set():
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

    def due(self, beat: int) -> float:
        """When the measurement of a beat is due (monotonic s); infinite before the first one."""
        return self._offset + beat * self.length

    def left(self, beat: int) -> float:
        """Seconds until the measurement of a beat wants all attention; negative without a clock or before the first."""
        if not self.length or not np.isfinite(self._offset):
            return -np.inf
        return self.due(beat) + self._lateness - _AHEAD - time.monotonic()

    def wait(self, beat: int) -> tuple[Message | None, bool]:
        """The measurement of a beat (or of a later one), or none in time; whether the session is over."""
        while True:
            now = time.monotonic()
            known = bool(self.length) and np.isfinite(self._offset)
            until = self.due(beat) + WAIT * self.length if known else now + _GONE
            message = None
            expected = self.due(beat) + self._lateness
            if known and abs(expected - now) < _AHEAD:
                alert = min(expected + _ALERT, until)
                while message is None and time.monotonic() < alert:
                    message = self.session.receive(0.0)
            if message is None:
                message = self.session.receive(max(until - time.monotonic(), 0.0))
            if message is None:
                quiet = now - self.heard > _GONE
                return None, not known or quiet
            self.heard = self.session.arrived
            if message.kind == Kind.GOODBYE:
                return None, True
            if message.kind == Kind.HELLO:  # our answer was lost, or it asks again
                self.session.send(Kind.HELLO, values=message.values)
            if message.kind == Kind.MEASUREMENT:
                if message.beat >= beat:
                    self._offset = min(self._offset, self.heard - message.beat * self.length)
                    late = min(self.heard - self.due(message.beat), WAIT * self.length)
                    self._lateness += 0.1 * (late - self._lateness)
                    return message, False
                self.refused["too late"] += 1
