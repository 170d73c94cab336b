r"""Datagrams between an aircraft and its controller: typed, of fixed size, numbered, and checked.

Every message is one datagram, little-endian:

====== ===== ========= ==========================================================================
offset bytes type      meaning
====== ===== ========= ==========================================================================
0      4     bytes     ``AERO``
4      1     uint8     version of this layout, 1
5      1     uint8     kind: 1 hello, 2 measurement, 3 command, 4 heartbeat, 5 goodbye
6      2     uint16    flags; of a command: what stands behind it (`Rung`), else 0
8      8     uint64    session token, chosen by the aircraft and repeated by both sides
16     4     uint32    sequence number, one more with every message of its sender
20     4     uint32    beat that the message is about, counted from take-off
24     8     float64   sender's clock, s; for the record only
32     8 n   float64   values, as many as the kind has
end-4  4     uint32    CRC-32 (zlib's) of all bytes before
====== ===== ========= ==========================================================================

========== ==== ==========================================================================================
kind       n    values
========== ==== ==========================================================================================
hello      4    aircraft: length of a beat (s of flight), beats of a manoeuvre, states it measures, seconds
                of flight for one second of the clock; the controller answers with the same values when it
                is ready to fly
measured   16   the full state as measured (SI; velocity in body axes, quaternion, body rates, position with
                altitude up, then the aircraft's own states), zeros after the last
command    4    controls, SI (throttle 0 to 1)
heartbeat  0    from the controller, now and then: it lives
goodbye    0    either side ends the session
========== ==== ==========================================================================================

The aircraft's day: send hello until the controller answers with hello; then, at the start of every beat, send a
measurement with the beat's number and take the command of that number when it comes; hold the last command where
none comes; say goodbye. A command may come late or not at all, and the controller says in its log why.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum

MAGIC, VERSION = b"AERO", 1
_HEAD = struct.Struct("<4sBBHQIId")
_CHECK = struct.Struct("<I")
STATES = 16
"""Places for states in a measurement."""


class Kind(IntEnum):
    """What a message is."""

    HELLO = 1
    MEASUREMENT = 2
    COMMAND = 3
    HEARTBEAT = 4
    GOODBYE = 5


class Rung(IntEnum):
    """What stands behind a command: the ladder of fallbacks, best first."""

    PLANNED = 0
    """A certified law, made or kept for this beat."""
    ANYTIME = 1
    """The law as it stood when the solver's time was up, certified as it is."""
    LAST = 2
    """The law of an earlier beat, certified for this one too."""
    LQR = 3
    """The gain of a linear-quadratic regulator, not certified."""
    NOMINAL = 4
    """The nominal control alone."""


_VALUES = {Kind.HELLO: 4, Kind.MEASUREMENT: STATES, Kind.COMMAND: 4, Kind.HEARTBEAT: 0, Kind.GOODBYE: 0}
_BODIES = {kind: struct.Struct(f"<{count}d") for kind, count in _VALUES.items()}
_SIZES = {kind: _HEAD.size + body.size + _CHECK.size for kind, body in _BODIES.items()}
LARGEST = max(_SIZES.values())
"""Bytes of the largest message."""


class Refused(Exception):
    """A datagram that is not taken; its text is the reason in a word or two."""


@dataclass(frozen=True)
class Message:
    """A message of any kind; see the module's text for the fields.

    Attributes
    ----------
    kind : Kind
    token, sequence, beat : int
    time : float
    values : tuple of float
    flags : int
    """

    kind: Kind
    token: int
    sequence: int
    beat: int = 0
    time: float = 0.0
    values: tuple[float, ...] = ()
    flags: int = 0

    def encode(self) -> bytes:
        """Bytes of the datagram; ValueError for a number of values that the kind does not have."""
        if len(self.values) != _VALUES[self.kind]:
            raise ValueError(f"a {self.kind.name.lower()} has {_VALUES[self.kind]} values, not {len(self.values)}")
        head = _HEAD.pack(
            MAGIC, VERSION, self.kind, self.flags, self.token, self.sequence, self.beat & 0xFFFFFFFF, self.time
        )
        body = head + _BODIES[self.kind].pack(*self.values)
        return body + _CHECK.pack(zlib.crc32(body))


def decode(data: bytes, token: int | None = None) -> Message:
    """Read a datagram.

    Parameters
    ----------
    data : bytes
        Anything at all.
    token : int, optional
        The session's; messages of another are refused. None: any is taken.

    Returns
    -------
    Message

    Raises
    ------
    Refused
        If it is no whole message of this version, or not of this session. Never anything else.
    """
    if len(data) < _HEAD.size + _CHECK.size or data[:4] != MAGIC:
        raise Refused("garbage")
    if data[4] != VERSION:
        raise Refused("other version")
    try:
        kind = Kind(data[5])
    except ValueError:
        raise Refused("unknown kind") from None
    if len(data) != _SIZES[kind]:
        raise Refused("wrong length")
    if _CHECK.unpack_from(data, len(data) - _CHECK.size)[0] != zlib.crc32(data[: -_CHECK.size]):
        raise Refused("checksum")
    _, _, _, flags, sender, sequence, beat, time = _HEAD.unpack_from(data)
    if token is not None and sender != token:
        raise Refused("alien sender")
    return Message(kind, sender, sequence, beat, time, _BODIES[kind].unpack_from(data, _HEAD.size), flags)
