"""The nominal as it is moved in flight."""

import numpy as np

from aerotube.runtime.guidance import Guidance
from tests.samples import aircraft, table2


def test_guidance_moves_only_what_is_still_to_come():
    nominal = table2(12)
    guidance = Guidance(aircraft(), nominal, change=0.05, seed=4)
    first = guidance.update(0, 0)
    second = guidance.update(0, 6)
    assert np.array_equal(first.states[:7], second.states[:7])
    assert np.array_equal(first.controls[:6], second.controls[:6])
    assert not np.allclose(first.controls[6:], second.controls[6:])
    step = aircraft().compiled_step()
    for t in range(12):
        ahead = step(second.states[t][None], second.controls[t][None], np.ones((1, 1)), np.zeros((1, 6)), nominal.dt, 1)
        assert np.abs(ahead[0] - second.states[t + 1]).max() < 1e-9
    assert Guidance(aircraft(), nominal).update(3, 6) is nominal
