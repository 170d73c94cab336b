"""Taylor models hold the functions they stand for, and are those of the Taylor arithmetic."""

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aerotube.numerics import (
    ModelSpace,
    TaylorModel,
    lookup1,
    lookup2,
    select,
    series_kernels,
    table1,
    table2,
    taylor_functions,
)
from aerotube.numerics.interval import Interval

DOMAINS = [(3, 1), (1, 1, 1, 1), (4,), (2, 2)]


def points_in(balls, count, random):
    """Points of the domain, most of them on the boundary of its balls."""
    parts = []
    for size in balls:
        x = random.standard_normal((count, size))
        x /= np.linalg.norm(x, axis=-1, keepdims=True)
        parts.append(x * np.where(random.random((count, 1)) < 0.7, 1.0, random.random((count, 1)) ** (1 / size)))
    return np.concatenate(parts, axis=-1)


FUNCTIONS = {
    "product": lambda x, y: x * y * x * y - 2.0 * x + y,
    "quotient": lambda x, y: x / (y - 2.5) + 3.0 / x,
    "sqrt": lambda x, y: np.sqrt(x) * np.sqrt(x + y),
    "angle": lambda x, y: np.arctan2(y, x) + np.arctan2(-x, y),
    "sine and cosine": lambda x, y: np.sin(3.0 * x) + np.cos(x * y),
    "tangent": lambda x, y: np.tan(0.5 * x) + np.tanh(y),
    "exp and log": lambda x, y: np.exp(y) * np.log(x),
    "arcs": lambda x, y: np.arcsin(0.5 * y) + np.arccos(0.3 * x) + np.arctan(x),
    "powers": lambda x, y: x**4.14 + x**-2 + y**5 + 2.0**y + x**y,
    "hypot": lambda x, y: np.hypot(x, y) + np.square(x),
    "hyperbolic": lambda x, y: np.sinh(x) * np.cosh(y),
    "maximum": lambda x, y: np.maximum(x, 1.3 + 0.5 * y) + np.minimum(1.2, x) + abs(x - 1.25),
    "select": lambda x, y: select(x - y > 2.0, x * y, x + 1.0),
    "degrees": lambda x, y: np.rad2deg(x) * np.deg2rad(y) + np.reciprocal(x),
}


def arguments(balls, seed, reach=0.1):
    random = np.random.default_rng(seed)
    space = ModelSpace(balls, 3)
    slope = random.uniform(-1.0, 1.0, (2, 5, 4))
    slope *= reach / np.abs(slope).sum(-1, keepdims=True)
    degrees = space.taylor.exponents.sum(1)
    bent = 0.3 * reach**degrees * random.uniform(-1.0, 1.0, (2, 5, space.size)) / space.size
    bent[..., :5] = 0.0
    x, y = space.affine(np.full(5, 1.3), slope[0]), space.affine(np.full(5, -0.7), slope[1])
    return x + space.model(bent[0]), y + space.model(bent[1]), random


@pytest.mark.parametrize("balls", DOMAINS)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_function_stays_within_the_remainder(name, balls):
    x, y, random = arguments(balls, 11)
    found = FUNCTIONS[name](x, y)
    points = points_in(balls, 4000, random)
    true = FUNCTIONS[name](x.polynomial(points), y.polynomial(points))
    apart = np.abs(true - found.polynomial(points))
    assert np.all(apart <= found.remainder[:, None] + 1e-13)
    assert found.bounds.holds(true.T).all()
    # a bound that is never nearly met would be no use: within a factor of 200 of the worst of the points
    assert np.all(apart.max(-1) >= found.remainder / 200.0 - 1e-13)


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if name not in ("maximum", "select")])
def test_the_polynomial_is_that_of_the_taylor_arithmetic(name):
    x, y, _ = arguments((3, 1), 12)
    found = FUNCTIONS[name](x, y).polynomial
    expected = FUNCTIONS[name](x.polynomial, y.polynomial)
    assert found.coefficients == pytest.approx(expected.coefficients, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if name not in ("maximum", "select")])
def test_the_remainder_falls_with_the_fourth_power_of_the_domain(name):
    remainders = [FUNCTIONS[name](*arguments((3, 1), 13, reach)[:2]).remainder for reach in (0.04, 0.02, 0.01)]
    for wide, narrow in pairwise(remainders):
        assert np.all(wide / narrow > 14.0)
        assert np.all(wide / narrow < 30.0)


