"""Tables read with Taylor polynomials."""

import numpy as np
import pytest

from aerotube.numerics import Taylor, TaylorSpace, lookup1, lookup2, table1, table2

RANDOM = np.random.default_rng(30)
X, Y = np.linspace(-2.0, 3.0, 6), np.array([0.0, 0.7, 1.1, 2.0, 2.4])
VALUES = RANDOM.normal(size=(3, 6, 5))


@pytest.mark.parametrize("interpolation", ["linear", "smooth"])
def test_expansion_is_exact_in_its_cell(interpolation):
    """To tenth degree nothing is lost of a piece of fifth degree in each variable, so values agree anywhere in it."""
    space = TaylorSpace(2, 10)
    at = np.array([[0.3, 0.9], [-2.6, 1.9], [2.9, -0.5], [3.5, 2.9]])  # one inside, the others outside
    near = at + RANDOM.uniform(-0.09, 0.09, at.shape)
    plane = table2(X, Y, VALUES, interpolation)
    found = lookup2(plane, space.variable(0, at[:, 0]), space.variable(1, at[:, 1]))
    expected = lookup2(plane, *near.T)
    for output in range(3):
        value = found[output]((near - at)[:, None, :])[:, 0]
        assert value == pytest.approx(expected[output], rel=1e-12, abs=1e-12)
    row = table1(X, VALUES[:, :, 0], interpolation)
    along = lookup1(row, space.variable(0, at[:, 0]))
    expected = lookup1(row, near[:, 0])
    for output in range(3):
        value = along[output]((near - at)[:, None, :])[:, 0]
        assert value == pytest.approx(expected[output], rel=1e-12, abs=1e-12)


def test_smooth_derivatives_are_continuous_where_linear_ones_jump():
    space, node = TaylorSpace(1, 4), X[2]
    below, above = (space.variable(0, node + step) for step in (-1e-12, 1e-12))
    smooth, linear = (table1(X, VALUES[:, :, 0], name) for name in ("smooth", "linear"))
    for output in range(3):
        left, right = lookup1(smooth, below)[output], lookup1(smooth, above)[output]
        assert left.coefficients == pytest.approx(right.coefficients, abs=1e-9)
        left, right = lookup1(linear, below)[output], lookup1(linear, above)[output]
        assert abs(left.coefficients[1] - right.coefficients[1]) > 1e-3
        slope = (VALUES[output, 2, 0] - VALUES[output, 1, 0]) / (X[2] - X[1])
        assert left.coefficients[1] == pytest.approx(slope, rel=1e-12)
        assert not left.coefficients[2:].any()
        # on the node itself, the cell above
        at_node = lookup1(linear, space.variable(0, node))[output]
        assert at_node.coefficients[1] == pytest.approx(right.coefficients[1], rel=1e-12)


def test_chain_rule_through_a_table():
    """A table of polynomials of polynomials is their composition: second route through `compose` and products."""
    space = TaylorSpace(3, 4)
    inner = Taylor(space, RANDOM.uniform(-0.5, 0.5, (2, space.size)))
    other = Taylor(space, RANDOM.uniform(0.2, 0.5, (2, space.size)))
    nodes = np.linspace(-3.0, 3.0, 7)
    square = table1(nodes, (nodes**2 - nodes)[None], "smooth")
    assert lookup1(square, inner)[0].coefficients == pytest.approx((inner**2 - inner).coefficients, abs=1e-12)
    product = table2(nodes, nodes, (nodes[:, None] ** 2 * (1.0 + nodes))[None], "smooth")
    expected = inner**2 * (1.0 + other)
    assert lookup2(product, inner, other)[0].coefficients == pytest.approx(expected.coefficients, abs=1e-11)


def test_one_argument_may_be_a_number():
    space, plane = TaylorSpace(1, 3), table2(X, Y, VALUES, "smooth")
    x = space.variable(0, np.array([0.1, 1.2]))
    found = lookup2(plane, x, 0.8)
    both = lookup2(plane, x, space.constant(0.8))
    swapped = lookup2(plane, 0.8, x)
    assert swapped[0].value == pytest.approx(lookup2(plane, 0.8, x.value)[0], abs=1e-14)
    for output in range(3):
        assert found[output].coefficients == pytest.approx(both[output].coefficients, abs=0)


def test_constant_polynomials_of_order_zero():
    space, plane = TaylorSpace(1, 0), table2(X, Y, VALUES, "smooth")
    found = lookup2(plane, space.variable(0, 0.4), 1.5)
    assert [x.value for x in found] == pytest.approx(lookup2(plane, 0.4, 1.5), abs=1e-14)
    row = table1(X, VALUES[:, :, 0], "smooth")
    assert [x.value for x in lookup1(row, space.variable(0, 0.4))] == pytest.approx(lookup1(row, 0.4), abs=1e-14)
