"""Datagrams: what is sent arrives, and nothing else is taken."""

import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aerotube.runtime.channels import QueueChannel, SocketChannel
from aerotube.runtime.messages import LARGEST, Kind, Message, Refused, decode
from aerotube.runtime.session import Session

COUNT = {Kind.HELLO: 4, Kind.MEASUREMENT: 16, Kind.COMMAND: 4, Kind.HEARTBEAT: 0, Kind.GOODBYE: 0}


@st.composite
def messages(draw):
    kind = draw(st.sampled_from(Kind))
    numbers = st.floats(allow_nan=False)
    return Message(
        kind,
        draw(st.integers(0, 2**64 - 1)),
        draw(st.integers(0, 2**32 - 1)),
        draw(st.integers(0, 2**32 - 1)),
        draw(numbers),
        tuple(draw(st.lists(numbers, min_size=COUNT[kind], max_size=COUNT[kind]))),
        draw(st.integers(0, 2**16 - 1)),
    )


@given(messages())
def test_round_trip(message):
    assert decode(message.encode(), message.token) == message


def test_layout_is_as_documented():
    """Written by hand from the table in the module's text."""
    body = struct.pack("<4sBBHQIId4d", b"AERO", 1, 3, 2, 77, 5, 12, 1.5, -0.1, 0.75, 0.0, 0.25)
    data = body + struct.pack("<I", zlib.crc32(body))
    assert decode(data, 77) == Message(Kind.COMMAND, 77, 5, 12, 1.5, (-0.1, 0.75, 0.0, 0.25), 2)
    assert Message(Kind.COMMAND, 77, 5, 12, 1.5, (-0.1, 0.75, 0.0, 0.25), 2).encode() == data


@given(st.binary(max_size=300))
def test_garbage_is_refused_and_nothing_else_happens(data):
    with pytest.raises(Refused):
        decode(data)


@given(messages(), st.data())
def test_a_spoiled_datagram_is_refused(message, data):
    """Any change of up to three bits next to each other is one that CRC-32 finds."""
    whole = message.encode()
    place = data.draw(st.integers(0, len(whole) - 1))
    flip = data.draw(st.sampled_from([1, 2, 4, 8, 16, 32, 64, 128, 3, 6, 7, 224]))
    spoiled = whole[:place] + bytes([whole[place] ^ flip]) + whole[place + 1 :]
    with pytest.raises(Refused):
        decode(spoiled, message.token)
    with pytest.raises(Refused):
        decode(whole[: data.draw(st.integers(0, len(whole) - 1))], message.token)
    with pytest.raises(Refused, match="alien"):
        decode(whole, message.token ^ 1)


@pytest.mark.parametrize("pair", [QueueChannel.pair, SocketChannel.pair, SocketChannel.udp_pair])
def test_channels_carry_datagrams_whole_and_in_order(pair):
    one, other = pair()
    for i in range(20):
        one.send(bytes([i]) * (i + 1))
    assert [other.receive(1.0) for _ in range(20)] == [bytes([i]) * (i + 1) for i in range(20)]
    assert other.receive(0.0) is None
    other.send(b"back")
    assert one.receive(1.0) == b"back"
    one.close()
    other.send(b"nobody is there")
    other.close()


def test_strangers_are_not_heard():
    one, other = SocketChannel.udp_pair()
    stranger, _ = SocketChannel.udp_pair()
    stranger._peer = other.address
    stranger.send(b"let me in")
    one.send(b"it is me")
    assert other.receive(1.0) == b"it is me"
    assert other.strangers == 1


def test_session_takes_only_what_is_new_and_its_own():
    one, other = QueueChannel.pair()
    sender, receiver = Session(one, 7), Session(other, 7)
    sender.send(Kind.HEARTBEAT, 1)
    sender.send(Kind.HEARTBEAT, 2)
    first, second = other.receive(0.0), other.receive(0.0)
    for data in (b"\0" * (LARGEST + 1), first, first, second, first, Message(Kind.GOODBYE, 8, 99).encode()):
        one.send(data)
    found = [receiver.receive(0.2) for _ in range(2)]
    assert [message.beat for message in found] == [1, 2]
    assert receiver.receive(0.2) is None
    assert receiver.refused == {"garbage": 1, "repeated": 1, "out of order": 1, "alien sender": 1}


def test_a_session_without_a_token_takes_that_of_the_first_hello():
    one, other = QueueChannel.pair()
    receiver = Session(other, None)
    one.send(Message(Kind.MEASUREMENT, 3, 1, values=(0.0,) * 16).encode())
    one.send(Message(Kind.HELLO, 5, 1, values=(0.05, 60.0, 13.0, 1.0)).encode())
    one.send(Message(Kind.GOODBYE, 3, 2).encode())
    one.send(Message(Kind.GOODBYE, 5, 2).encode())
    assert receiver.receive(0.2).kind == Kind.HELLO
    assert receiver.receive(0.2).token == 5
    assert receiver.refused == {"alien sender": 2}
