"""Intervals hold what exact or arbitrary-precision arithmetic gives."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aerotube.numerics import taylor_functions
from aerotube.numerics.interval import Interval, hull

numbers = st.floats(-1e6, 1e6)


@pytest.fixture
def flint():
    """Ball arithmetic of 200 bits."""
    module = pytest.importorskip("flint")
    before, module.ctx.prec = module.ctx.prec, 200
    yield module
    module.ctx.prec = before


@given(a=numbers, b=numbers)
@settings(max_examples=200, deadline=None)
def test_arithmetic_holds_the_exact_result(a, b):
    x, y = Fraction(a), Fraction(b)
    checks = [(Interval(a) + b, x + y), (Interval(a) - b, x - y), (b - Interval(a), y - x), (Interval(a) * b, x * y)]
    checks.append((np.square(Interval(a)), x * x))
    if abs(b) > 1e-3:
        checks += [(Interval(a) / b, x / y), (a / Interval(b), x / y), (Interval(b) ** 5, y**5)]
    for found, exact in checks:
        assert Fraction(float(found.lower)) <= exact <= Fraction(float(found.upper))
        assert found.upper - found.lower <= 1e-14 * float(abs(exact)) + 1e-300
    if a >= 0.0:
        root = np.sqrt(Interval(a))
        assert Fraction(float(root.lower)) ** 2 <= x <= Fraction(float(root.upper)) ** 2


FUNCTIONS = {
    "exp": (-5.0, 5.0),
    "log": (0.01, 20.0),
    "sin": (-20.0, 20.0),
    "cos": (-20.0, 20.0),
    "tan": (-1.5, 1.5),
    "arcsin": (-0.999, 0.999),
    "arccos": (-0.999, 0.999),
    "arctan": (-20.0, 20.0),
    "sinh": (-5.0, 5.0),
    "cosh": (-5.0, 5.0),
    "tanh": (-5.0, 5.0),
    "sqrt": (0.01, 20.0),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_elementary_functions_against_arbitrary_precision(flint, name):
    """The assumed accuracy of the library holds, with a factor of two to spare, against ball arithmetic."""
    points = np.random.default_rng(1).uniform(*FUNCTIONS[name], 3000)
    found = getattr(np, name)(Interval(points))
    other = {"arcsin": "asin", "arccos": "acos", "arctan": "atan"}.get(name, name)
    for x, low, high in zip(points.tolist(), found.lower.tolist(), found.upper.tolist(), strict=True):
        exact = getattr(flint.arb(x), other)()
        middle, quarter = 0.5 * low + 0.5 * high, 0.25 * (high - low)
        assert flint.arb(low) <= exact <= flint.arb(high)
        if name != "sqrt":
            assert abs(exact - flint.arb(middle)) <= flint.arb(quarter)


@pytest.mark.parametrize("exponent", [4.14, -1.5, 3.0, -2.0, 0.5])
def test_powers_against_arbitrary_precision(flint, exponent):
    points = np.random.default_rng(2).uniform(0.01, 30.0, 2000)
    found = Interval(points) ** exponent
    for x, low, high in zip(points.tolist(), found.lower.tolist(), found.upper.tolist(), strict=True):
        assert flint.arb(low) <= flint.arb(x) ** flint.arb(exponent) <= flint.arb(high)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=60, deadline=None)
def test_wide_intervals_hold_all_values_and_little_more(seed):
    random = np.random.default_rng(seed)
    share = np.append(np.linspace(0.0, 1.0, 400), random.uniform(0.0, 1.0, 100))
    for name, (low, high) in FUNCTIONS.items():
        ends = np.sort(random.uniform(low, high, 2))
        points = np.clip(ends[0] + share * (ends[1] - ends[0]), *ends)
        values = getattr(np, name)(points)
        found = getattr(np, name)(Interval(*ends))
        assert found.holds(values).all()
        # a slope times the spacing of the points
        slack = 1e-9 + np.abs(np.diff(np.sort(values))).max()
        assert found.lower >= values.min() - slack
        assert found.upper <= values.max() + slack
    for exponent in (2, 3, 4, 0, 1):
        ends = np.sort(random.uniform(-2.0, 2.0, 2))
        points = np.clip(ends[0] + share * (ends[1] - ends[0]), *ends)
        assert (Interval(*ends) ** exponent).holds(points**exponent).all()


@given(seed=st.integers(0, 10**6))
@settings(max_examples=60, deadline=None)
def test_operations_on_intervals_hold_those_on_their_numbers(seed):
    random = np.random.default_rng(seed)
    (a, b), (c, d) = np.sort(random.uniform(-3.0, 3.0, (2, 2)))
    x, y = random.uniform(a, b, 300), random.uniform(c, d, 300)
    left, right = Interval(a, b), Interval(c, d)
    assert (left * right).holds(x * y).all()
    assert (left - right).holds(x - y).all()
    assert abs(left).holds(np.abs(x)).all()
    assert hull(left, right).holds(np.append(x, y)).all()
    assert (left * left).holds(x * x).all()
    assert np.arctan2(right, left).holds(np.arctan2(y, x)).all()
    assert np.hypot(right, left).holds(np.hypot(y, x)).all()
    if c > 0.1 or d < -0.1:
        assert (left / right).holds(x / y).all()


def test_series_enclose_the_derivatives_over_the_interval():
    """The recurrences of the Taylor arithmetic, run on intervals."""
    random = np.random.default_rng(4)
    low = random.uniform(0.2, 0.5, 50)
    wide = Interval(low, low + random.uniform(0.0, 0.3, 50))
    for name in ("exp", "log", "sqrt", "sin", "cos", "tan", "arctan", "arcsin", "arccos", "reciprocal", "tanh"):
        series = getattr(taylor_functions, name)
        enclosed = series(wide, 4)
        for share in (0.0, 0.3, 1.0):
            for term, expected in zip(enclosed, series(wide.lower + share * (wide.upper - wide.lower), 4), strict=True):
                assert np.all(term.lower <= expected + 1e-12 * np.abs(expected))
                assert np.all(term.upper >= expected - 1e-12 * np.abs(expected))


@pytest.mark.parametrize(
    ("operation", "message"),
    [
        (lambda x: 1.0 / x, "reciprocal"),
        (lambda x: np.sqrt(x), "square root"),
        (lambda x: np.log(x), "logarithm"),
        (lambda x: np.arcsin(3.0 * x), "arc sine"),
        (lambda x: np.arccos(3.0 * x), "arc cosine"),
        (lambda x: x**0.5, "power"),
        (lambda x: x**-2, "power"),
        (lambda x: np.tan(x + 1.2), "tangent"),
        (lambda x: Interval(1.0, 0.0), "in|above"),
        (lambda x: Interval(np.nan), "numbers"),
    ],
)
def test_what_is_not_defined_throughout_is_refused(operation, message):
    with pytest.raises(ValueError, match=message):
        operation(Interval(-0.5, 1.0))


def test_comparisons_are_certain():
    x = Interval(np.array([0.0, 1.0, 2.0]), np.array([0.5, 1.5, 2.5]))
    assert (x < 1.2).tolist() == [True, False, False]
    assert (x > 1.2).tolist() == [False, False, True]
    assert (x != 1.2).tolist() == [True, False, True]
    assert (x == 1.2).tolist() == [False, False, False]
    assert np.less_equal(x, 1.5).tolist() == [True, True, False]
