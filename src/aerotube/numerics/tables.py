"""Tables over breakpoints: piecewise polynomials in one and two variables, several outputs in one call.

A table is stored as one local polynomial per cell, whatever its interpolation:

* ``"linear"``: (bi)linear between the breakpoints, the end cells continued outside (the customary reading
  of a published table);
* ``"smooth"``: the natural quintic spline through the same nodes, a tensor product in two variables. Of all
  functions through the nodes it has the least integral of the squared third derivative; it has four
  continuous derivatives everywhere, and continues outside as a quadratic (I. J. Schoenberg, "Spline
  interpolation and the higher derivatives", Proc. Natl. Acad. Sci. 51, 1964).

Tables are named tuples of arrays, so that compiled code can take them as arguments; they are read with `lookup1`
and `lookup2`.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import comb, factorial
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Interpolation = Literal["linear", "smooth"]
Array = NDArray[np.float64]

_SMOOTH_DEGREE = 5


class Axis(NamedTuple):
    """The cells of one variable.

    Cell ``i`` lies between ``boundaries[i - 1]`` and ``boundaries[i]``; the first and the last are unbounded.
    """

    boundaries: Array  # (cells - 1,), ascending
    origins: Array  # (cells,): where the local coordinate of a cell is zero
    inverse_step: float  # of a uniform axis; elsewhere only a first guess of the cell


class Table1(NamedTuple):
    """Functions of one variable; make it with `table1` or `stack1`.

    All its numbers lie in one row, so that compiled code has few arrays to hand about: the cells' boundaries and
    origins, then the coefficients.
    """

    data: Array
    cells: int
    outputs: int
    powers: int
    inverse_step: float

    @property
    def x(self) -> Axis:
        """The cells."""
        return _axis_in(self.data, 0, self.cells, self.inverse_step)

    @property
    def coefficients(self) -> Array:
        """Local polynomials (cells, outputs, power of x)."""
        return self.data[2 * self.cells - 1 :].reshape(self.cells, self.outputs, self.powers)


class Table2(NamedTuple):
    """Functions of two variables; make it with `table2` or `stack2`.

    All its numbers lie in one row: boundaries and origins of the cells of x, those of y, then the coefficients.
    """

    data: Array
    cells_x: int
    cells_y: int
    outputs: int
    powers_x: int
    powers_y: int
    inverse_step_x: float
    inverse_step_y: float

    @property
    def x(self) -> Axis:
        """The cells of the first variable."""
        return _axis_in(self.data, 0, self.cells_x, self.inverse_step_x)

    @property
    def y(self) -> Axis:
        """The cells of the second variable."""
        return _axis_in(self.data, 2 * self.cells_x - 1, self.cells_y, self.inverse_step_y)

    @property
    def coefficients(self) -> Array:
        """Local polynomials (cells of x, cells of y, outputs, power of x, power of y)."""
        shape = (self.cells_x, self.cells_y, self.outputs, self.powers_x, self.powers_y)
        return self.data[2 * (self.cells_x + self.cells_y) - 2 :].reshape(shape)


def table1(x: ArrayLike, values: ArrayLike, interpolation: Interpolation = "linear") -> Table1:
    """Table of functions of one variable.

    Parameters
    ----------
    x : array (n,)
        Breakpoints, ascending.
    values : array (outputs, n)
        Values at the breakpoints.
    interpolation : {"linear", "smooth"}

    Raises
    ------
    ValueError
        If breakpoints do not ascend, are too few, or do not match the values.
    """
    nodes = _breakpoints(x, interpolation)
    data = _values(values, (nodes.size,))
    axis, pieces = _pieces(nodes, data.T, interpolation)  # (cells, power, outputs)
    return _packed1(axis, pieces.transpose(0, 2, 1))


def table2(x: ArrayLike, y: ArrayLike, values: ArrayLike, interpolation: Interpolation = "linear") -> Table2:
    """Table of functions of two variables.

    Parameters
    ----------
    x, y : array (nx,), (ny,)
        Breakpoints, ascending.
    values : array (outputs, nx, ny)
        Values at the breakpoints.
    interpolation : {"linear", "smooth"}

    Raises
    ------
    ValueError
        If breakpoints do not ascend, are too few, or do not match the values.
    """
    nodes_x, nodes_y = _breakpoints(x, interpolation), _breakpoints(y, interpolation)
    data = _values(values, (nodes_x.size, nodes_y.size))
    axis_x, along_x = _pieces(nodes_x, data.transpose(1, 0, 2), interpolation)  # (cx, px, outputs, ny)
    axis_y, both = _pieces(nodes_y, np.moveaxis(along_x, -1, 0), interpolation)  # (cy, py, cx, px, outputs)
    return _packed2(axis_x, axis_y, both.transpose(2, 0, 4, 3, 1))


def stack1(tables: Sequence[Table1]) -> Table1:
    """One table with the outputs of all, over the union of their cells; no value changes."""
    axis = _union([table.x for table in tables])
    refined = [_refine(table.coefficients, table.x, axis, 0, 2) for table in tables]
    return _packed1(axis, np.concatenate(_padded(refined, (2,)), axis=1))


def stack2(tables: Sequence[Table2]) -> Table2:
    """One table with the outputs of all, over the union of their cells; no value changes."""
    x, y = _union([table.x for table in tables]), _union([table.y for table in tables])
    refined = [_refine(_refine(table.coefficients, table.x, x, 0, 3), table.y, y, 1, 4) for table in tables]
    return _packed2(x, y, np.concatenate(_padded(refined, (3, 4)), axis=2))


def _packed1(x: Axis, coefficients: Array) -> Table1:
    data = np.concatenate([x.boundaries, x.origins, coefficients.ravel()])
    cells, outputs, powers = coefficients.shape
    return Table1(data, cells, outputs, powers, x.inverse_step)


def _packed2(x: Axis, y: Axis, coefficients: Array) -> Table2:
    data = np.concatenate([x.boundaries, x.origins, y.boundaries, y.origins, coefficients.ravel()])
    cells_x, cells_y, outputs, powers_x, powers_y = coefficients.shape
    return Table2(data, cells_x, cells_y, outputs, powers_x, powers_y, x.inverse_step, y.inverse_step)


def _axis_in(data: Array, start: int, cells: int, inverse_step: float) -> Axis:
    middle = start + cells - 1
    return Axis(data[start:middle], data[middle : middle + cells], inverse_step)


def _breakpoints(x: ArrayLike, interpolation: str) -> Array:
    if interpolation not in ("linear", "smooth"):
        raise ValueError(f"interpolation is {interpolation!r}; choose 'linear' or 'smooth'")
    nodes = np.asarray(x, dtype=np.float64)
    least = 2 if interpolation == "linear" else 3
    if nodes.ndim != 1 or nodes.size < least:
        raise ValueError(f"{interpolation} interpolation needs at least {least} breakpoints in one row")
    if not np.all(np.isfinite(nodes)) or np.any(np.diff(nodes) <= 0.0):
        raise ValueError("breakpoints must be finite and ascend; sort them and drop repeated ones")
    return nodes


def _values(values: ArrayLike, shape: tuple[int, ...]) -> Array:
    data = np.asarray(values, dtype=np.float64)
    if data.ndim != 1 + len(shape) or data.shape[1:] != shape:
        raise ValueError(f"values have shape {data.shape}; breakpoints ask for (outputs, {str(shape)[1:-1]})")
    if not np.all(np.isfinite(data)):
        raise ValueError("table values must be finite")
    return data


def _pieces(nodes: Array, values: Array, interpolation: str) -> tuple[Axis, Array]:
    """Local polynomials (cells, power, ...) of the interpolant of values (n, ...) along the first axis."""
    step = np.diff(nodes)
    if interpolation == "linear":
        slopes = np.diff(values, axis=0) / step.reshape((-1,) + (1,) * (values.ndim - 1))
        return _axis(nodes[1:-1], nodes[:-1]), np.stack([values[:-1], slopes], axis=1)
    from scipy.interpolate import make_interp_spline  # slow to import

    ends = [(3, np.zeros(values.shape[1:])), (4, np.zeros(values.shape[1:]))]
    spline = make_interp_spline(nodes, values, k=_SMOOTH_DEGREE, bc_type=(ends, ends))
    inside = np.stack([spline(nodes[:-1], power) / factorial(power) for power in range(_SMOOTH_DEGREE + 1)], 1)
    before, after = np.zeros_like(inside[:1]), np.zeros_like(inside[:1])
    for power in range(3):
        # third and fourth derivatives vanish at the ends: the continuation is as smooth as the spline
        before[0, power] = inside[0, power]
        after[0, power] = spline(nodes[-1], power) / factorial(power)
    return _axis(nodes, np.append(nodes[:1], nodes)), np.concatenate([before, inside, after])


def _axis(boundaries: Array, origins: Array) -> Axis:
    span = boundaries[-1] - boundaries[0] if boundaries.size > 1 else 0.0
    return Axis(boundaries, origins, float((boundaries.size - 1) / span) if span > 0.0 else 0.0)


def _union(axes: Sequence[Axis]) -> Axis:
    """The coarsest cells that refine those of every axis."""
    if not axes:
        raise ValueError("there is no table to stack")
    boundaries = np.unique(np.concatenate([axis.boundaries for axis in axes]))
    first = min(axis.origins[0] for axis in axes)
    return _axis(boundaries, np.append(first, boundaries))


def _refine(coefficients: Array, axis: Axis, fine: Axis, cell_dim: int, power_dim: int) -> Array:
    """The same piecewise polynomials on finer cells: each coarse one expanded about the finer origins."""
    if fine.boundaries.size:
        middle = np.concatenate(
            [
                [fine.boundaries[0] - 1.0],
                0.5 * (fine.boundaries[1:] + fine.boundaries[:-1]),
                [fine.boundaries[-1] + 1.0],
            ]
        )
    else:
        middle = fine.origins
    coarse = np.searchsorted(axis.boundaries, middle, side="right")
    shift = fine.origins - axis.origins[coarse]
    pieces = np.moveaxis(coefficients.take(coarse, axis=cell_dim), (cell_dim, power_dim), (-2, -1))
    degree = pieces.shape[-1] - 1
    moved = np.zeros_like(pieces)
    for power in range(degree + 1):
        for higher in range(power, degree + 1):
            moved[..., power] += comb(higher, power) * pieces[..., higher] * shift ** (higher - power)
    return np.moveaxis(moved, (-2, -1), (cell_dim, power_dim))


def _padded(coefficients: Sequence[Array], power_dims: tuple[int, ...]) -> list[Array]:
    """Coefficient arrays filled up with zeros to the highest degree among them."""
    padded = []
    for array in coefficients:
        width = [(0, 0)] * array.ndim
        for dim in power_dims:
            width[dim] = (0, max(other.shape[dim] for other in coefficients) - array.shape[dim])
        padded.append(np.pad(array, width))
    return padded