@pytest.mark.parametrize("name", ["reciprocal", "sqrt", "exp", "log", "sin", "cos", "arctan", "arcsin", "power"])
def test_compiled_series_against_interval_arithmetic(name):
    """Two routes to the same enclosures, over points and over ranges; both hold the floating-point series."""
    kinds = {"sqrt": "SQRT", "arcsin": "ARCSIN"}
    kind = getattr(series_kernels, kinds.get(name, name.upper()))
    series = taylor_functions.power(np.array(4.14)) if name == "power" else getattr(taylor_functions, name)
    random = np.random.default_rng(9)
    for low in random.uniform(0.1, 0.7, 40):
        for high in (low, low + random.uniform(0.0, 0.25)):
            found = np.empty((6, 2))
            assert series_kernels.enclose(kind, 4.14, low, high, found)
            for at in np.linspace(low, high, 4):
                numbers = np.array(series(np.array(at), 5))
                slack = 1e-13 * (1.0 + np.abs(numbers))
                assert np.all((found[:, 0] <= numbers + slack) & (found[:, 1] >= numbers - slack))
            if name != "power":
                other = series(Interval(low, high), 5)
                for row, term in zip(found, other, strict=True):
                    assert row == pytest.approx([float(term.lower), float(term.upper)], rel=1e-12, abs=1e-12)
    bad = {"reciprocal": -0.1, "sqrt": -0.1, "log": 0.0, "power": 0.0, "arcsin": -1.0}
    if name in bad:
        assert not series_kernels.enclose(kind, 4.14, bad[name], 0.5, np.empty((6, 2)))
    assert not series_kernels.enclose(kind, 4.14, np.nan, np.nan, np.empty((6, 2)))


@pytest.mark.parametrize("name", ["sin", "cos", "exp", "log", "sqrt", "arctan", "arcsin"])
def test_compiled_values_against_arbitrary_precision(name):
    flint = pytest.importorskip("flint")
    other = {"arcsin": "asin", "arctan": "atan"}.get(name, name)
    kind, found = getattr(series_kernels, name.upper()), np.empty((2, 2))
    with flint.ctx.workprec(200):
        for x in np.random.default_rng(10).uniform(0.01, 0.99, 500).tolist():
            assert series_kernels.enclose(kind, 0.0, x, x, found)
            exact = getattr(flint.arb(x), other)()
            assert flint.arb(float(found[0, 0])) <= exact <= flint.arb(float(found[0, 1]))


def test_a_product_left_out_of_the_polynomial_is_exact_to_a_rounding():
    """Powers of one variable: what is cut off is known exactly."""
    space = ModelSpace((1,), 3)
    x = space.variable(0)
    cube = x * x * x
    assert cube.remainder <= 1e-14
    assert (cube * x).remainder == pytest.approx(1.0, rel=1e-9)
    assert (cube * x).remainder >= 1.0
    assert np.array_equal((cube * x).coefficients, np.zeros(4))


def test_linear_forms_are_bounded_exactly_on_balls_and_boxes():
    slope = np.array([3.0, 4.0, 12.0])
    for balls, reach in [((3,), 13.0), ((1, 1, 1), 19.0), ((2, 1), 17.0)]:
        x = ModelSpace(balls, 3).affine(1.0, slope)
        assert x.reach == pytest.approx(reach, rel=1e-9)
        assert x.bounds.upper >= 1.0 + reach


@given(seed=st.integers(0, 10**6))
@settings(max_examples=30, deadline=None)
def test_norms_bound_the_parts_of_each_degree(seed):
    random = np.random.default_rng(seed)
    for balls in DOMAINS:
        space = ModelSpace(balls, 3)
        degrees = space.taylor.exponents.sum(1)
        coefficients = random.standard_normal(space.size)
        model = space.model(coefficients)
        points = points_in(balls, 500, random)
        for degree in range(4):
            part = space.taylor.monomials(points) @ (coefficients * (degrees == degree))
            assert np.abs(part).max() <= model.norms[degree]


