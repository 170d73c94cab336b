"""The solver's own linear algebra against NumPy's."""

import numpy as np
import pytest
from numba import njit

from aerotube.sos.interior import lanes, tiles
from aerotube.sos.interior.tiles import padded

ORDERS = [1, 3, 7, 8, 9, 23, 24, 25, 64, 65, 130]


@njit
def _gram(x, y, row, k, c, c_row, begin):
    tiles.gram_product(x, 0, y, 0, row, k, row, c, 0, c_row, begin)


@njit
def _factor(a, row, order, inverses):
    return tiles.factor(a, 0, row, order, row, inverses, 0)


@njit
def _divide(a, row, order, inverses, x, transposed):
    if transposed:
        tiles.divide_by_transpose(a, row, order, inverses, x)
    else:
        tiles.divide(a, row, order, inverses, x)


@njit
def _longest(value, change, most, halvings, room):
    return tiles.longest_step(value, change, most, halvings, room)


def _wide(rng, k, order):
    """Random rows, padded with zeros."""
    return np.pad(rng.standard_normal((k, order)), ((0, 0), (0, int(padded.py_func(order)) - order)))


@pytest.mark.parametrize("order", ORDERS)
def test_schur_complements_are_entrywise_products(order):
    rng = np.random.default_rng(order)
    x, y = _wide(rng, 5, order), _wide(rng, 5, order)
    row = x.shape[1]
    c_row = row + 2 * lanes.LANES
    out = np.full((row, c_row), np.nan)
    _gram(x.ravel(), y.ravel(), row, 5, out.ravel(), c_row, True)
    expected = (x.T @ x) * (y.T @ y)
    np.testing.assert_allclose(np.triu(out[:, :row]), np.triu(expected), atol=1e-12)
    # Nothing is written beside the system.
    assert np.isnan(out[:, row:]).all()
    _gram(y.ravel(), y.ravel(), row, 5, out.ravel(), c_row, False)
    np.testing.assert_allclose(np.triu(out[:, :row]), np.triu(expected + (y.T @ y) ** 2), atol=1e-12)


def _system(rng, order, beside):
    """A positive definite matrix beside some columns, padded with ones on the diagonal."""
    width, more = (int(padded.py_func(k)) for k in (order, beside))
    root = rng.standard_normal((order, order + 3))
    whole = np.zeros((width, width + more))
    whole[:width, :width] = np.eye(width)
    whole[:order, :order] = root @ root.T + np.eye(order)
    whole[:order, width : width + beside] = rng.standard_normal((order, beside))
    return whole


@pytest.mark.parametrize("order", ORDERS)
def test_factors_and_solves(order):
    rng = np.random.default_rng(order)
    whole = _system(rng, order, 4)
    width, row = whole.shape
    matrix, flat, inverses = whole[:, :width].copy(), whole.ravel().copy(), np.empty(width)
    assert _factor(flat, row, width, inverses)
    found = flat.reshape(width, row)
    upper = np.linalg.cholesky(matrix).T
    np.testing.assert_allclose(np.triu(found[:, :width]), upper, atol=1e-10 * np.abs(upper).max())
    expected = np.linalg.solve(upper.T, whole[:, width:])
    np.testing.assert_allclose(found[:, width:], expected, atol=1e-10 * max(1.0, np.abs(expected).max()))
    np.testing.assert_allclose(inverses, 1.0 / np.diag(upper), rtol=1e-12)
    x = rng.standard_normal(width)
    for transposed, triangle in ((True, upper.T), (False, upper)):
        own = x.copy()
        _divide(flat, row, width, inverses, own, transposed)
        np.testing.assert_allclose(own, np.linalg.solve(triangle, x), rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("bad", [-1e-3, np.nan])
def test_what_is_not_positive_definite_has_no_factor(order, bad):
    rng = np.random.default_rng(order)
    whole = _system(rng, order, 1)
    whole[order - 1, order - 1] = bad
    assert not _factor(whole.ravel(), whole.shape[1], whole.shape[0], np.empty(whole.shape[0]))


@pytest.mark.parametrize("order", [n for n in ORDERS if n < 30])
def test_the_longest_step_is_nearly_reached_and_never_passed(order):
    rng = np.random.default_rng(order)
    root = rng.standard_normal((order, order + 2))
    value, change = root @ root.T, rng.standard_normal((order, order))
    change = change + change.T - 2.0 * np.eye(order)
    width = int(padded.py_func(order))
    room = np.full(width * (width + 1), np.nan)
    # Where value + step * change becomes singular.
    slopes = np.linalg.eigvals(np.linalg.solve(value, change)).real
    exact = -1.0 / slopes.min() if slopes.min() < 0 else np.inf
    assert np.isfinite(exact)
    assert _longest(value, change, 0.9 * exact, 8, room) == 0.9 * exact
    step = _longest(value, change, 1.3 * exact, 12, room)
    assert 0.99 * exact < step <= exact * (1 + 1e-9)
