"""Tables read with Taylor models.

The polynomial part is the Taylor expansion of the cell that holds the argument's value. What it leaves out is bounded
over the argument's range, cell by cell: there the table is one polynomial, its difference from the expansion another,
and that one, expanded about the point of the cell nearest the value, is bounded by the absolute values of its terms.
Kinks of linear tables, higher powers of smooth ones and the rounding in their joints are all in that difference.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from aerotube.numerics.table_kernels import cell_of, expand1, expand2, shift_polynomial
from aerotube.numerics.tables import Table1, Table2
from aerotube.numerics.taylor_model import TaylorModel, combine

Array = NDArray[np.float64]

# Of the sums of absolute values: moving the origins of two polynomials of at most eight powers, in one or two
# variables, and taking their difference, rounds each term fewer than sixty times.
_ROUNDING = 128.0 * 2.0**-53
_LEAST = 1e-150


def enclose1(table: Table1, x: TaylorModel) -> tuple[TaylorModel, ...]:
    """Models of all outputs of a table at a model."""
    order = x.space.order
    middle, bounds = np.ascontiguousarray(x.value).reshape(-1), x.bounds
    series = np.empty((middle.size, table.outputs, order + 1))
    extra = np.empty((middle.size, table.outputs))
    expand1(table, middle, series)
    _rest1(table, middle, bounds.lower.reshape(-1), bounds.upper.reshape(-1), series, extra)
    step = x - x.value
    powers = [x.space.constant(np.ones(x.shape)), step]
    while len(powers) <= order:
        powers.append(powers[-1] * step)
    return combine(powers, series.reshape(*x.shape, *series.shape[1:]), extra)


def enclose2(table: Table2, x: Any, y: Any) -> tuple[TaylorModel, ...]:
    """Models of all outputs of a table at two arguments, at least one of them a model."""
    space = x.space if isinstance(x, TaylorModel) else y.space
    shape = np.broadcast_shapes(*(z.shape if isinstance(z, TaylorModel) else np.shape(z) for z in (x, y)))
    zero = np.zeros(shape)
    first, second = ((z if isinstance(z, TaylorModel) else space.constant(z)).shifted(zero) for z in (x, y))
    order = space.order
    at = [np.ascontiguousarray(z.value).reshape(-1) for z in (first, second)]
    ends = [(z.bounds.lower.reshape(-1), z.bounds.upper.reshape(-1)) for z in (first, second)]
    series = np.empty((at[0].size, table.outputs, order + 1, order + 1))
    extra = np.empty((at[0].size, table.outputs))
    expand2(table, at[0], at[1], series)
    _rest2(table, at[0], at[1], *ends[0], *ends[1], series, extra)

    along_x, along_y = first - first.value, second - second.value
    powers = {(0, 0): space.constant(np.ones(shape)), (1, 0): along_x, (0, 1): along_y}
    for degree in range(2, order + 1):
        for i in range(degree + 1):
            j = degree - i
            powers[i, j] = powers[i, j - 1] * along_y if j else powers[i - 1, j] * along_x
    chosen = np.stack([series[..., i, j] for i, j in powers], axis=-1)
    return combine(list(powers.values()), chosen.reshape(*shape, *chosen.shape[1:]), extra)


@njit(cache=True, nogil=True)
def _nearest(data: Array, start: int, cells: int, cell: int, middle: float, low: float, high: float) -> Any:
    """The point of a cell nearest `middle`, and how far from it the range reaches within the cell."""
    left = data[start + cell - 1] if cell > 0 else -np.inf
    right = data[start + cell] if cell < cells - 1 else np.inf
    anchor = min(max(middle, left), right)
    return anchor, max(min(high, right) - anchor, anchor - max(low, left)) * (1.0 + 2.0**-40)


@njit(cache=True, nogil=True)
def _bound(coefficients: Array, reach: float) -> float:
    """Sum of the absolute values of a polynomial's terms, at `reach`."""
    total = 0.0
    for power in range(coefficients.size - 1, -1, -1):
        total = total * reach + abs(coefficients[power])
    return total


