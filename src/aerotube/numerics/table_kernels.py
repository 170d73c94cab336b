"""Compiled evaluation and expansion of tables."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from aerotube.numerics.tables import Table1, Table2

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def cell_of(data: Array, start: int, cells: int, inverse_step: float, x: float) -> int:
    """Index of the cell that holds x, its boundaries starting at `start`; 0 where x is not a number."""
    last = cells - 1
    if last == 0:
        return 0
    guess = (x - data[start]) * inverse_step + 1.0
    if not guess > 0.0:
        index = 0
    elif guess >= last:
        index = last
    else:
        index = int(guess)
    while index > 0 and x < data[start + index - 1]:
        index -= 1
    while index < last and x >= data[start + index]:
        index += 1
    return index


@njit(cache=True, nogil=True)
def locate1(table: Table1, x: float) -> tuple[int, float]:
    """Where in the table's row the cell's coefficients (outputs, powers) start, and x relative to its origin."""
    cell = cell_of(table.data, 0, table.cells, table.inverse_step, x)
    start = 2 * table.cells - 1 + cell * table.outputs * table.powers
    return start, x - table.data[table.cells - 1 + cell]


@njit(cache=True, nogil=True)
def locate2(table: Table2, x: float, y: float) -> tuple[int, float, float]:
    """Where in the table's row the cell's coefficients (outputs, powers of x, of y) start, and x, y in the cell."""
    start_y = 2 * table.cells_x - 1
    cell_x = cell_of(table.data, 0, table.cells_x, table.inverse_step_x, x)
    cell_y = cell_of(table.data, start_y, table.cells_y, table.inverse_step_y, y)
    size = table.outputs * table.powers_x * table.powers_y
    start = start_y + 2 * table.cells_y - 1 + (cell_x * table.cells_y + cell_y) * size
    local_x = x - table.data[table.cells_x - 1 + cell_x]
    local_y = y - table.data[start_y + table.cells_y - 1 + cell_y]
    return start, local_x, local_y


@njit(cache=True, nogil=True)
def value1(data: Array, start: int, powers: int, output: int, x: float) -> float:
    """One output of the cell whose coefficients start there, x relative to its origin."""
    last = start + (output + 1) * powers - 1
    value = data[last]
    for power in range(1, powers):
        value = value * x + data[last - power]
    return value


@njit(cache=True, nogil=True)
def value2(data: Array, start: int, powers_x: int, powers_y: int, output: int, x: float, y: float) -> float:
    """One output of the cell whose coefficients start there, x and y relative to its origin."""
    last = start - 1 + (output + 1) * powers_x * powers_y
    value = 0.0
    for i in range(powers_x):
        row = last - i * powers_y
        inner = data[row]
        for j in range(1, powers_y):
            inner = inner * y + data[row - j]
        value = value * x + inner
    return value


@njit(cache=True, nogil=True)
def evaluate1(table: Table1, x: Array, values: Array) -> None:
    """Write the outputs (outputs, points) at the points x (points,)."""
    data, powers = table.data, table.powers
    for point in range(x.size):
        start, local = locate1(table, x[point])
        for output in range(table.outputs):
            values[output, point] = value1(data, start, powers, output, local)


@njit(cache=True, nogil=True)
def evaluate2(table: Table2, x: Array, y: Array, values: Array) -> None:
    """Write the outputs (outputs, points) at the points (x, y), each (points,)."""
    data, powers_x, powers_y = table.data, table.powers_x, table.powers_y
    for point in range(x.size):
        start, local_x, local_y = locate2(table, x[point], y[point])
        for output in range(table.outputs):
            values[output, point] = value2(data, start, powers_x, powers_y, output, local_x, local_y)


@njit(cache=True, nogil=True)
def expand1(table: Table1, x: Array, series: Array) -> None:
    """Write the local Taylor coefficients (points, outputs, order + 1) at the points x (points,)."""
    powers, order = table.powers, series.shape[2] - 1
    work = np.empty(powers)
    for point in range(x.size):
        start, local = locate1(table, x[point])
        for output in range(table.outputs):
            for i in range(powers):
                work[i] = table.data[start + output * powers + i]
            shift_polynomial(work, local)
            for power in range(order + 1):
                series[point, output, power] = work[power] if power < powers else 0.0


@njit(cache=True, nogil=True)
def expand2(table: Table2, x: Array, y: Array, series: Array) -> None:
    """Write the local Taylor coefficients (points, outputs, order + 1, order + 1) at the points (x, y)."""
    powers_x, powers_y, order = table.powers_x, table.powers_y, series.shape[2] - 1
    work, along_x, along_y = np.empty((powers_x, powers_y)), np.empty(powers_x), np.empty(powers_y)
    for point in range(x.size):
        start, local_x, local_y = locate2(table, x[point], y[point])
        for output in range(table.outputs):
            for i in range(powers_x):
                for j in range(powers_y):
                    along_y[j] = table.data[start + (output * powers_x + i) * powers_y + j]
                shift_polynomial(along_y, local_y)
                for j in range(powers_y):
                    work[i, j] = along_y[j]
            for j in range(powers_y):
                for i in range(powers_x):
                    along_x[i] = work[i, j]
                shift_polynomial(along_x, local_x)
                for i in range(powers_x):
                    work[i, j] = along_x[i]
            for i in range(order + 1):
                for j in range(order + 1):
                    inside = i < powers_x and j < powers_y
                    series[point, output, i, j] = work[i, j] if inside else 0.0


@njit(cache=True, nogil=True)
def shift_polynomial(coefficients: Array, distance: float) -> None:
    """Move the origin of a polynomial (powers,) by a distance, in place, by repeated synthetic division."""
    powers = coefficients.size
    for known in range(powers - 1):
        for power in range(powers - 2, known - 1, -1):
            coefficients[power] += distance * coefficients[power + 1]
