"""Laws of degree one to three: coordinates, evaluation, limits, saturation, rates."""

import itertools

import numpy as np
import pytest

from aerotube.compensation import SynthesisSettings, design, monomials
from aerotube.compensation.groundwork import available_increments
from aerotube.compensation.law import LinearLaw, PolynomialLaw
from aerotube.dynamics import ErrorCoordinates
from aerotube.errors import InputError
from aerotube.tube import DisturbanceBox
from tests.samples import BOX, HALF_WIDTHS, aircraft, table2

BEATS = 3
TINY = DisturbanceBox(1e-4 * HALF_WIDTHS, {})


def made(disturbance=BOX, **settings):
    return design(aircraft(), table2(BEATS), disturbance, SynthesisSettings(**settings))


def inside(result, rng, count=400):
    """Errors in the disturbance box, corners included: (beats, count, 8)."""
    widths = result.law.coordinates.box(table2(BEATS).states[:-1], HALF_WIDTHS)
    unit = rng.uniform(-1.0, 1.0, (BEATS, count, 8))
    unit[:, ::2] = np.sign(unit[:, ::2])
    return unit * widths[:, None]


@pytest.mark.parametrize(("variables", "degree"), [(4, 3), (3, 2), (8, 2), (2, 1)])
def test_a_polynomial_in_other_coordinates_is_the_same_polynomial(variables, degree):
    rng = np.random.default_rng(0)
    powers = monomials.exponents(variables, degree)
    table, A = rng.normal(size=(5, 2, len(powers))), rng.normal(size=(5, variables, variables))
    x = rng.normal(size=(5, 7, variables))
    there = np.einsum("bmp,bup->bum", table, monomials.values(np.einsum("bij,buj->bui", A, x), powers))
    here = np.einsum("bmp,bup->bum", monomials.substituted(table, A, degree), monomials.values(x, powers))
    np.testing.assert_allclose(here, there, rtol=1e-9, atol=1e-9)


def test_means_under_noise_are_the_means_over_noise():
    """Second route: noise that takes each of the values plus and minus one deviation, every combination."""
    rng = np.random.default_rng(1)
    deviation, points = np.array([0.1, 0.3, 0.2]), rng.normal(size=(6, 3))
    noise = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * deviation
    powers = monomials.exponents(3, 3)
    expected = np.mean([monomials.values(points + v, powers) for v in noise], axis=0)
    np.testing.assert_allclose(monomials.under_noise(points, np.diag(deviation**2), 3), expected, rtol=1e-12)


def test_moments_are_those_of_errors_uniform_in_a_box():
    powers = monomials.exponents(2, 2)
    found = monomials.moments(np.diag([1.0 / 3.0, 4.0 / 3.0]), 2)  # half-widths 1 and 2

    def mean(power):  # of u^p over [-w, w]
        return np.prod([0.0 if p % 2 else w**p / (p + 1) for p, w in zip(power, (1, 2), strict=True)])

    expected = [[mean(a + b) for b in powers] for a in powers]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_a_polynomial_law_is_its_polynomial_on_the_set_and_linear_plus_bounded_beyond():
    rng = np.random.default_rng(2)
    powers = np.vstack([np.eye(8, dtype=int), 2 * np.eye(8, dtype=int)[:1], 3 * np.eye(8, dtype=int)[:1]])
    table = rng.normal(size=(2, 4, 10))
    law = PolynomialLaw(
        table, powers, ErrorCoordinates(), None, np.tile(np.eye(8), (2, 1, 1)), ((0, 1, 2, 3), (4, 5, 6, 7))
    )
    near, far = 0.3 * rng.uniform(-1, 1, (2, 5, 8)), np.zeros((2, 1, 8))
    far[..., 0] = 50.0
    direct = np.einsum("bim,bum->bui", table, monomials.values(near, powers))
    np.testing.assert_allclose(law.increments(np.arange(2), near), direct, rtol=1e-12)
    np.testing.assert_allclose(law.increment(1, near[1]), direct[1], rtol=1e-12)
    beyond = 50.0 * table[:, :, 0] + table[:, :, 8] + table[:, :, 9]
    np.testing.assert_allclose(law.increments(np.arange(2), far)[:, 0], beyond, rtol=1e-12)
    np.testing.assert_allclose(law.gains, table[..., :8])


