"""What may be asked of a flight, and what is said of the rest."""

import numpy as np
import pytest

from aerotube.errors import InputError
from aerotube.runtime.options import SHORTEST, Options, check_beat, flown_options


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"speed": 0.0}, "speed is 0"),
        ({"window": 0}, "window is 0"),
        ({"reuse": -1, "window": 0}, "reuse is -1"),
        ({"delay": -1}, "delay is -1"),
        ({"faults": -2}, "faults is -2"),
        ({"tolerance": -0.5}, "event is -0.5"),
        ({"window": 5, "reuse": 1}, "window of 5"),
        ({"faults": 5, "speed": np.inf}, "clock"),
        ({"gusts": "foo"}, "'foo'; choose none, light, moderate or severe"),
        ({"port": 5555, "actuators": True}, "actuators is of the aircraft"),
        ({"port": 5555, "gusts": "light"}, "gusts is of the aircraft"),
        ({"deviation": "foo"}, "'foo'; choose paper or box"),
    ],
)
def test_mistakes_are_told_by_name_and_value(wrong, words):
    with pytest.raises(InputError, match=words):
        Options(**wrong)


def test_beats_too_short_for_the_runtime_are_refused_on_the_clock_only(prepared):
    least = prepared.nominal.dt / SHORTEST
    check_beat(prepared, Options(speed=0.99 * least))
    check_beat(prepared, Options(speed=np.inf))
    with pytest.raises(InputError, match="too short"):
        check_beat(prepared, Options(speed=1.01 * least))


def test_options_are_told_as_they_were_flown(prepared):
    told = flown_options(prepared, Options(tolerance=0.25, duration=10.0))
    assert not {"None", "False", "True", "inf"} & set(told.values())
    assert (told["noise"], told["gusts"], told["beat"]) == ("100 % of the disturbance box", "none", "50 ms")
    assert "25 %" in told["event"]
    assert told.keys() >= {"duration", "replan", "estimator", "algorithm"}
    assert "own" in flown_options(prepared, Options(port=5555))["gusts"]
