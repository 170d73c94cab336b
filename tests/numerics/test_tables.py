from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from aerotube.numerics import lookup1, lookup2, stack1, stack2, table1, table2

INTERPOLATIONS = ["linear", "smooth"]


def uneven(seed, count):
    return np.cumsum(np.random.default_rng(seed).uniform(0.3, 2.0, count))


def data(seed, *shape):
    return np.random.default_rng(100 + seed).normal(size=shape)


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@given(seed=st.integers(0, 1000), count=st.integers(3, 14))
@settings(max_examples=20, deadline=None)
def test_passes_through_its_nodes(interpolation, seed, count):
    x, y = uneven(seed, count), uneven(seed + 1, 5)
    values = data(seed, 2, count, 5)
    assert lookup1(table1(x, values[:, :, 0], interpolation), x) == pytest.approx(values[:, :, 0], abs=1e-12)
    table = table2(x, y, values, interpolation)
    assert lookup2(table, x[:, None], y) == pytest.approx(values, abs=1e-11)


@given(seed=st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_linear_agrees_with_scipy_inside_and_outside(seed):
    x, y, values = uneven(seed, 6), uneven(seed + 1, 4), data(seed, 3, 6, 4)
    reference = RegularGridInterpolator((x, y), np.moveaxis(values, 0, -1), bounds_error=False, fill_value=None)
    random = np.random.default_rng(seed)
    at_x, at_y = random.uniform(x[0] - 1, x[-1] + 1, 40), random.uniform(y[0] - 1, y[-1] + 1, 40)
    expected = reference(np.stack([at_x, at_y], axis=-1)).T
    assert lookup2(table2(x, y, values), at_x, at_y) == pytest.approx(expected, abs=1e-12)
    along = lookup1(table1(x, values[:, :, 0]), at_x)
    expected = reference(np.stack([at_x, np.full_like(at_x, y[0])], axis=-1)).T
    assert along == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_smooth_reproduces_quadratics_everywhere(degree):
    """A polynomial of degree two has no third derivative, so nothing through its nodes is smoother."""
    x, y = uneven(1, 7), uneven(2, 5)
    outside_x, outside_y = np.linspace(x[0] - 3, x[-1] + 3, 31), np.linspace(y[0] - 3, y[-1] + 3, 31)
    polynomial = np.polynomial.Polynomial([0.7, -0.4, 0.3][: degree + 1])
    table = table1(x, polynomial(x)[None], "smooth")
    assert lookup1(table, outside_x)[0] == pytest.approx(polynomial(outside_x), abs=1e-10)
    table = table2(x, y, (polynomial(x)[:, None] * polynomial(y))[None], "smooth")
    expected = polynomial(outside_x) * polynomial(outside_y)
    assert lookup2(table, outside_x, outside_y)[0] == pytest.approx(expected, rel=1e-10, abs=1e-10)


def bending(function, low, high, breaks):
    """Integral of the squared third derivative by Gauss-Legendre quadrature on each piece."""
    nodes, weights = np.polynomial.legendre.leggauss(5)
    edges = np.unique(np.concatenate([[low, high], breaks[(breaks > low) & (breaks < high)]]))
    total = 0.0
    for a, b in pairwise(edges):
        t = 0.5 * (a + b) + 0.5 * (b - a) * nodes
        total += 0.5 * (b - a) * np.sum(weights * function(t) ** 2)
    return total


def third_derivative(table):
    def function(t):
        cell = np.searchsorted(table.x.boundaries, t, side="right")
        local = t - table.x.origins[cell]
        c = table.coefficients[cell, 0]
        return 6 * c[:, 3] + 24 * c[:, 4] * local + 60 * c[:, 5] * local**2

    return function


def test_smooth_bends_least_of_all_functions_through_the_nodes():
    """Against members of the same family that pass through the nodes and some more points beside the curve."""
    x, values = uneven(3, 8), data(3, 1, 8)
    table = table1(x, values, "smooth")
    low, high = x[0] - 1.0, x[-1] + 1.0
    least = bending(third_derivative(table), low, high, x)
    middle = 0.5 * (x[3] + x[4])
    for offset in (-0.2, -0.01, 0.01, 0.2):
        more = np.insert(x, 4, middle)
        through = np.insert(values[0], 4, lookup1(table, middle)[0] + offset)
        other = table1(more, through[None], "smooth")
        assert bending(third_derivative(other), low, high, more) > least


def test_smooth_has_four_continuous_derivatives_across_every_node():
    x, y, values = uneven(4, 6), uneven(5, 5), data(4, 2, 6, 5)
    for axis, table in ((0, table1(x, values[:, :, 0], "smooth")), (1, table2(x, y, values, "smooth"))):
        coefficients, cells = table.coefficients, table.x
        width = cells.boundaries - cells.origins[:-1]
        for left in range(cells.boundaries.size):
            before = coefficients[left]
            after = coefficients[left + 1]
            power_axis = before.ndim - 1 - axis
            before = np.moveaxis(before, power_axis, 0)
            after = np.moveaxis(after, power_axis, 0)
            polynomial = np.polynomial.polynomial
            for order in range(5):
                there = polynomial.polyval(width[left], polynomial.polyder(before, order))
                here = polynomial.polyval(0.0, polynomial.polyder(after, order))
                assert there == pytest.approx(here, abs=1e-9)


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_stacking_changes_no_value(interpolation):
    coarse_x, fine_x, y = np.linspace(-3.0, 3.0, 4), np.linspace(-3.0, 3.0, 7), uneven(6, 5)
    tables = [
        table2(coarse_x, y, data(7, 2, 4, 5), interpolation),
        table2(fine_x, y, data(8, 1, 7, 5), interpolation),
        table2(uneven(9, 6) - 4.0, uneven(10, 4), data(9, 1, 6, 4), interpolation),
    ]
    random = np.random.default_rng(11)
    x, at_y = random.uniform(-5.0, 6.0, 300), random.uniform(-1.0, 8.0, 300)
    expected = np.concatenate([lookup2(table, x, at_y) for table in tables])
    assert lookup2(stack2(tables), x, at_y) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    rows = [table1(coarse_x, data(1, 1, 4), interpolation), table1(fine_x, data(2, 3, 7), "linear")]
    expected = np.concatenate([lookup1(table, x) for table in rows])
    assert lookup1(stack1(rows), x) == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_mirrored_data_give_an_odd_function(interpolation):
    one_sided, values = np.linspace(0.0, 4.0, 6), np.append(0.0, data(12, 5))
    nodes = np.append(-one_sided[:0:-1], one_sided)
    table = table1(nodes, np.append(-values[:0:-1], values)[None], interpolation)
    x = np.linspace(0.0, 5.0, 40)
    assert lookup1(table, -x) == pytest.approx(-lookup1(table, x), abs=1e-13)


def test_shapes_of_points():
    table, plane = table1([0, 1, 2], data(1, 2, 3)), table2([0, 1], [0, 1, 2], data(2, 4, 2, 3))
    assert lookup1(table, 0.5).shape == (2,)
    assert lookup1(table, np.zeros((5, 3))).shape == (2, 5, 3)
    assert lookup2(plane, 0.5, np.zeros((5, 3))).shape == (4, 5, 3)
    assert lookup2(plane, np.zeros((5, 1)), np.zeros(3)).shape == (4, 5, 3)
    strided = np.linspace(0, 2, 12).reshape(3, 4).T[::2]
    assert lookup1(table, strided) == pytest.approx(lookup1(table, strided.copy()), abs=0)


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_not_a_number_stays_one_and_far_away_is_safe(interpolation):
    table = table1([0, 1, 2, 3], data(3, 1, 4), interpolation)
    assert np.isnan(lookup1(table, np.nan)).all()
    plane = table2([0, 1, 2], [0, 1, 2], data(4, 1, 3, 3), interpolation)
    assert np.isnan(lookup2(plane, np.nan, 0.5)).all()
    assert np.isnan(lookup2(plane, 0.5, np.nan)).all()
    assert np.isfinite(lookup1(table, [-1e30, 1e30])).all()
    assert not np.isfinite(lookup1(table, [np.inf, -np.inf])).any()


@pytest.mark.parametrize(
    ("x", "values", "interpolation", "message"),
    [
        ([0, 1], [[1, 2]], "cubic", "choose 'linear' or 'smooth'"),
        ([0, 1], [[1, 2]], "smooth", "at least 3 breakpoints"),
        ([0], [[1]], "linear", "at least 2 breakpoints"),
        ([0, 0, 1], [[1, 2, 3]], "linear", "ascend"),
        ([0, 2, 1], [[1, 2, 3]], "linear", "ascend"),
        ([0, np.nan, 1], [[1, 2, 3]], "linear", "finite"),
        ([0, 1, 2], [[1, 2]], "linear", "shape"),
        ([0, 1, 2], [1, 2, 3], "linear", "shape"),
        ([0, 1, 2], [[1, np.inf, 3]], "linear", "finite"),
    ],
)
def test_bad_tables_are_refused(x, values, interpolation, message):
    with pytest.raises(ValueError, match=message):
        table1(x, values, interpolation)
    with pytest.raises(ValueError, match="no table"):
        stack1([])
