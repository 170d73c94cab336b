import numpy as np
import pytest

from aerotube.compensation import LinearLaw
from aerotube.dynamics import ErrorCoordinates
from aerotube.errors import ComputationError, InputError
from aerotube.flight.library import build_library, nearby_nominals
from aerotube.preparation import error_states
from tests.samples import aircraft, table2

SCALE = np.array([75.0, *np.radians([17.5, 30, 60, 10, 50, 10, 90, 15]), 0.3, *np.radians([15, 25])])
BOX = 0.1 * SCALE


def made_up(nominal):
    """A law that tells which nominal it was made for."""
    gains = np.zeros((nominal.beats, 4, 8))
    gains[:, 0, 0] = nominal.states[:-1, 0]
    return LinearLaw(gains, ErrorCoordinates("relative"))


@pytest.fixture(scope="module")
def nominals():
    return nearby_nominals(aircraft(), table2(), BOX, 5, seed=1)


def test_at_a_stored_nominal_the_stored_law_is_flown(nominals):
    library = build_library(nominals, made_up, SCALE)
    for place, nominal in enumerate(nominals):
        entry, distance = library.nearest(nominal)
        np.testing.assert_array_equal(entry, place * 10 + np.arange(10))
        assert distance == pytest.approx(0.0, abs=1e-12)
        np.testing.assert_array_equal(library.law(nominal).gains, made_up(nominal).gains)


def test_the_nearest_is_the_nearest(nominals):
    library = build_library(nominals, made_up, SCALE)
    entry, distance = library.nearest(table2())
    for beat in range(table2().beats):
        # a second route: states as the scenario names them
        here = np.concatenate([error_states(table2().states[beat]), table2().controls[beat]])
        stored = np.concatenate(
            [np.concatenate([error_states(one.states[:-1]), one.controls], axis=-1) for one in nominals]
        )
        all_distances = np.sqrt(np.sum(((stored - here) / SCALE) ** 2, axis=-1))
        assert entry[beat] == np.argmin(all_distances)
        assert distance[beat] == pytest.approx(all_distances.min())


def test_nearby_manoeuvres_start_in_the_box_and_are_the_same_for_the_same_seed(nominals):
    again = nearby_nominals(aircraft(), table2(), BOX, 5, seed=1)
    other = nearby_nominals(aircraft(), table2(), BOX, 5, seed=2)
    for one, same, another in zip(nominals, again, other, strict=True):
        np.testing.assert_array_equal(one.states, same.states)
        assert not np.array_equal(one.states, another.states)
        start = ErrorCoordinates("euler").difference(one.states[0], table2().states[0])
        assert np.all(np.abs(start) <= BOX[:8] * (1 + 1e-9))
        moved = one.controls - table2().controls
        assert np.all(np.abs(moved) <= BOX[8:] * (1 + 1e-9))
        assert moved == pytest.approx(moved[:1].repeat(10, axis=0))
        one.check(aircraft())


def test_mistakes_are_named(nominals):
    with pytest.raises(InputError, match="no nominals"):
        build_library([], made_up, SCALE)
    with pytest.raises(InputError, match="12 positive"):
        build_library(nominals, made_up, np.zeros(12))
    with pytest.raises(ComputationError, match="smaller box"):
        nearby_nominals(aircraft(), table2(), 1e4 * BOX, 3, seed=1)
