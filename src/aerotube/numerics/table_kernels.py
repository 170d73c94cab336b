"""Compiled evaluation and expansion of tables at many points."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from aerotube.numerics.tables import Axis, Table1, Table2

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def cell_of(axis: Axis, x: float) -> int:
    """Index of the cell that holds x; 0 where x is not a number."""
    last = axis.boundaries.size
    if last == 0:
        return 0
    guess = (x - axis.boundaries[0]) * axis.inverse_step + 1.0
    if not guess > 0.0:
        index = 0
    elif guess >= last:
        index = last
    else:
        index = int(guess)
    while index > 0 and x < axis.boundaries[index - 1]:
        index -= 1
    while index < last and x >= axis.boundaries[index]:
        index += 1
    return index


@njit(cache=True, nogil=True)
def evaluate1(table: Table1, x: Array, values: Array) -> None:
    """Write the outputs (outputs, points) at the points x (points,)."""
    outputs, powers = table.coefficients.shape[1:]
    for point in range(x.size):
        cell = cell_of(table.x, x[point])
        local = x[point] - table.x.origins[cell]
        for output in range(outputs):
            value = table.coefficients[cell, output, powers - 1]
            for power in range(powers - 2, -1, -1):
                value = value * local + table.coefficients[cell, output, power]
            values[output, point] = value


@njit(cache=True, nogil=True)
def evaluate2(table: Table2, x: Array, y: Array, values: Array) -> None:
    """Write the outputs (outputs, points) at the points (x, y), each (points,)."""
    outputs, powers_x, powers_y = table.coefficients.shape[2:]
    for point in range(x.size):
        cell_x, cell_y = cell_of(table.x, x[point]), cell_of(table.y, y[point])
        local_x = x[point] - table.x.origins[cell_x]
        local_y = y[point] - table.y.origins[cell_y]
        pieces = table.coefficients[cell_x, cell_y]
        for output in range(outputs):
            value = 0.0
            for i in range(powers_x - 1, -1, -1):
                inner = pieces[output, i, powers_y - 1]
                for j in range(powers_y - 2, -1, -1):
                    inner = inner * local_y + pieces[output, i, j]
                value = value * local_x + inner
            values[output, point] = value


@njit(cache=True, nogil=True)
def expand1(table: Table1, x: Array, series: Array) -> None:
    """Write the local Taylor coefficients (points, outputs, order + 1) at the points x (points,)."""
    outputs, powers = table.coefficients.shape[1:]
    order = series.shape[2] - 1
    work = np.empty(powers)
    for point in range(x.size):
        cell = cell_of(table.x, x[point])
        local = x[point] - table.x.origins[cell]
        for output in range(outputs):
            for i in range(powers):
                work[i] = table.coefficients[cell, output, i]
            shift_polynomial(work, local)
            for power in range(order + 1):
                series[point, output, power] = work[power] if power < powers else 0.0


@njit(cache=True, nogil=True)
def expand2(table: Table2, x: Array, y: Array, series: Array) -> None:
    """Write the local Taylor coefficients (points, outputs, order + 1, order + 1) at the points (x, y)."""
    outputs, powers_x, powers_y = table.coefficients.shape[2:]
    order = series.shape[2] - 1
    work, along_x, along_y = np.empty((powers_x, powers_y)), np.empty(powers_x), np.empty(powers_y)
    for point in range(x.size):
        cell_x, cell_y = cell_of(table.x, x[point]), cell_of(table.y, y[point])
        local_x = x[point] - table.x.origins[cell_x]
        local_y = y[point] - table.y.origins[cell_y]
        for output in range(outputs):
            for i in range(powers_x):
                for j in range(powers_y):
                    along_y[j] = table.coefficients[cell_x, cell_y, output, i, j]
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
