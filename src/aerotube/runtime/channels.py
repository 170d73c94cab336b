"""What carries datagrams: a queue within the process, a pair of sockets between processes, UDP on loopback.

A channel never blocks the sender and never raises for what the other side did: a datagram that cannot be sent is
lost, as datagrams are.
"""

from __future__ import annotations

import queue
import select
import socket
import time
from typing import Protocol

from aerotube.errors import InputError
from aerotube.runtime.messages import LARGEST

LOOPBACK = "127.0.0.1"


class Channel(Protocol):
    """One end of a link."""

    def send(self, data: bytes) -> None:
        """Send a datagram, or lose it."""

    def receive(self, timeout: float) -> bytes | None:
        """Wait for a datagram at most so many seconds (zero: not at all); None if none came."""

    def close(self) -> None:
        """Let go of the link."""


class QueueChannel:
    """One end of a pair of queues within the process."""

    def __init__(self, inbox: queue.SimpleQueue[bytes], outbox: queue.SimpleQueue[bytes]) -> None:
        self._inbox, self._outbox = inbox, outbox

    @staticmethod
    def pair() -> tuple[QueueChannel, QueueChannel]:
        """Two ends that are linked."""
        one: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        other: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        return QueueChannel(one, other), QueueChannel(other, one)

    def send(self, data: bytes) -> None:
        """Send a datagram."""
        self._outbox.put(data)

    def receive(self, timeout: float) -> bytes | None:
        """Wait for a datagram."""
        try:
            return self._inbox.get(timeout=timeout) if timeout > 0 else self._inbox.get_nowait()
        except queue.Empty:
            return None

    def close(self) -> None:
        """Nothing to let go of."""


class SocketChannel:
    """A datagram socket: one of a local pair, or UDP.

    Parameters
    ----------
    sock : socket.socket
        Of datagrams. Can be handed to a spawned process with the channel.
    peer : (str, int), optional
        UDP: the only address that is listened to and sent to. Without one, the address of the first datagram that
        :meth:`lock` is called for.

    Attributes
    ----------
    strangers : int
        Datagrams from other addresses, which were dropped.
    """

    def __init__(self, sock: socket.socket, peer: tuple[str, int] | None = None) -> None:
        sock.setblocking(False)
        self._socket, self._peer = sock, peer
        self._udp = sock.family != getattr(socket, "AF_UNIX", None)
        self._last: tuple[str, int] | None = None
        self.strangers = 0

    @staticmethod
    def pair() -> tuple[SocketChannel, SocketChannel]:
        """Two linked ends for two processes of one machine; UDP where it has nothing more private."""
        if not hasattr(socket, "AF_UNIX"):
            return SocketChannel.udp_pair()
        one, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        return SocketChannel(one), SocketChannel(other)

    @staticmethod
    def udp_pair() -> tuple[SocketChannel, SocketChannel]:
        """Two ends of a UDP link on loopback, at ports that are free."""
        ends = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
        for end in ends:
            end.bind((LOOPBACK, 0))
        one, other = ends
        return SocketChannel(one, other.getsockname()), SocketChannel(other, one.getsockname())

    @staticmethod
    def listen(port: int) -> SocketChannel:
        """Wait at a UDP port of loopback for whoever comes first.

        Raises
        ------
        InputError
            If the port is taken.
        """
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            sock.bind((LOOPBACK, port))
        except OSError as error:
            sock.close()
            raise InputError(f"port {port} cannot be listened at ({error.strerror}); choose another") from None
        return SocketChannel(sock)

    @property
    def address(self) -> tuple[str, int]:
        """Address of this end (UDP)."""
        host, port = self._socket.getsockname()[:2]
        return str(host), int(port)

    def lock(self) -> None:
        """From now on know no one but the sender of the last datagram."""
        self._peer = self._peer or self._last

    def send(self, data: bytes) -> None:
        """Send a datagram, or lose it."""
        try:
            if not self._udp:
                self._socket.send(data)
            elif self._peer is not None:
                self._socket.sendto(data, self._peer)
        except OSError:  # no room, or nobody there: lost
            return

    def receive(self, timeout: float) -> bytes | None:
        """Wait for a datagram."""
        until = time.monotonic() + timeout
        while True:
            try:
                # one byte more than the largest message, so that a longer datagram is seen to be no message
                data, sender = self._socket.recvfrom(LARGEST + 1)
            except (BlockingIOError, InterruptedError):
                left = until - time.monotonic()
                if left <= 0 or not select.select([self._socket], [], [], left)[0]:
                    return None
                continue
            except OSError:  # a peer that is gone, on some systems
                if time.monotonic() >= until:
                    return None
                time.sleep(min(1e-3, max(until - time.monotonic(), 0.0)))
                continue
            if self._udp and self._peer is not None and sender != self._peer:
                self.strangers += 1
                if time.monotonic() >= until:  # a flood of them must not keep the receiver
                    return None
                continue
            self._last = sender or None
            return data

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
