"""Faults, made on purpose and from a seed: of the link, of the sensors, and of the workers."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from aerotube.errors import InputError
from aerotube.runtime.channels import Channel
from aerotube.runtime.messages import Kind, Message, Refused, decode
from aerotube.runtime.workers import Killed

#: Faults of the link and the sensors, each as likely.
LINK = ("drop", "repeat", "delay", "corrupt", "nan", "spike", "garbage", "alien", "replay")
#: Faults of the workers.
WORKERS = ("kill", "stall")


@dataclass
class Faults:
    """Which faults come when.

    Parameters
    ----------
    share : float
        Of the measurements that are hit, 0 to 1.
    seed : int
    worker_share : float
        Of the attempts at a window that are hit.
    stall : float
        Seconds that a stalled worker sleeps.
    limit : int, optional
        Faults of the link in all.
    kinds : tuple of str
        Of `LINK`.

    Attributes
    ----------
    injected : Counter
        By kind.
    by_beat : dict of int to str
        What was done to the measurement of a beat.
    given_back : set of int
        Beats whose true measurement came once more, replayed later: one that was spoiled may be flown with it after
        all, where the controller still waits.
    windows : set of int
        Windows (by their first beat) at which a worker was hit.
    """

    share: float
    seed: int = 0
    worker_share: float = 0.1
    stall: float = 0.5
    limit: int | None = None
    kinds: tuple[str, ...] = LINK

    def __post_init__(self) -> None:
        if not 0 <= self.share <= 1:
            raise InputError(f"faults: a share of {self.share:g} is asked for; give 0 to 1.")
        self.injected: Counter[str] = Counter()
        self.by_beat: dict[int, str] = {}
        self.given_back: set[int] = set()
        self.windows: set[int] = set()
        self._link = np.random.default_rng([self.seed, 0])
        self._workers = np.random.default_rng([self.seed, 1])
        self._lock = threading.Lock()

    def of_link(self, beat: int) -> str | None:
        """The fault that hits the measurement of a beat, if one does."""
        if len(self.by_beat) == self.limit or self._link.random() >= self.share:
            return None
        kind = str(self._link.choice(self.kinds))
        self.injected[kind] += 1
        self.by_beat[beat] = kind
        return kind

    def wrap(self, work: Callable[[], Any], window: int) -> Callable[[], Any]:
        """Work on a window that may kill or stall the worker who takes it up."""

        def faulty() -> Any:
            with self._lock:
                hit = self._workers.random() < self.worker_share
                kind = str(self._workers.choice(WORKERS)) if hit else ""
                if hit:
                    self.injected[kind] += 1
                    self.windows.add(window)
            if kind == "kill":
                raise Killed
            if kind == "stall":
                time.sleep(self.stall)
            return work()

        return faulty


class FaultyChannel:
    """A channel on which measurements are hit by faults on their way in."""

    def __init__(self, inner: Channel, faults: Faults) -> None:
        self._inner, self._faults = inner, faults
        self._ready: deque[bytes] = deque()
        self._late: deque[tuple[int, bytes]] = deque()
        self._old: deque[tuple[int, bytes]] = deque(maxlen=50)

    def send(self, data: bytes) -> None:
        """Send as it is."""
        self._inner.send(data)

    def receive(self, timeout: float) -> bytes | None:
        """Wait for a datagram, of the aircraft or of the faults."""
        until = time.monotonic() + timeout
        while not self._ready:
            data = self._inner.receive(max(until - time.monotonic(), 0.0))
            if data is None:
                return None
            try:
                message = decode(data)
            except Refused:
                return data
            if message.kind != Kind.MEASUREMENT:
                return data
            self._hit(data, message)
            while self._late and self._late[0][0] <= message.beat:
                self._ready.append(self._late.popleft()[1])
            # one that was taken away has not come: there is still time for the next
            if not self._ready and time.monotonic() >= until:
                return None
        return self._ready.popleft()

    def close(self) -> None:
        """Close the channel beneath."""
        self._inner.close()

    def _hit(self, data: bytes, message: Message) -> None:
        random = self._faults._link
        kind = self._faults.of_link(message.beat)
        self._old.append((message.beat, data))
        if kind == "drop":
            return
        if kind == "delay":
            self._late.append((message.beat + int(random.integers(1, 4)), data))
            return
        if kind == "corrupt":
            spoiled = bytearray(data)
            # bits that differ: the same one twice would be none
            for bit in random.choice(8 * len(data), 1 + random.integers(4), replace=False):
                spoiled[bit // 8] ^= 1 << int(bit % 8)
            self._ready.append(bytes(spoiled))
            return
        if kind in ("nan", "spike"):
            values = list(message.values)
            place = int(random.integers(10))
            wild = (np.nan, np.inf, -np.inf) if kind == "nan" else (1e3, -1e6, 1e30)
            values[place] = float(random.choice(wild))
            self._ready.append(replace(message, values=tuple(values)).encode())
            return
        if kind == "garbage":
            self._ready.append(random.bytes(int(random.integers(0, 400))))
        if kind == "alien":
            stranger = Message(
                Kind.MEASUREMENT, message.token ^ 0x5A5A, message.sequence, message.beat, 0.0, (9.0,) * 16
            )
            self._ready.append(stranger.encode())
        if kind == "replay":
            beat, old = self._old[int(random.integers(len(self._old)))]
            self._faults.given_back.add(beat)
            self._ready.append(old)
        self._ready.append(data)
        if kind == "repeat":
            self._ready.append(data)
