from math import comb, factorial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aerotube.numerics import Taylor, TaylorSpace, select

ORDER = 6


def random_taylor(space, seed, value=None, batch=()):
    random = np.random.default_rng(seed)
    coefficients = random.uniform(-1.0, 1.0, (*batch, space.size))
    if value is not None:
        coefficients[..., 0] = value
    return Taylor(space, coefficients)


def same(left, right, tolerance=1e-10):
    assert left.space == right.space
    assert left.coefficients == pytest.approx(right.coefficients, rel=tolerance, abs=tolerance)


@pytest.mark.parametrize(("variables", "order"), [(1, 0), (1, 7), (3, 0), (2, 5), (5, 3), (13, 3)])
def test_space_lists_every_monomial_once_by_degree(variables, order):
    space = TaylorSpace(variables, order)
    assert space.size == comb(variables + order, order)
    degrees = space.exponents.sum(axis=1)
    assert np.all(np.diff(degrees) >= 0)
    assert degrees.max() == order
    assert len({tuple(row) for row in space.exponents}) == space.size
    if order:
        assert np.array_equal(space.exponents[1 : 1 + variables], np.eye(variables))
    assert TaylorSpace(variables, order) == space
    assert TaylorSpace(variables, order).layout is space.layout


@given(seed=st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_arithmetic_is_that_of_the_polynomials(seed):
    """Products of low degree lose nothing to truncation: values at any point must agree."""
    space = TaylorSpace(3, 6)
    low = space.exponents.sum(axis=1) <= 2
    a, b, c = (Taylor(space, random_taylor(space, seed + k).coefficients * low) for k in range(3))
    points = np.random.default_rng(seed).uniform(-2.0, 2.0, (5, 3))
    at_a, at_b, at_c = a(points), b(points), c(points)
    combined = a * b * c - 2.0 * (a - b) ** 3 + b / 4.0 - (1.5 - c) * a + (-b) * (+c)
    expected = at_a * at_b * at_c - 2.0 * (at_a - at_b) ** 3 + at_b / 4.0 - (1.5 - at_c) * at_a - at_b * at_c
    assert combined(points) == pytest.approx(expected, rel=1e-11, abs=1e-11)


def test_one_variable_is_the_truncated_product_of_polynomials():
    space = TaylorSpace(1, 7)
    a, b = random_taylor(space, 1), random_taylor(space, 2)
    expected = np.polynomial.polynomial.polymul(a.coefficients, b.coefficients)[:8]
    assert (a * b).coefficients == pytest.approx(expected, abs=1e-14)


@given(seed=st.integers(0, 10**6), value=st.floats(0.2, 3.0))
@settings(max_examples=25, deadline=None)
def test_functions_undo_each_other(seed, value):
    """Identities between expansions of independent recurrences, in two variables to sixth order."""
    space = TaylorSpace(2, ORDER)
    x, y = random_taylor(space, seed, value), random_taylor(space, seed + 1, -0.7)
    one = space.constant(1.0)
    same(np.log(np.exp(x)), x)
    same(np.sqrt(x) * np.sqrt(x), x)
    same((x * y) / x, y, 1e-8)
    same((1.0 / x) * x, one, 1e-8)
    same(np.reciprocal(x), 1.0 / x)
    same(np.sin(x) ** 2 + np.cos(x) ** 2, one)
    same(np.tan(0.4 * x) * np.cos(0.4 * x), np.sin(0.4 * x))
    same(np.cosh(x) ** 2 - np.sinh(x) ** 2, one, 1e-8)
    same(np.tanh(x) * np.cosh(x), np.sinh(x), 1e-8)
    same(np.cosh(x) + np.sinh(x), np.exp(x), 1e-9)
    same(np.arctan(np.tan(0.4 * x)), 0.4 * x)
    same(np.arcsin(np.sin(0.4 * x)), 0.4 * x, 1e-8)
    same(np.arccos(np.cos(0.4 * x)), 0.4 * x, 1e-8)
    same(x**2.5, np.exp(2.5 * np.log(x)), 1e-7)
    same(x**-1.5, 1.0 / (x * np.sqrt(x)), 1e-7)
    same(x**3, x * x * x)
    same(x**-2, 1.0 / (x * x), 1e-7)
    same(x**y, np.exp(y * np.log(x)), 1e-7)
    same(2.0**y, np.exp(np.log(2.0) * y))
    same(abs(y), -y)
    same(np.hypot(x, y) ** 2, x * x + y * y, 1e-9)


@given(seed=st.integers(0, 10**6), angle=st.floats(-np.pi, np.pi), radius=st.floats(0.3, 3.0))
@settings(max_examples=25, deadline=None)
def test_angle_of_a_point_in_every_direction(seed, angle, radius):
    space = TaylorSpace(2, ORDER)
    theta, r = random_taylor(space, seed, angle), random_taylor(space, seed + 1, radius)
    found = np.arctan2(r * np.sin(theta), r * np.cos(theta))
    turns = np.rint((found.value - angle) / (2.0 * np.pi))
    same(found - 2.0 * np.pi * turns, theta, 1e-7)


FUNCTIONS = {
    **{
        name: getattr(np, name)
        for name in ["exp", "log", "sqrt", "sin", "cos", "tan", "arcsin", "arccos", "arctan", "sinh", "cosh", "tanh"]
    },
    **{name: getattr(np, name) for name in ["reciprocal", "square", "absolute", "fabs", "negative", "positive"]},
    **{name: getattr(np, name) for name in ["deg2rad", "rad2deg", "radians", "degrees"]},
    "x**1.7": lambda x: x**1.7,
    "float_power": lambda x: np.float_power(x, 2.2),
    "1.3**x": lambda x: 1.3**x,
    "arctan2 of x": lambda x: np.arctan2(x, 0.4),
    "arctan2 in -x": lambda x: np.arctan2(0.4, -x),
    "hypot": lambda x: np.hypot(x, 0.3),
    "2/x": lambda x: 2.0 / x,
    "maximum": lambda x: np.maximum(x, 0.1),
    "minimum": lambda x: np.minimum(0.9, x),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_derivatives_against_an_interpolating_polynomial(name):
    """A Chebyshev interpolant near the point, made from values alone, has the same derivatives."""
    about, radius, order = 0.6, 0.06, 5
    found = FUNCTIONS[name](TaylorSpace(1, order).variable(0, about)).coefficients
    nodes = np.cos(np.pi * (np.arange(14) + 0.5) / 14)
    series = np.polynomial.chebyshev.chebfit(nodes, FUNCTIONS[name](about + radius * nodes), 13)
    expected = np.polynomial.chebyshev.cheb2poly(series)[: order + 1]
    scaled = found * radius ** np.arange(order + 1)
    assert scaled == pytest.approx(expected, rel=1e-9, abs=1e-12 * np.abs(expected).max())


def test_remainder_falls_with_the_order():
    """Halving the increment divides the remainder of third order by sixteen, in several variables."""

    def function(x, y, z):
        return np.arctan2(np.sqrt(x * x + z), y) * np.exp(-x / y) + np.log(z) / (1.0 + np.tan(x) ** 2)

    space, about = TaylorSpace(3, 3), (0.4, 1.3, 0.8)
    polynomial = function(*[space.variable(i, value) for i, value in enumerate(about)])
    directions = np.random.default_rng(3).uniform(-1.0, 1.0, (6, 3))
    errors = []
    for scale in (0.02, 0.01):
        points = scale * directions
        errors.append(np.abs(polynomial(points) - function(*(np.array(about) + points).T)))
    assert np.all(errors[0] < 1e-5)
    assert errors[0] / errors[1] == pytest.approx(np.full(6, 16.0), rel=0.15)


def test_mixed_second_derivatives_are_the_coefficients():
    space = TaylorSpace(2, 2)
    x, y = space.variable(0, 0.7), space.variable(1, -0.3)
    found = np.sin(x) * np.exp(y)
    s, c, e = np.sin(0.7), np.cos(0.7), np.exp(-0.3)
    by_exponent = {tuple(k): v for k, v in zip(space.exponents.tolist(), found.coefficients, strict=True)}
    expected = {(0, 0): s * e, (1, 0): c * e, (0, 1): s * e, (2, 0): -s * e / 2, (1, 1): c * e, (0, 2): s * e / 2}
    assert by_exponent == pytest.approx(expected, abs=1e-15)
    assert found.value == pytest.approx(s * e, abs=1e-15)
    assert found.gradient == pytest.approx([c * e, s * e], abs=1e-15)


def test_compose_with_given_derivatives():
    space = TaylorSpace(2, 4)
    x = random_taylor(space, 5, batch=(3,))
    series = np.stack([np.exp(x.value) / factorial(k) for k in range(5)], axis=-1)
    same(x.compose(series), np.exp(x))
    # one expansion of several functions adds an axis
    several = x.compose(np.stack([series, 2.0 * series]))
    assert several.shape == (2, 3)
    same(Taylor(space, several.coefficients[1]), 2.0 * np.exp(x))


def test_batches_broadcast_like_arrays():
    space = TaylorSpace(3, 3)
    a, b = random_taylor(space, 6, 2.0, batch=(4, 1)), random_taylor(space, 7, 1.5, batch=(5,))
    array = np.random.default_rng(8).uniform(1.0, 2.0, (2, 1, 1))
    for operation in (np.add, np.subtract, np.multiply, np.divide, np.arctan2, np.hypot, np.maximum):
        whole = operation(a, b)
        assert whole.shape == (4, 5)
        member = operation(Taylor(space, a.coefficients[2, 0]), Taylor(space, b.coefficients[3]))
        same(Taylor(space, whole.coefficients[2, 3]), member, 1e-13)
        for mixed, expected in (
            (operation(a, array), operation(a, space.constant(array))),
            (operation(array, a), operation(space.constant(array), a)),
        ):
            assert mixed.shape == (2, 4, 1)
            same(mixed, expected, 1e-12)
    assert (array * a).shape == (2, 4, 1)
    assert (array + a).shape == (2, 4, 1)
    assert (array - a).shape == (2, 4, 1)
    assert (array / a).shape == (2, 4, 1)
    assert (np.float64(2.0) * a).shape == (4, 1)
    assert a(np.zeros((7, 3))).shape == (4, 1, 7)
    assert a(np.zeros((4, 1, 7, 3))).shape == (4, 1, 7)


def test_in_place_on_an_array_is_refused():
    array = np.ones(3)
    with pytest.raises(TypeError):
        array += TaylorSpace(1, 1).variable(0, np.ones(3))


def test_comparisons_and_branches_go_by_the_value():
    space = TaylorSpace(1, 2)
    x = space.variable(0, np.array([-1.0, 0.5, 2.0]))
    assert (x < 0.5).tolist() == [True, False, False]
    assert (x <= 0.5).tolist() == [True, True, False]
    assert np.less(x, 0.5).tolist() == [True, False, False]
    assert np.greater_equal(x, 0.5).tolist() == [False, True, True]
    assert (x >= x).all()
    assert (x == 0.5).tolist() == [False, True, False]
    assert (x != 0.5).tolist() == [True, False, True]
    assert (np.array([0.0, 1.0, 1.0]) < x).tolist() == [False, False, True]
    assert np.sign(x).tolist() == [-1.0, 1.0, 1.0]
    assert np.rint(x).tolist() == [-1.0, 0.0, 2.0]
    assert np.isfinite(x).all()
    same(abs(x), select(x < 0.0, -x, x))
    same(np.maximum(x, 1.0), select(x >= 1.0, x, 1.0))
    same(np.minimum(x, -x), -abs(x))
    picked = select(x < 0.5, 3.0, x * x)
    assert picked.coefficients.tolist() == [[3.0, 0.0, 0.0], [0.25, 1.0, 1.0], [4.0, 4.0, 1.0]]


def test_select_on_floats_and_arrays():
    assert select(True, 1.0, 2.0) == 1.0
    assert select(np.float64(3.0) < 2.0, 1.0, 2.0) == 2.0
    assert select(np.array([True, False]), 1.0, np.array([3.0, 4.0])).tolist() == [1.0, 4.0]


def test_truncate_and_stack():
    space = TaylorSpace(2, 4)
    x, y = random_taylor(space, 9, 1.0), random_taylor(space, 10, 2.0, batch=(3,))
    same((x * y).truncate(2), x.truncate(2) * y.truncate(2))
    with pytest.raises(ValueError, match="cannot be truncated"):
        x.truncate(5)
    stacked = space.stack([x, y, 2.0, np.arange(3.0)])
    assert stacked.shape == (3, 4, space.size)
    assert stacked[:, 1] == pytest.approx(y.coefficients, abs=0)
    assert stacked[:, 3, 0].tolist() == [0.0, 1.0, 2.0]
    assert not stacked[:, 2:, 1:].any()


@pytest.mark.parametrize(
    ("operation", "message"),
    [
        (lambda x: 1.0 / (x - 2.0), r"division by a Taylor polynomial needs .* \(batch index 1\)"),
        (lambda x: x / (x - 2.0), r"division by a Taylor polynomial needs .* \(batch index 1\)"),
        (lambda x: x / 0.0, "divisor"),
        (lambda x: np.sqrt(2.0 - x), r"square root .* positive value \(batch index 1\)"),
        (lambda x: np.log(1.0 - x), "logarithm"),
        (lambda x: (2.0 - x) ** 0.5, "power"),
        (lambda x: np.arcsin(x), "between -1 and 1"),
        (lambda x: np.arccos(x), "between -1 and 1"),
        (lambda x: abs(x - 1.0), r"absolute value .* \(batch index 0\)"),
        (lambda x: np.arctan2(x - 1.0, 1.0 - x), "off the origin"),
        (lambda x: (-2.0) ** x, "positive base"),
        (lambda x: x + TaylorSpace(2, 3).variable(0), "different spaces"),
        (lambda x: np.log(x * np.nan), "logarithm"),
        (lambda x: x.space.variable(1), "no variable 1"),
        (lambda x: x(np.zeros((4, 2))), "1 components"),
        (lambda x: Taylor(x.space, np.zeros(3)), "coefficients have shape"),
        (lambda x: TaylorSpace(0, 1), "needs a variable"),
        (lambda x: TaylorSpace(1, -1), "needs a variable"),
    ],
)
def test_expansions_that_do_not_exist_are_refused(operation, message):
    x = TaylorSpace(1, 3).variable(0, np.array([1.0, 2.0, 3.0]))
    with pytest.raises(ValueError, match=message):
        operation(x)
