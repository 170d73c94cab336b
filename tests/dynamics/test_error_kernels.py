"""Compiled error coordinates against those written for arrays."""

import numpy as np
import pytest

from aerotube.dynamics import ErrorCoordinates
from aerotube.dynamics.error_kernels import difference, difference_each, moved, moved_each
from tests.samples import HALF_WIDTHS, table2

NOMINAL = table2(4)


@pytest.mark.parametrize("kind", ["relative", "euler"])
def test_compiled_error_is_that_of_the_coordinates(kind):
    random = np.random.default_rng(3)
    coordinates = ErrorCoordinates(kind)
    states = ErrorCoordinates("euler").retract(NOMINAL.states[1], random.uniform(-3, 3, (200, 8)) * HALF_WIDTHS)
    expected = coordinates.difference(states, NOMINAL.states[2])
    found = np.stack([difference(state, NOMINAL.states[2], kind == "relative") for state in states])
    assert found == pytest.approx(expected, abs=1e-12)


def test_compiled_states_are_those_of_the_coordinates():
    random = np.random.default_rng(5)
    errors = random.uniform(-3, 3, (100, 8)) * HALF_WIDTHS
    expected = ErrorCoordinates().retract(NOMINAL.states[2], errors)[:, :10]
    found = np.stack([moved(NOMINAL.states[2], error) for error in errors])
    assert found == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("kind", ["relative", "euler"])
def test_batches_are_states_one_by_one(kind):
    random = np.random.default_rng(6)
    coordinates, nominal = ErrorCoordinates(kind), NOMINAL.states[:3]
    errors = random.uniform(-3, 3, (3, 20, 8)) * HALF_WIDTHS
    states = coordinates.retract(nominal[:, None], errors)
    assert difference_each(states, nominal, kind == "relative") == pytest.approx(errors, abs=1e-12)
    if kind == "relative":
        assert moved_each(nominal, errors) == pytest.approx(states, abs=1e-12)