@pytest.mark.parametrize(("degree", "near"), [(2, 1e-5), (3, 0.02)])
def test_where_the_map_is_linear_a_law_of_higher_degree_is_worth_the_linear_one(degree, near):
    """The best law for a linear map and a quadratic cost is linear; the higher terms add nothing to speak of."""
    linear, higher = (made(TINY, law_degree=d, control_weight=0.1, least_expected=0.1) for d in (1, degree))
    assert isinstance(linear.law, LinearLaw)
    assert isinstance(higher.law, PolynomialLaw)
    assert higher.feasible.all()
    np.testing.assert_allclose(higher.bound, linear.bound, rtol=near)


@pytest.mark.parametrize(("degree", "limits"), [(1, "ellipsoid"), (2, "box"), (2, "ellipsoid"), (3, "box")])
def test_limits_hold_on_both_sides_on_the_set(degree, limits):
    result = made(law_degree=degree, limits=limits)
    assert result.feasible.all()
    plane, nominal = aircraft(), table2(BEATS)
    push = result.law.increments(np.arange(BEATS), inside(result, np.random.default_rng(degree)))
    reach = result.law.coordinates.box(nominal.states[:-1], HALF_WIDTHS)
    lower, upper = available_increments(plane, nominal.states[:-1], nominal.controls, result.law.coordinates, reach)
    scale = 1e-9 * (upper - lower)
    assert (push >= (lower - scale)[:, None]).all()
    assert (push <= (upper + scale)[:, None]).all()
    assert np.abs(push).max() > 0


def test_a_law_that_may_saturate_cuts_itself_off_and_is_cheaper():
    strict, free = made(), made(saturation=3.0)
    assert (free.bound <= strict.bound * (1 + 1e-6)).all()
    assert (free.bound < 0.99 * strict.bound).any()
    push = free.law.increments(np.arange(BEATS), 3.0 * inside(free, np.random.default_rng(0)))
    room = free.law.room
    assert (push >= room[:, None, :, 0]).all()
    assert (push <= room[:, None, :, 1]).all()
    assert (push == room[:, None, :, 1]).any()


def test_rates_hold_between_any_two_errors_of_neighbouring_beats():
    rates = np.array([0.3, 1e5, 0.5, 0.5])
    result = made(rate_limits=tuple(rates))
    assert result.feasible.all()
    rng = np.random.default_rng(3)
    push = result.law.increments(np.arange(BEATS), inside(result, rng))
    step = push[1:, :, None] - push[:-1, None]  # the nominal's controls are constant
    most = np.abs(step).max(axis=(0, 1, 2))
    assert (most <= rates * table2(BEATS).dt * (1 + 1e-9)).all()
    assert (np.abs(made().law.gains).sum(-1) > np.abs(result.law.gains).sum(-1)).any()


def test_a_rate_that_cannot_be_kept_is_named():
    with pytest.raises(InputError, match="rate_limits"):
        SynthesisSettings(rate_limits=(1.0, 0.0, 1.0, 1.0))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"law_degree": 4}, "law_degree"),
        ({"law_degree": 3, "algorithm": "coupled"}, "law_degree"),
        ({"law_degree": 3, "size": "trace"}, "trace"),
        ({"size": {"worst-case": -1.0}}, "worst-case"),
        ({"size": {}}, "empty"),
        ({"saturation": 0.5}, "saturation"),
        ({"formulation": "increment", "reuse": 1}, "reuse"),
        ({"steps": "four"}, "steps"),
    ],
)
def test_settings_that_do_not_go_together_are_named(change, words):
    with pytest.raises(InputError, match=words):
        SynthesisSettings(**change)
