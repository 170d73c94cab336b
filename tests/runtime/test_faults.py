"""Faults of the link: what is done to the measurements is what is told of it."""

import numpy as np
import pytest

from aerotube.runtime.channels import QueueChannel
from aerotube.runtime.faults import Faults, FaultyChannel
from aerotube.runtime.messages import Kind, Message, Refused, decode


def through(kind, beats=400, seed=0):
    """What arrives of so many measurements, each hit by one kind of fault; the faults; and what was sent."""
    home, away = QueueChannel.pair()
    values = np.random.default_rng(seed).normal(size=(beats, 16))
    sent = [Message(Kind.MEASUREMENT, 7, b, b, 0.0, tuple(values[b].tolist())).encode() for b in range(beats)]
    faults = Faults(1.0, seed, kinds=(kind,))
    channel = FaultyChannel(home, faults)
    arrived = []
    for data in sent:
        away.send(data)
        while (got := channel.receive(0.0)) is not None:
            arrived.append(got)
    assert faults.injected == {kind: beats}
    return arrived, faults, sent


def is_refused(data):
    try:
        decode(data, 7)
    except Refused:
        return True
    return False


@pytest.mark.parametrize("seed", range(3))
def test_a_corrupt_datagram_always_differs_and_is_always_refused(seed):
    arrived, _, sent = through("corrupt", 4000, seed)
    assert len(arrived) == len(sent)
    assert all(one != other for one, other in zip(arrived, sent, strict=True))
    assert all(is_refused(data) for data in arrived)


def test_measurements_replayed_are_old_ones_and_their_beats_are_told():
    arrived, faults, sent = through("replay")
    assert len(arrived) == 2 * len(sent)
    replayed = [decode(data).beat for data in arrived[::2]]
    assert arrived[1::2] == sent
    assert arrived[::2] == [sent[beat] for beat in replayed]
    assert faults.given_back == set(replayed)
    assert all(0 <= now - beat < 50 for now, beat in enumerate(replayed))
    assert any(now > beat for now, beat in enumerate(replayed))


def test_what_is_taken_away_is_told_of_and_nothing_else():
    for kind in ("drop", "nan", "spike", "alien", "garbage", "repeat", "delay"):
        arrived, faults, sent = through(kind, 60)
        assert faults.given_back == set()
        assert set(faults.by_beat) == set(range(60))
        whole = [data for data in arrived if data in sent]
        expected = {"drop": 0, "nan": 0, "spike": 0, "alien": 60, "garbage": 60, "repeat": 120}
        if kind == "delay":  # the last few have nothing behind them that would let them come
            assert 57 <= len(whole) < 60
        else:
            assert len(whole) == expected[kind]
        if kind in ("alien", "garbage"):
            assert sum(is_refused(data) for data in arrived) == 60
