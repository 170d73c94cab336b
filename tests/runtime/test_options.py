"""What may be asked of a flight, and what is said of the rest."""

import numpy as np
import pytest

from aerotube.errors import InputError
from aerotube.runtime.options import Options


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
