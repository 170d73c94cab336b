"""What may be asked of a flight, and what is said of the rest."""

import numpy as np
import pytest

from aerotube.errors import InputError
from aerotube.runtime.options import SHORTEST, Options, check_beat


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
