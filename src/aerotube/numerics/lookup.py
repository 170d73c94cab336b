"""Reading tables: with floats, arrays, Taylor polynomials and Taylor models, and inside compiled code."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba.core import types
from numba.extending import overload
from numpy.typing import NDArray

from aerotube.numerics.table_enclosures import enclose1, enclose2
from aerotube.numerics.table_kernels import evaluate1, evaluate2, expand1, expand2, locate1, locate2, value1, value2
from aerotube.numerics.tables import Table1, Table2
from aerotube.numerics.taylor import Taylor
from aerotube.numerics.taylor_model import TaylorModel

Array = NDArray[np.float64]


def lookup1(table: Table1, x: Any) -> Any:
    """Values of all outputs of a table.

    Parameters
    ----------
    table : Table1
    x : float, array (...), Taylor or TaylorModel

    Returns
    -------
    array (outputs, ...), or for a Taylor or TaylorModel argument a tuple of them, one an output
        A Taylor polynomial is that of the cell which holds its value; on the edge of two cells, of the upper one.
    """
    if isinstance(x, Taylor):
        return _expand1(table, x)
    if isinstance(x, TaylorModel):
        return enclose1(table, x)
    points = np.asarray(x, dtype=np.float64)
    values = np.empty((table.outputs, points.size))
    evaluate1(table, _flat(points), values)
    return values.reshape(values.shape[:1] + points.shape)


def lookup2(table: Table2, x: Any, y: Any) -> Any:
    """Values of all outputs of a table.

    Parameters
    ----------
    table : Table2
    x, y : float, array (...), Taylor or TaylorModel
        Broadcast against each other.

    Returns
    -------
    array (outputs, ...), or if an argument is a Taylor or TaylorModel a tuple of them, one an output
        A Taylor polynomial is that of the cell which holds its value; on the edge of two cells, of the upper one.
    """
    if isinstance(x, Taylor) or isinstance(y, Taylor):
        return _expand2(table, x, y)
    if isinstance(x, TaylorModel) or isinstance(y, TaylorModel):
        return enclose2(table, x, y)
    first, second = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
    values = np.empty((table.outputs, first.size))
    evaluate2(table, _flat(first), _flat(second), values)
    return values.reshape(values.shape[:1] + first.shape)


def entry(values: Any, output: int) -> Any:
    """One output of what `lookup1` or `lookup2` gives; in compiled code it is read only here."""
    return values[output]


class Cell1(NamedTuple):
    """What `lookup1` gives in compiled code: where to read, and nothing that would have to be allocated."""

    data: Array
    start: int
    powers: int
    x: float


class Cell2(NamedTuple):
    """The same of `lookup2`."""

    data: Array
    start: int
    powers_x: int
    powers_y: int
    x: float
    y: float


@overload(lookup1)
def _lookup1_compiled(table: Any, x: Any) -> Any:
    def lookup(table: Any, x: Any) -> Any:
        start, local = locate1(table, x)
        return Cell1(table.data, start, table.powers, local)

    return lookup


@overload(lookup2)
def _lookup2_compiled(table: Any, x: Any, y: Any) -> Any:
    def lookup(table: Any, x: Any, y: Any) -> Any:
        start, local_x, local_y = locate2(table, x, y)
        return Cell2(table.data, start, table.powers_x, table.powers_y, local_x, local_y)

    return lookup


@overload(entry)
def _entry_compiled(values: Any, output: Any) -> Any:
    if not isinstance(values, types.NamedTuple):
        return None
    if values.instance_class is Cell1:

        def read(values: Any, output: Any) -> Any:
            return value1(values.data, values.start, values.powers, output, values.x)

        return read
    if values.instance_class is Cell2:

        def read_plane(values: Any, output: Any) -> Any:
            return value2(values.data, values.start, values.powers_x, values.powers_y, output, values.x, values.y)

        return read_plane
    return None


def _flat(points: Array) -> Array:
    return np.ascontiguousarray(points).reshape(-1)


def _expand1(table: Table1, x: Taylor) -> tuple[Taylor, ...]:
    points, order = np.asarray(x.value), x.space.order
    series = np.empty((points.size, table.outputs, order + 1))
    expand1(table, _flat(points), series)
    series = series.reshape(*points.shape, *series.shape[1:])
    powers = [x.space.constant(np.ones(points.shape)), x - points]
    while len(powers) <= order:
        powers.append(powers[-1] * powers[1])
    return _combine(series, powers[: order + 1])


def _expand2(table: Table2, x: Any, y: Any) -> tuple[Taylor, ...]:
    space = x.space if isinstance(x, Taylor) else y.space
    first, second = (z if isinstance(z, Taylor) else space.constant(z) for z in (x, y))
    at_x, at_y = np.broadcast_arrays(first.value, second.value)
    order = space.order
    series = np.empty((at_x.size, table.outputs, order + 1, order + 1))
    expand2(table, _flat(at_x), _flat(at_y), series)
    series = series.reshape(*at_x.shape, *series.shape[1:])

    along_x, along_y = first - first.value, second - second.value
    powers = {(0, 0): space.constant(np.ones(at_x.shape))}
    for degree in range(1, order + 1):
        for i in range(degree + 1):
            j = degree - i
            powers[i, j] = powers[i, j - 1] * along_y if j else powers[i - 1, j] * along_x
    chosen = np.stack([series[..., i, j] for i, j in powers], axis=-1)
    return _combine(chosen, list(powers.values()))


def _combine(series: Array, powers: list[Taylor]) -> tuple[Taylor, ...]:
    """Polynomials with the coefficients series (..., outputs, terms) in the given terms."""
    space = powers[0].space
    terms = space.stack(powers)
    values = np.matmul(series, terms)
    return tuple(Taylor(space, np.ascontiguousarray(values[..., output, :])) for output in range(values.shape[-2]))
