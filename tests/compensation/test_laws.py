"""Laws of degree one to three: coordinates, evaluation, limits, saturation, rates."""

import itertools

import numpy as np
import pytest

from aerotube.compensation import SynthesisSettings, design, expectation, monomials
from aerotube.compensation.closed_loop import end_errors
from aerotube.compensation.groundwork import available_increments, groundwork
from aerotube.compensation.law import LinearLaw, PolynomialLaw
from aerotube.compensation.task import Task
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


@pytest.mark.parametrize(("variables", "degree"), [(2, 3), (6, 2)])
def test_moments_are_those_of_normal_errors(variables, degree):
    """Products of Gauss rules in a few variables, the rule of degree five in many."""
    powers = monomials.exponents(variables, degree)
    deviations = 1.0 + np.arange(variables) / variables
    found = monomials.moments(np.diag(deviations**2), degree)

    def mean(power):  # of a product of normal variables: (p - 1)!! s^p each
        return np.prod(
            [0.0 if p % 2 else np.prod(np.arange(1, p, 2)) * s**p for p, s in zip(power, deviations, strict=True)]
        )

    expected = [[mean(a + b) for b in powers] for a in powers]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_a_polynomial_law_is_its_polynomial_on_the_set_and_goes_on_straight_beyond():
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
    np.testing.assert_allclose(law.increment(1, near[1, 0]), direct[1, 0], rtol=1e-12)
    beyond = 50.0 * (table[:, :, 0] + table[:, :, 8] + table[:, :, 9])
    np.testing.assert_allclose(law.increments(np.arange(2), far)[:, 0], beyond, rtol=1e-12)
    np.testing.assert_allclose(law.gains, table[..., :8])


@pytest.mark.parametrize("degree", [2, 3])
def test_where_the_map_is_linear_a_law_of_higher_degree_is_the_linear_one(degree):
    """The best law for a linear map and a quadratic cost is linear, whatever errors are expected."""
    linear, higher = (made(TINY, law_degree=d, control_weight=0.1) for d in (1, degree))
    assert isinstance(linear.law, LinearLaw)
    assert isinstance(higher.law, PolynomialLaw)
    assert higher.feasible.all()
    points = inside(linear, np.random.default_rng(0)) * (TINY.half_widths / HALF_WIDTHS)
    push = linear.law.increments(np.arange(BEATS), points)
    scale = np.abs(push).max(axis=1, keepdims=True)
    np.testing.assert_allclose(higher.law.increments(np.arange(BEATS), points) / scale, push / scale, atol=2e-3)


@pytest.mark.parametrize("degree", [2, 3])
def test_a_law_of_higher_degree_is_expected_to_cost_no_more_than_a_linear_one(degree):
    """Second route: draws of normal errors, flown by the true map with the law in the loop."""
    plane, nominal, beats = aircraft(), table2(BEATS), np.arange(BEATS)
    designs = [made(law_degree=d) for d in (1, degree)]
    settings = SynthesisSettings()
    ground = groundwork(plane, nominal, BOX, settings)
    task = Task(plane, nominal, BOX, settings, ground, 1, None)
    rng = np.random.default_rng(degree)
    for index, part in enumerate(settings.parts):
        e = list(part.errors)
        whitening = ground.parts[index].initial.whitening
        even = whitening @ np.swapaxes(whitening, 1, 2) / (3.0 * len(e))
        total = np.zeros((2, BEATS))
        for share, covariance in ((1.0, ground.expected.moment[:-1, e][:, :, e]), (settings.least_expected, even)):
            x = rng.normal(size=(BEATS, 4000, len(e))) @ np.swapaxes(np.linalg.cholesky(covariance), 1, 2)
            beyond = x @ np.swapaxes(expectation.beyond_own(task, index, beats), 1, 2)
            error = np.zeros((BEATS, 4000, 8))
            error[..., e] = x
            for place, design_ in enumerate(designs):
                end = end_errors(
                    plane, nominal, beats, ground.coordinates, part, x, ground.vertices, design_.law, of=tuple(range(8))
                )
                state = np.broadcast_to(beyond[:, None], (*end.shape[:3], beyond.shape[-1])).copy()
                state[..., :8] += end
                push = design_.law.increments(beats, error)
                metric = ground.parts[index].joint_metric
                total[place] += share * np.einsum("bkui,bij,bkuj->b", state, metric, state, optimize=True) / 8000
                total[place] += share * np.einsum("bui,bij,buj->b", push, ground.effort, push) / 4000
        linear, higher = total
        assert (higher <= linear * 1.002).all()


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
        ({"law_degree": 3, "size": "trace"}, "trace"),
        ({"size": {"worst-case": -1.0}}, "worst-case"),
        ({"size": {}}, "empty"),
        ({"saturation": 0.5}, "saturation"),
        ({"formulation": "increment", "reuse": 1}, "cannot share a law.*choose reuse = 0"),
        ({"coupling": "carried", "law_degree": 2}, "at their worst only where the size is"),
        ({"steps": "four"}, "steps"),
    ],
)
def test_settings_that_do_not_go_together_are_named(change, words):
    with pytest.raises(InputError, match=words):
        SynthesisSettings(**change)


def test_a_mean_square_above_every_extreme_is_no_less_than_their_mean():
    plane, nominal = aircraft(), table2(2)
    each, mean = (design(plane, nominal, BOX, SynthesisSettings(extremes=name)) for name in ("each", "mean"))
    assert each.feasible.all()
    assert np.all(each.bound >= mean.bound * (1.0 - 1e-6))
    assert np.any(each.bound > mean.bound * (1.0 + 1e-4))


def test_a_law_names_beats_and_errors_that_there_are_not():
    linear = LinearLaw(np.zeros((3, 4, 8)), ErrorCoordinates("relative"))
    cubic = PolynomialLaw(linear.gains, linear.exponents, linear.coordinates)
    for law in (linear, cubic):
        for beat, error, words in (
            (3, np.zeros(8), "beats 0 to 2"),
            (-1, np.zeros(8), "-1 is none"),
            (0, [1.0], "eight"),
        ):
            with pytest.raises(InputError, match=words):
                law.increment(beat, np.asarray(error))


@pytest.mark.slow
def test_a_cubic_law_of_all_eight_errors_keeps_to_its_limits():
    plane, nominal = aircraft(), table2(2)
    made = design(plane, nominal, BOX, SynthesisSettings(algorithm="coupled", law_degree=3), beats=range(1))
    assert made.feasible[:1].all()
    assert np.abs(made.law.coefficients[0, :, 8:]).max() > 0
    coordinates = made.law.coordinates
    share = np.random.default_rng(6).uniform(-1, 1, (2000, 8))
    share[:256] = np.array(np.meshgrid(*[[-1, 1]] * 8)).reshape(8, -1).T
    # corners of the set in the law's coordinates, and points inside
    found = made.law.increment(0, share * coordinates.box(nominal.states[:1], HALF_WIDTHS))
    lower, upper = plane.virtual_limits(nominal.states[:1], nominal.controls[:1])
    room = upper - lower
    assert np.all(found >= lower - 1e-6 * room)
    assert np.all(found <= upper + 1e-6 * room)
