from dataclasses import replace

import numpy as np
import pytest

from aerotube.aircraft import F16
from aerotube.compensation import LinearLaw, SynthesisSettings, synthesise
from aerotube.dynamics import error_map
from aerotube.errors import InputError
from aerotube.tube import DisturbanceBox, ellipsoid, parameter_ranges
from aerotube.verify import Adversity, falsify
from tests.samples import BOX, aircraft, table2

BEATS = 2
SIZE, ELLIPSOID = 0, 1


@pytest.fixture(scope="module")
def made():
    return synthesise(aircraft(), table2(BEATS), BOX)


def search(made, box=BOX, **options):
    options = {"samples": 200, "ascents": 15} | options
    return falsify(aircraft(), table2(BEATS), box, made, **options)


ALONE = Adversity()
EVERYTHING = Adversity(1.0, BOX.half_widths, np.array([2.0, 2.0, 2.0, 0.01, 0.01, 0.01]))


def test_the_search_comes_close_to_the_bound(made):
    """Against everything that it promises to withstand, the worst found is within a few percent of a tube."""
    found = search(made, samples=1000, ascents=30)
    assert (found.ratio > 0.9).all()
    assert not found.broken.any()


@pytest.mark.parametrize("adversity", [ALONE, Adversity(0.5), EVERYTHING], ids=["alone", "others", "everything"])
def test_what_is_found_is_in_the_set_and_does_what_is_said(made, adversity):
    found, tubes = search(made, adversity=adversity), made.tubes
    for beat, index, form in np.ndindex(found.ratio.shape):
        error = found.error[beat, index, form]
        for other, part in enumerate(tubes.parts):
            share = 1.0 if other == index else adversity.others
            size = error[list(part.errors)] @ tubes.initial_shape[beat, other] @ error[list(part.errors)]
            assert size <= share**2 * tubes.initial_rho[beat, other] * (1 + 1e-9)
        (low, high), sigma = parameter_ranges(aircraft(), BOX.relative)[0], found.parameters[beat, index, form, 0]
        assert low <= sigma <= high
        assert (np.abs(found.measurement_error[beat, index, form]) <= adversity.measurement).all()
        assert (np.abs(found.wind[beat, index, form]) <= adversity.wind).all()
        if adversity is EVERYTHING or form != SIZE:
            continue
        push = made.law.increment(beat, error)
        end = error_map(
            aircraft(), table2(BEATS), [beat], made.law.coordinates, error[None, None],
            increment=push[None, None], parameters=found.parameters[beat, index, form][None, None],
        )[0, 0, tubes.parts[index].errors]  # fmt: skip
        size = end @ tubes.metric[beat, index] @ end / tubes.size[beat, index]
        # flown with the controls realised, not with the increments themselves
        assert size == pytest.approx(found.ratio[beat, index, form], rel=2e-3)


def test_errors_measurements_parameters_and_wind_are_all_used(made):
    """What is found is worse with every kind of adversity, and on the edge of it."""
    found = search(made, adversity=EVERYTHING)
    assert np.all(np.abs(found.measurement_error).max(axis=-2) > 0.9 * BOX.half_widths.min())
    assert np.all(np.abs(found.wind).max(axis=(0, 1, 2)) == pytest.approx(EVERYTHING.wind))
    alone = search(made, adversity=ALONE).ratio
    for more in (Adversity(1.0), Adversity(0.0, BOX.half_widths), Adversity(0.0, wind=EVERYTHING.wind)):
        assert (search(made, adversity=more).ratio > alone).all()


def test_a_measurement_error_of_each_beat(made):
    widths = np.stack([np.zeros(8), BOX.half_widths])
    found = search(made, adversity=Adversity(0.0, widths)).ratio
    np.testing.assert_array_equal(found[0], search(made, adversity=ALONE).ratio[0])
    np.testing.assert_array_equal(found[1], search(made, adversity=Adversity(0.0, BOX.half_widths)).ratio[1])