@given(seed=st.integers(0, 10**6))
@settings(max_examples=30, deadline=None)
def test_rounding_is_in_the_remainder(seed):
    """Against exact rational arithmetic: three factors of first degree, whose product nothing is cut off."""
    random = np.random.default_rng(seed)
    space = ModelSpace((1, 1), 3)
    rows = random.uniform(-1.0, 1.0, (3, 3)) * 10.0 ** random.integers(-8, 8, (3, 3))
    shift, factor, divisor = random.uniform(-1.0, 1.0, 3)
    models = [space.affine(row[0], row[1:]) for row in rows]
    found = ((models[0] * models[1] - models[2]) * models[2] + shift) * factor / divisor
    for point in [(1.0, -1.0), (0.37, 0.91), *random.uniform(-1.0, 1.0, (5, 2)).tolist()]:
        z = [Fraction(1), *(Fraction(float(c)) for c in point)]
        a, b, c = (sum(Fraction(float(v)) * w for v, w in zip(row, z, strict=True)) for row in rows)
        exact = ((a * b - c) * c + Fraction(float(shift))) * Fraction(float(factor)) / Fraction(float(divisor))
        polynomial = sum(
            (
                Fraction(float(value)) * z[1] ** int(i) * z[2] ** int(j)
                for value, (i, j) in zip(found.coefficients, space.taylor.exponents, strict=True)
            ),
            Fraction(0),
        )
        assert abs(exact - polynomial) <= Fraction(float(found.remainder))
    assert found.remainder <= 1e-12 * (np.abs(found.coefficients).sum() + (np.abs(rows).sum() + 1.0) ** 3)


def test_a_function_of_a_constant_against_arbitrary_precision():
    flint = pytest.importorskip("flint")
    with flint.ctx.workprec(200):
        _constants_against(flint)


def _constants_against(flint):
    space = ModelSpace((2,), 3)
    for value in np.random.default_rng(5).uniform(0.2, 0.9, 200):
        x, at = space.constant(value), flint.arb(float(value))
        found = np.exp(np.sin(x)) * np.sqrt(x) + np.arctan2(x, 0.3) / np.log(x) + np.arcsin(x) ** 3.3
        exact = at.sin().exp() * at.sqrt() + flint.arb.atan2(at, flint.arb(0.3)) / at.log()
        exact += at.asin() ** flint.arb(3.3)
        assert abs(exact - flint.arb(float(found.value))) <= flint.arb(float(found.remainder))
        assert found.remainder < 1e-13


@pytest.mark.parametrize("interpolation", ["linear", "smooth"])
@pytest.mark.parametrize("reach", [0.02, 0.3, 1.1])
def test_tables_stay_within_the_remainder_across_cells(interpolation, reach):
    random = np.random.default_rng(6)
    x_nodes, y_nodes = np.linspace(-2.0, 3.0, 6), np.array([0.0, 0.7, 1.1, 2.0, 2.4])
    values = random.normal(size=(3, 6, 5))
    plane, row = table2(x_nodes, y_nodes, values, interpolation), table1(x_nodes, values[:, :, 0], interpolation)
    space = ModelSpace((2,), 3)
    at = np.array([[0.3, 0.9], [-1.9, 1.9], [2.9, -0.5], [3.5, 2.9], [0.0, 1.1]])
    slope = reach * np.array([[0.9, 0.3], [-0.4, 0.8]])
    x, y = space.affine(at[:, 0], slope[0]), space.affine(at[:, 1], slope[1])
    x = x + 0.1 * x * x
    points = points_in((2,), 3000, random)
    true_x, true_y = at[:, :1] + points @ slope[0], at[:, 1:] + points @ slope[1]
    true_x = true_x + 0.1 * true_x**2
    for found, true in (
        (lookup1(row, x), lookup1(row, true_x)),
        (lookup2(plane, x, y), lookup2(plane, true_x, true_y)),
    ):
        for output in range(3):
            apart = np.abs(true[output] - found[output].polynomial(points))
            assert np.all(apart <= found[output].remainder[:, None] + 1e-13)
            if interpolation == "smooth":
                assert np.all(apart.max(-1) >= found[output].remainder / 200.0 - 1e-13)
    mixed = lookup2(plane, at[:, 0], y)
    for output, expected in enumerate(lookup2(plane, at[:, :1], true_y)):
        assert np.all(np.abs(expected - mixed[output].polynomial(points)) <= mixed[output].remainder[:, None] + 1e-13)