@njit(cache=True, nogil=True)
def _rest1(table: Table1, middle: Array, low: Array, high: Array, series: Array, extra: Array) -> None:
    """Write bounds (points, outputs) of the table less its expansions series (points, outputs, order + 1)."""
    data, cells, powers = table.data, table.cells, table.powers
    count = max(powers, series.shape[2])
    piece, expansion = np.zeros(count), np.zeros(count)
    for point in range(middle.size):
        centre = middle[point]
        first = cell_of(data, 0, cells, table.inverse_step, low[point])
        last = cell_of(data, 0, cells, table.inverse_step, high[point])
        for output in range(table.outputs):
            worst = 0.0
            for cell in range(first, last + 1):
                anchor, reach = _nearest(data, 0, cells, cell, centre, low[point], high[point])
                start = 2 * cells - 1 + (cell * table.outputs + output) * powers
                for i in range(count):
                    piece[i] = data[start + i] if i < powers else 0.0
                    expansion[i] = series[point, output, i] if i < series.shape[2] else 0.0
                from_origin, from_centre = anchor - data[cells - 1 + cell], anchor - centre
                size = _bound(piece, abs(from_origin) + reach) + _bound(expansion, abs(from_centre) + reach)
                shift_polynomial(piece, from_origin)
                shift_polynomial(expansion, from_centre)
                for i in range(count):
                    piece[i] -= expansion[i]
                worst = max(worst, _bound(piece, reach) + _ROUNDING * size + _LEAST)
            extra[point, output] = worst * (1.0 + 2.0**-40)


@njit(cache=True, nogil=True)
def _shift_both(coefficients: Array, distance_x: float, distance_y: float, column: Array) -> None:
    """Move the origin of a polynomial (powers of x, powers of y), in place."""
    for i in range(coefficients.shape[0]):
        shift_polynomial(coefficients[i], distance_y)
    for j in range(coefficients.shape[1]):
        for i in range(column.size):
            column[i] = coefficients[i, j]
        shift_polynomial(column, distance_x)
        for i in range(column.size):
            coefficients[i, j] = column[i]


@njit(cache=True, nogil=True)
def _bound_both(coefficients: Array, reach_x: float, reach_y: float) -> float:
    total = 0.0
    for i in range(coefficients.shape[0] - 1, -1, -1):
        total = total * reach_x + _bound(coefficients[i], reach_y)
    return total


@njit(cache=True, nogil=True)
def _rest2(
    table: Table2,
    middle_x: Array,
    middle_y: Array,
    low_x: Array,
    high_x: Array,
    low_y: Array,
    high_y: Array,
    series: Array,
    extra: Array,
) -> None:
    """Write bounds (points, outputs) of the table less the terms of total degree up to the order of its expansions.

    series (points, outputs, order + 1, order + 1).
    """
    data, cells_x, cells_y, px, py = table.data, table.cells_x, table.cells_y, table.powers_x, table.powers_y
    terms, start_y = series.shape[2], 2 * table.cells_x - 1
    nx, ny = max(px, terms), max(py, terms)
    piece, expansion, column = np.zeros((nx, ny)), np.zeros((nx, ny)), np.zeros(nx)
    for point in range(middle_x.size):
        x, y = middle_x[point], middle_y[point]
        first_x = cell_of(data, 0, cells_x, table.inverse_step_x, low_x[point])
        last_x = cell_of(data, 0, cells_x, table.inverse_step_x, high_x[point])
        first_y = cell_of(data, start_y, cells_y, table.inverse_step_y, low_y[point])
        last_y = cell_of(data, start_y, cells_y, table.inverse_step_y, high_y[point])
        for output in range(table.outputs):
            worst = 0.0
            for cell_x in range(first_x, last_x + 1):
                at_x, reach_x = _nearest(data, 0, cells_x, cell_x, x, low_x[point], high_x[point])
                from_x = at_x - data[cells_x - 1 + cell_x]
                for cell_y in range(first_y, last_y + 1):
                    at_y, reach_y = _nearest(data, start_y, cells_y, cell_y, y, low_y[point], high_y[point])
                    from_y = at_y - data[start_y + cells_y - 1 + cell_y]
                    start = start_y + 2 * cells_y - 1 + ((cell_x * cells_y + cell_y) * table.outputs + output) * px * py
                    for i in range(nx):
                        for j in range(ny):
                            piece[i, j] = data[start + i * py + j] if i < px and j < py else 0.0
                            expansion[i, j] = series[point, output, i, j] if i + j < terms else 0.0
                    size = _bound_both(piece, abs(from_x) + reach_x, abs(from_y) + reach_y)
                    size += _bound_both(expansion, abs(at_x - x) + reach_x, abs(at_y - y) + reach_y)
                    _shift_both(piece, from_x, from_y, column)
                    _shift_both(expansion, at_x - x, at_y - y, column)
                    for i in range(nx):
                        for j in range(ny):
                            piece[i, j] -= expansion[i, j]
                    worst = max(worst, _bound_both(piece, reach_x, reach_y) + _ROUNDING * size + _LEAST)
            extra[point, output] = worst * (1.0 + 2.0**-40)