def test_climbing_finds_more_than_drawing(made):
    drawn = search(made, samples=50, ascents=0, adversity=EVERYTHING)
    climbed = search(made, samples=50, ascents=15, adversity=EVERYTHING)
    assert (climbed.ratio >= drawn.ratio * (1 - 1e-12)).all()
    assert climbed.ratio.max() > drawn.ratio.max()


def test_a_law_that_is_known_by_its_increments_only(made):
    class Other:
        coordinates = made.law.coordinates

        def increment(self, beat, error):
            return made.law.increment(beat, error)

    np.testing.assert_array_equal(search(replace(made, law=Other())).ratio, search(made).ratio)


def test_numbers_do_not_depend_on_workers_or_on_other_beats(made):
    whole = search(made, seed=3, samples=12_000, ascents=3)
    again = search(made, seed=3, samples=12_000, ascents=3, workers=3)
    np.testing.assert_array_equal(whole.error, again.error)
    one = search(made, seed=3, samples=12_000, ascents=3, beats=[1])
    np.testing.assert_array_equal(one.ratio[1], whole.ratio[1])
    assert np.isnan(one.ratio[0]).all()


def test_an_interruption_keeps_what_is_done(made):
    def interrupt(done, total):
        raise KeyboardInterrupt

    found = search(made, progress=interrupt)
    assert found.interrupted
    assert np.isfinite(found.ratio).any()


def test_a_tube_that_does_not_exist_is_left_out(made):
    size = made.tubes.size.copy()
    size[1, 0] = np.nan
    found = search(replace(made, tubes=replace(made.tubes, size=size)))
    assert np.isnan(found.ratio[1, 0, SIZE])
    assert not found.broken[1, 0, SIZE]
    assert np.isnan(found.ratio).sum() == 1


def test_initial_ellipsoids_hold_the_box_that_the_search_starts_from(made):
    tubes = made.tubes
    widths = made.law.coordinates.box(table2(BEATS).states[:-1], BOX.half_widths)
    for index, part in enumerate(tubes.parts):
        least = ellipsoid.least_size_around_box(tubes.initial_shape[:, index], widths[:, part.errors])
        assert (least <= tubes.initial_rho[:, index] * (1 + 1e-9)).all()


def test_a_law_reversed_breaks_its_tubes(made):
    other = replace(made, law=LinearLaw(-made.law.gains, made.law.coordinates))
    assert search(other).broken.all()


@pytest.mark.parametrize("options", [{"samples": 0}, {"starts": 0}, {"ascents": -1}, {"beats": [2]}])
def test_numbers_out_of_range_are_refused(made, options):
    with pytest.raises(InputError, match="falsify"):
        search(made, **options)


@pytest.mark.parametrize("wrong", [{"others": -1.0}, {"measurement": -BOX.half_widths}, {"wind": np.ones(5)}])
def test_adversities_that_make_no_sense_are_refused(wrong):
    with pytest.raises(InputError, match="falsify"):
        Adversity(**wrong)


@pytest.mark.parametrize(
    "settings",
    [{"law_degree": 2}, {"gust": 2.0, "gust_rotation": 0.01}, {"attitude": "euler"}, {"algorithm": "coupled"}],
    ids=["polynomial", "gusts", "euler", "coupled"],
)
def test_laws_and_sets_of_every_kind(settings):
    """With four uncertain parameters: sizes hold against all of it, and hardly more than that."""
    plane = F16(uncertain=("mass", "inertia", "lift", "control_effectiveness"))
    box = DisturbanceBox(BOX.half_widths, dict.fromkeys(("mass", "inertia", "lift", "control_effectiveness"), 0.03))
    own = synthesise(plane, table2(1), box, SynthesisSettings(**settings))
    found = falsify(plane, table2(1), box, own, samples=300, ascents=15)
    assert not found.broken[..., SIZE].any()
    assert (found.ratio[..., SIZE] > 0.95).all()
    assert (found.parameters != 1.0).any(axis=(0, 1, 2)).all()
    assert found.wind.any() == ("gust" in settings)
    smaller = replace(own, tubes=replace(own.tubes, size=0.94 * own.tubes.size))
    assert falsify(plane, table2(1), box, smaller, samples=300, ascents=15).broken[..., SIZE].all()