def test_a_kink_of_a_linear_table_is_in_the_remainder():
    """Slopes 1 and 3 meeting at 0.3, seen from 0 over [-1, 1]: the expansion misses 2 * 0.7 at most."""
    table = table1([-2.0, 0.3, 2.0], [[-2.3, 0.0, 5.1]])
    (found,) = lookup1(table, ModelSpace((1,), 3).variable(0))
    assert found.coefficients == pytest.approx([-0.3, 1.0, 0.0, 0.0], abs=1e-14)
    assert found.remainder == pytest.approx(1.4, rel=1e-9)


def test_smooth_tables_converge_across_a_join():
    """Four continuous derivatives: the remainder at a node falls with the fourth power of the range."""
    table = table1(np.linspace(-2.0, 3.0, 6), np.random.default_rng(7).normal(size=(1, 6)), "smooth")
    space = ModelSpace((1,), 3)
    widths = [lookup1(table, space.variable(0, 1.0, reach))[0].remainder for reach in (0.1, 0.05, 0.025)]
    assert widths[0] / widths[1] > 14.0
    assert widths[1] / widths[2] > 14.0


def test_branches():
    space = ModelSpace((1,), 2)
    x = space.variable(0, np.array([-2.0, 0.5, 2.0]))
    positive = x > 0.0
    assert positive.certain.tolist() == [False, False, True]
    assert positive.possible.tolist() == [False, True, True]
    assert (x <= 0.0).possible.tolist() == [True, True, False]
    assert (positive & (x < 2.5)).certain.tolist() == [False, False, False]
    assert (positive | (x < -0.5)).certain.tolist() == [True, False, True]
    assert abs(x).remainder == pytest.approx([0.0, 1.0, 0.0], abs=1e-10)
    assert abs(x).coefficients[:, 1].tolist() == [-1.0, 1.0, 1.0]
    assert np.where(x > 1.0, 3.0, x).remainder == pytest.approx([0.0, 3.5, 2.0], abs=1e-9)
    assert bool(x > -4.0)
    assert not bool(x > 4.0)
    with pytest.raises(ValueError, match="not decided"):
        bool(positive)


@pytest.mark.parametrize(
    ("operation", "message"),
    [
        (lambda x: 1.0 / x, "reciprocal|zero"),
        (lambda x: np.sqrt(x), "square root"),
        (lambda x: np.log(x), "logarithm"),
        (lambda x: np.log(x * np.ones(3)), r"logarithm .* \(batch index 0\)"),
        (lambda x: np.arcsin(2.0 * x), "arc sine"),
        (lambda x: np.arctan2(x, 0.1), "half plane|arc"),
        (lambda x: np.arctan2(0.1 * x, -1.0), "half a turn"),
        (lambda x: np.rint(x), "one number"),
        (lambda x: x / 0.0, "divisor"),
        (lambda x: x + ModelSpace((1,), 2).variable(0), "different spaces"),
        (lambda x: x.space.variable(1), "no variable 1"),
        (lambda x: x.space.model(np.zeros(3)), "coefficients have shape"),
        (lambda x: x.space.model(np.zeros(4), -1.0), "remainder"),
        (lambda x: ModelSpace((0,), 2), "positive dimension"),
        (lambda x: ModelSpace((1,), 0), "order"),
    ],
)
def test_what_is_not_defined_over_the_domain_is_refused(operation, message):
    with pytest.raises(ValueError, match=message):
        operation(ModelSpace((1,), 3).variable(0, 0.2))


def test_batches_broadcast_like_arrays():
    space = ModelSpace((2, 1), 3)
    random = np.random.default_rng(8)
    a = space.affine(np.full((4, 1), 2.0), 0.1 * random.standard_normal((4, 1, 3)))
    b = space.affine(np.full(5, 1.5), 0.1 * random.standard_normal((5, 3)))
    array = random.uniform(1.0, 2.0, (2, 1, 1))
    for operation in (np.add, np.subtract, np.multiply, np.divide, np.arctan2, np.hypot, np.maximum):
        whole = operation(a, b)
        assert whole.shape == (4, 5)
        member = operation(TaylorModel(space, a.data[2, 0]), TaylorModel(space, b.data[3]))
        assert whole.data[2, 3] == pytest.approx(member.data, rel=1e-12, abs=1e-13)
        assert operation(array, a).shape == operation(a, array).shape == (2, 4, 1)
    assert (np.float64(2.0) * a).shape == (4, 1)
    assert isinstance(a.bounds, Interval)
