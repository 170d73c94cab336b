from dataclasses import replace

import numpy as np
import pytest

from aerotube.compensation import LinearLaw, synthesise
from aerotube.dynamics import error_map
from aerotube.errors import InputError
from aerotube.tube import ellipsoid, parameter_ranges
from aerotube.verify import falsify
from tests.samples import BOX, aircraft, table2

BEATS = 2


@pytest.fixture(scope="module")
def made():
    return synthesise(aircraft(), table2(BEATS), BOX)


def search(made, **options):
    options = {"samples": 200, "ascents": 15, "metric": True} | options
    return falsify(aircraft(), table2(BEATS), BOX, made, **options)


def test_the_search_comes_close_to_the_bound(made):
    """Tubes in the synthesis's metric are tight: the worst found is within a few percent of the bound."""
    found = search(made)
    assert (found.ratio > 0.98).all()
    assert (found.ratio < 1.05).all()


def test_what_is_found_is_in_the_set_and_does_what_is_said(made):
    found = search(made, coupling=0.5)
    tubes = made.tubes
    for index, part in enumerate(tubes.parts):
        for beat in range(BEATS):
            own = found.error[beat, index, part.errors]
            assert own @ tubes.initial_shape[beat, index] @ own <= tubes.initial_rho[beat, index] * (1 + 1e-9)
            (low, high), sigma = parameter_ranges(aircraft(), BOX.relative)[0], found.parameters[beat, index, 0]
            assert low <= sigma <= high
            push = made.law.increment(beat, found.error[beat, index])
            end = error_map(
                aircraft(), table2(BEATS), [beat], made.law.coordinates, found.error[beat, index][None, None],
                increment=push[None, None], parameters=found.parameters[beat, index][None, None],
            )[0, 0, part.errors]  # fmt: skip
            size = end @ tubes.metric[beat, index] @ end
            assert size / tubes.size[beat, index] == pytest.approx(found.ratio[beat, index], rel=2e-3)


def test_a_tube_that_is_too_small_is_broken(made):
    shrunk = replace(made, tubes=replace(made.tubes, size=0.97 * made.tubes.size))
    assert search(shrunk).broken.all()


def test_the_tubes_of_another_law_are_broken(made):
    """A law with its gains reversed does not stay in the tubes of the one they were computed for."""
    other = replace(made, law=LinearLaw(-made.law.gains, made.law.coordinates))
    assert search(other).broken.all()


def test_the_other_half_and_measurement_errors_make_it_worse(made):
    alone = search(made).ratio
    assert (search(made, coupling=1.0).ratio > alone).all()
    assert (search(made, measurement_error=1.0).ratio > 1.01 * alone).all()


def test_climbing_finds_more_than_drawing(made):
    drawn = search(made, samples=50, ascents=0, coupling=1.0)
    climbed = search(made, samples=50, ascents=15, coupling=1.0)
    assert (climbed.ratio >= drawn.ratio).all()
    assert climbed.ratio.max() > drawn.ratio.max()


def test_the_same_seed_finds_the_same(made):
    np.testing.assert_array_equal(search(made, seed=3).error, search(made, seed=3).error)


def test_a_tube_that_does_not_exist_is_left_out(made):
    size = made.tubes.size.copy()
    size[1, 0] = np.nan
    found = search(replace(made, tubes=replace(made.tubes, size=size)))
    assert np.isnan(found.ratio[1, 0])
    assert not found.broken[1, 0]
    assert np.isfinite(np.delete(found.ratio.ravel(), 2)).all()


def test_initial_ellipsoids_hold_the_box_that_the_search_starts_from(made):
    tubes = made.tubes
    widths = made.law.coordinates.box(table2(BEATS).states[:-1], BOX.half_widths)
    for index, part in enumerate(tubes.parts):
        least = ellipsoid.least_size_around_box(tubes.initial_shape[:, index], widths[:, part.errors])
        assert (least <= tubes.initial_rho[:, index] * (1 + 1e-9)).all()


@pytest.mark.parametrize("options", [{"samples": 0}, {"starts": 0}, {"coupling": -1.0}, {"measurement_error": -0.1}])
def test_numbers_out_of_range_are_refused(made, options):
    with pytest.raises(InputError, match="falsify"):
        search(made, **options)
