import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aerotube.errors import InputError
from aerotube.flight import draw

BOX = np.array([5.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07])
SEEDS = st.lists(st.integers(0, 2**40), min_size=1, max_size=4, unique=True)


@settings(max_examples=25, deadline=None)
@given(SEEDS, st.integers(1, 7), st.integers(1, 9), st.integers(1, 5))
def test_a_run_keeps_its_numbers_whatever_else_is_drawn(seeds, few, more, beats):
    alone = draw(BOX, seeds[-1:], few, mass_error=0.05)
    among = draw(BOX, seeds, few + more, mass_error=0.05, other_parameters=[(2.0, 3.0)])
    own = slice(among.runs - few - more, among.runs - more)
    np.testing.assert_array_equal(among.initial_error[own], alone.initial_error)
    np.testing.assert_array_equal(among.parameters[own, :1], alone.parameters)
    longer = among.measurement_noise(beats + 3)[own, :beats]
    np.testing.assert_array_equal(longer, alone.measurement_noise(beats))
    np.testing.assert_array_equal(among.gust_noise(beats + 3, 8)[own, :beats], alone.gust_noise(beats, 8))


def test_runs_and_purposes_are_independent():
    draws = draw(np.ones(8), [0, 1], 200, mass_error=0.5)
    columns = [
        draws.initial_error,
        draws.parameters,
        draws.measurement_noise(3).reshape(400, -1),
        draws.gust_noise(3, 8).reshape(400, -1),
    ]
    correlation = np.corrcoef(np.concatenate(columns, axis=1).T)
    # Correlations of independent columns of 400 are normal with deviation 1/20; the bound is 6 deviations.
    assert np.max(np.abs(correlation - np.eye(len(correlation)))) < 0.3
    assert len(np.unique(draws.measurement_noise(3))) == 400 * 3 * 8


def test_draws_fill_their_box_evenly():
    draws = draw(BOX, [3], 4000, mass_error=0.05)
    for sample in (draws.initial_error, draws.measurement_noise(1)[:, 0]):
        scaled = sample / BOX
        assert np.all(np.abs(scaled) <= 1)
        # Mean and variance of a uniform number, 5 standard errors.
        assert np.all(np.abs(scaled.mean(0)) < 5 * np.sqrt(1 / 3 / 4000))
        assert np.all(np.abs((scaled**2).mean(0) - 1 / 3) < 5 * np.sqrt(4 / 45 / 4000))


def test_mass_is_uniform_in_mass():
    inverse = draw(BOX, [5], 4000, mass_error=0.3).parameters[:, 0]
    error = (1 / inverse - 1) / 0.3
    assert np.all(np.abs(error) <= 1 + 1e-12)
    assert abs(error.mean()) < 5 * np.sqrt(1 / 3 / 4000)
    assert abs((error**2).mean() - 1 / 3) < 5 * np.sqrt(4 / 45 / 4000)


def test_further_parameters_leave_the_others_their_numbers():
    """A parameter given as an inverse ratio is uniform in what it is the inverse of."""
    ranges = [(0.8, 1.2), (0.9, 1.1)]
    alone = draw(BOX, [5], 4000, mass_error=0.05)
    both = draw(BOX, [5], 4000, mass_error=0.05, other_parameters=ranges, inverse=(0, 1))
    np.testing.assert_array_equal(both.initial_error, alone.initial_error)
    np.testing.assert_array_equal(both.parameters[:, :1], alone.parameters)
    for quantity, (_, upper) in zip((1 / both.parameters[:, 1], both.parameters[:, 2]), ranges, strict=True):
        scaled = (quantity - 1) / (upper - 1)
        assert np.all(np.abs(scaled) <= 1 + 1e-12)
        assert abs(scaled.mean()) < 5 * np.sqrt(1 / 3 / 4000)
        assert abs((scaled**2).mean() - 1 / 3) < 5 * np.sqrt(4 / 45 / 4000)


def test_no_disturbance_is_exactly_none():
    draws = draw(np.zeros(8), range(2), 3)
    assert not draws.initial_error.any()
    assert not draws.measurement_noise(4).any()
    assert np.all(draws.parameters == 1)


def test_runs_are_named_by_seed():
    draws = draw(BOX, [7, 9], 10)
    assert draws.name(13) == "run 3 of seed 9"
    assert draws.runs == 20


@pytest.mark.parametrize(
    ("box", "seeds", "runs", "options", "words"),
    [
        (BOX[:7], [0], 1, {}, "8 finite half-widths"),
        (-BOX, [0], 1, {}, "none negative"),
        (BOX * np.nan, [0], 1, {}, "finite"),
        (BOX, [], 1, {}, "empty"),
        (BOX, [1, 1], 1, {}, "twice"),
        (BOX, [-1], 1, {}, "none negative"),
        (BOX, [0.5], 1, {}, "whole numbers"),
        (BOX, [0], 0, {}, "at least 1"),
        (BOX, [0], 1, {"mass_error": 1.0}, "less than 1"),
        (BOX, [0], 1, {"other_parameters": [(2.0, 1.0)]}, "lower <= upper"),
    ],
)
def test_mistakes_are_named(box, seeds, runs, options, words):
    with pytest.raises(InputError, match=words):
        draw(box, seeds, runs, **options)
