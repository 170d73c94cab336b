"""Faults, made on purpose and from a seed: of the link, of the sensors, and of the workers."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
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
    """Which faults come when; each comes once.

    Parameters
    ----------
    of_beats : dict of int to str
        What is to be done to the measurement of a beat, of `LINK`.
    of_windows : dict of int to str
        What is to be done to the worker who first takes up a window (by its first beat), of `WORKERS`.
    seed : int
        Of what exactly is done.
    stall : float
        Seconds that a stalled worker sleeps.

    Attributes
    ----------
    injected : Counter
        By kind, so far.
    by_beat : dict of int to str
        What was done to the measurement of a beat.
    given_back : set of int
        Beats whose true measurement came once more, replayed later: one that was spoiled may be flown with it after
        all, where the controller still waits.
    windows : set of int
        Windows (by their first beat) at which a worker was hit.
    """

    of_beats: dict[int, str]
    of_windows: dict[int, str] = field(default_factory=dict)
    seed: int = 0
    stall: float = 0.5

    def __post_init__(self) -> None:
        self.injected: Counter[str] = Counter()
        self.by_beat: dict[int, str] = {}
        self.given_back: set[int] = set()
        self.windows: set[int] = set()
        self.random = np.random.default_rng([self.seed, 0])
        self._lock = threading.Lock()

    @classmethod
    def spread(cls, count: int, beats: int, windows: Sequence[int], seed: int, stall: float) -> Faults:
        """So many faults over a flight, each kind as likely where there is room for it.

        Parameters
        ----------
        count : int
            Of the link, the sensors and the workers together.
        beats : int
            Of the flight; each is hit at most once.
        windows : sequence of int
            First beats of the windows at which a worker may be hit, each at most once.
        seed : int
        stall : float

        Raises
        ------
        InputError
            If there are more faults than places for them.
        """
        if count > beats + len(windows):
            raise InputError(
                f"flight: {count} faults are asked for, but {beats} beats and {len(windows)} windows have room for "
                f"{beats + len(windows)}; ask for fewer, or fly for longer."
            )
        random = np.random.default_rng([seed, 1])
        of_workers = int(random.binomial(count, len(WORKERS) / len(LINK + WORKERS)))
        of_workers = min(max(of_workers, count - beats), len(windows))
        hit = random.choice(beats, count - of_workers, replace=False)
        kinds = random.choice(LINK, len(hit))
        taken = random.choice(len(windows), of_workers, replace=False) if of_workers else ()
        done = random.choice(WORKERS, of_workers)
        return cls(
            {int(beat): str(kind) for beat, kind in zip(hit, kinds, strict=True)},
            {windows[int(at)]: str(kind) for at, kind in zip(taken, done, strict=True)},
            seed,
            stall,
        )

    def of_link(self, beat: int) -> str | None:
        """The fault that hits the measurement of a beat now, if one does."""
        kind = self.of_beats.pop(beat, None)
        if kind is not None:
            self._count(kind)
            self.by_beat[beat] = kind
        return kind

    def wrap(self, work: Callable[[], Any], window: int) -> Callable[[], Any]:
        """Work on a window that may kill or stall the worker who takes it up."""

        def faulty() -> Any:
            kind = self.of_windows.pop(window, None)
            if kind is not None:
                self._count(kind)
                self.windows.add(window)
            if kind == "kill":
                raise Killed
            if kind == "stall":
                time.sleep(self.stall)
            return work()

        return faulty

    def _count(self, kind: str) -> None:
        with self._lock:
            self.injected[kind] += 1


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
        random = self._faults.random
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
