"""Faults of the link: what is done to the measurements is what is told of it."""

import numpy as np
import pytest

from aerotube.errors import InputError
from aerotube.runtime.channels import QueueChannel
from aerotube.runtime.faults import LINK, WORKERS, Faults, FaultyChannel
from aerotube.runtime.messages import Kind, Message, Refused, decode
from aerotube.runtime.workers import Killed


def through(kind, beats=400, seed=0):
    """What arrives of so many measurements, each hit by one kind of fault; the faults; and what was sent."""
    home, away = QueueChannel.pair()
    values = np.random.default_rng(seed).normal(size=(beats, 16))
    sent = [Message(Kind.MEASUREMENT, 7, b, b, 0.0, tuple(values[b].tolist())).encode() for b in range(beats)]
    faults = Faults(dict.fromkeys(range(beats), kind), seed=seed)
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


@pytest.mark.parametrize(("count", "beats", "windows"), [(0, 12, 1), (6, 60, 3), (15, 12, 3), (300, 720, 119)])
@pytest.mark.parametrize("seed", range(3))
def test_as_many_faults_come_as_are_asked_for_all_kinds_together(count, beats, windows, seed):
    starts = [6 * (w + 1) for w in range(windows)]
    faults = Faults.spread(count, beats, starts, seed, stall=0.0)
    assert len(faults.of_beats) + len(faults.of_windows) == count
    for beat in (*range(beats), *range(beats)):
        faults.of_link(beat)
    for start in (*starts, *starts):
        try:
            faults.wrap(lambda: None, start)()
        except Killed:
            assert start in faults.windows
    assert sum(faults.injected.values()) == count
    assert set(faults.injected) <= {*LINK, *WORKERS}


def test_more_faults_than_places_are_refused():
    with pytest.raises(InputError, match="room for 15"):
        Faults.spread(16, 12, [6, 12, 18], 0, stall=0.0)
