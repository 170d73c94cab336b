"""One side of a session: numbers what it sends, and takes from the link only what is new, whole and the peer's."""

from __future__ import annotations

import time
from collections import Counter

from aerotube.runtime.channels import Channel
from aerotube.runtime.messages import Kind, Message, Refused, decode

_HALF = 1 << 31


class Session:
    """Messages over a channel.

    Parameters
    ----------
    channel : Channel
    token : int or None
        None: that of the first hello.

    Attributes
    ----------
    refused : Counter
        Datagrams that were not taken, by reason.
    arrived : float
        When the last datagram came in (monotonic s), before it was looked at.
    """

    def __init__(self, channel: Channel, token: int | None) -> None:
        self.channel, self.token = channel, token
        self.refused: Counter[str] = Counter()
        self.arrived = -float("inf")
        self._sent = 0
        self._seen = -1

    def send(self, kind: Kind, beat: int = 0, values: tuple[float, ...] = (), flags: int = 0) -> None:
        """Send a message; it may be lost."""
        self._sent = (self._sent + 1) & 0xFFFFFFFF
        self.channel.send(Message(kind, self.token or 0, self._sent, beat, time.monotonic(), values, flags).encode())

    def receive(self, timeout: float) -> Message | None:
        """Wait for the next message that can be taken, at most so many seconds."""
        until = time.monotonic() + timeout
        while True:
            data = self.channel.receive(max(until - time.monotonic(), 0.0))
            if data is None:
                return None
            self.arrived = time.monotonic()
            message = self._taken(data)
            if message is not None:
                return message
            if time.monotonic() >= until:
                return None

    def _taken(self, data: bytes) -> Message | None:
        try:
            message = decode(data, self.token)
        except Refused as reason:
            self.refused[str(reason)] += 1
            return None
        if self.token is None:
            if message.kind != Kind.HELLO:
                self.refused["alien sender"] += 1
                return None
            self.token = message.token
        ahead = (message.sequence - self._seen) & 0xFFFFFFFF
        if self._seen >= 0 and not 0 < ahead < _HALF:
            self.refused["repeated" if ahead == 0 else "out of order"] += 1
            return None
        self._seen = message.sequence
        return message
