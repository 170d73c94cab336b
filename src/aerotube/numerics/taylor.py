"""Truncated multivariate Taylor polynomials, batched: forward arithmetic through NumPy code.

A polynomial in `variables` increments, up to a total degree `order`, is a row of coefficients in graded order.
Code written in plain NumPy runs on it unchanged: the result of each operation is the Taylor polynomial of that
operation, exact up to rounding in every coefficient kept.

Reference: A. Griewank, A. Walther, *Evaluating Derivatives*, 2nd ed., SIAM 2008, chapter 13.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerotube.numerics import taylor_functions as functions
from aerotube.numerics.taylor_kernels import Layout, compose, divide, multiply

Array = NDArray[np.float64]


class _Monomials(NamedTuple):
    """What every space of one size shares."""

    exponents: NDArray[np.int64]  # (size, variables)
    parents: NDArray[np.int64]  # (size,): the monomial that, times ``last``, gives this one
    last: NDArray[np.int64]  # (size,): a variable
    layout: Layout


@lru_cache(maxsize=32)
def _monomials(variables: int, order: int) -> _Monomials:
    members = [
        combination
        for degree in range(order + 1)
        for combination in combinations_with_replacement(range(variables), degree)
    ]
    index = {member: position for position, member in enumerate(members)}
    exponents = np.zeros((len(members), variables), dtype=np.int64)
    for row, member in enumerate(members):
        np.add.at(exponents[row], list(member), 1)
    degrees = exponents.sum(axis=1)
    up_to = np.searchsorted(degrees, np.arange(order + 1), side="right")
    lengths = up_to[order - degrees]
    starts = np.append(0, np.cumsum(lengths))[:-1]
    targets = np.empty(int(lengths.sum()), dtype=np.uint32)
    for row, member in enumerate(members):
        products = [index[tuple(sorted(member + other))] for other in members[: lengths[row]]]
        targets[starts[row] : starts[row] + lengths[row]] = products
    parents = np.array([index[member[:-1]] if member else 0 for member in members])
    last = np.array([member[-1] if member else 0 for member in members])
    return _Monomials(exponents, parents, last, Layout(degrees, up_to, starts, targets))


@dataclass(frozen=True)
class TaylorSpace:
    """Polynomials in some number of variables up to a total degree.

    Spaces of the same size are equal and share their tables.

    Parameters
    ----------
    variables : int
        At least 1.
    order : int
        Highest total degree kept, at least 0.

    Raises
    ------
    ValueError
        If there is no variable or the order is negative.
    """

    variables: int
    order: int

    def __post_init__(self) -> None:
        if self.variables < 1 or self.order < 0:
            raise ValueError(f"a Taylor space needs a variable and an order of at least 0, not {self}")

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return len(self.exponents)

    @property
    def exponents(self) -> NDArray[np.int64]:
        """Exponents of the monomials (size, variables): by total degree, the constant first, then x0, x1, ..."""
        return _monomials(self.variables, self.order).exponents

    @property
    def layout(self) -> Layout:
        """Index tables of the product."""
        return _monomials(self.variables, self.order).layout

    def variable(self, index: int, value: ArrayLike = 0.0) -> Taylor:
        """The variable `index` about a value (...)."""
        if not 0 <= index < self.variables:
            raise ValueError(f"there is no variable {index} among {self.variables}")
        made = self.constant(value)
        if self.order:
            made.coefficients[..., 1 + index] = 1.0
        return made

    def constant(self, value: ArrayLike) -> Taylor:
        """A constant (...)."""
        number = np.asarray(value, dtype=np.float64)
        coefficients = np.zeros((*number.shape, self.size))
        coefficients[..., 0] = number
        return Taylor(self, coefficients)

    def stack(self, components: Sequence[Any]) -> Array:
        """Coefficients (..., components, size) of several polynomials, floats or arrays, broadcast together."""
        rows = [x if isinstance(x, Taylor) else self.constant(x) for x in components]
        for row in rows:
            self._same(row.space)
        return np.stack(np.broadcast_arrays(*[row.coefficients for row in rows]), axis=-2)

    def monomials(self, points: ArrayLike) -> Array:
        """All monomials (..., size) at increments (..., variables)."""
        x = np.asarray(points, dtype=np.float64)
        if x.ndim == 0 or x.shape[-1] != self.variables:
            raise ValueError(f"points have shape {x.shape}; the last axis must have {self.variables} components")
        tables = _monomials(self.variables, self.order)
        values = np.ones((self.size, *x.shape[:-1]))
        by_variable = np.moveaxis(x, -1, 0)
        for row in range(1, self.size):
            np.multiply(values[tables.parents[row]], by_variable[tables.last[row]], out=values[row])
        return np.moveaxis(values, 0, -1)

    def _same(self, other: TaylorSpace) -> None:
        if self != other:
            raise ValueError(f"Taylor polynomials of different spaces do not mix: {self} and {other}")


class Taylor:
    """Taylor polynomials of one space, a batch of them.

    Parameters
    ----------
    space : TaylorSpace
    coefficients : array (..., space.size)

    Raises
    ------
    ValueError
        If the coefficients do not fit the space. Operations raise it where an expansion does not exist (division
        by zero, square root or logarithm of what is not positive, absolute value at zero, ...).
    """

    __slots__ = ("coefficients", "space")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, space: TaylorSpace, coefficients: ArrayLike) -> None:
        rows = np.asarray(coefficients, dtype=np.float64)
        if rows.ndim == 0 or rows.shape[-1] != space.size:
            raise ValueError(f"coefficients have shape {rows.shape}; the last axis must have {space.size} of {space}")
        self.space = space
        self.coefficients = rows

    def __repr__(self) -> str:
        return f"Taylor(variables={self.space.variables}, order={self.space.order}, shape={self.shape})"

    @property
    def shape(self) -> tuple[int, ...]:
        """Batch shape."""
        return self.coefficients.shape[:-1]

    @property
    def value(self) -> Any:
        """Constant terms (...)."""
        return self.coefficients[..., 0]

    @property
    def gradient(self) -> Array:
        """First derivatives (..., variables) at the point of expansion."""
        if self.space.order == 0:
            return np.zeros((*self.shape, self.space.variables))
        return self.coefficients[..., 1 : 1 + self.space.variables]

    def __call__(self, points: ArrayLike) -> Array:
        """Values (..., points) at increments (..., points, variables), batches broadcast against each other."""
        return np.einsum("...pk,...k->...p", self.space.monomials(points), self.coefficients, optimize=True)

    def truncate(self, order: int) -> Taylor:
        """The part up to a total degree, in the smaller space."""
        space = TaylorSpace(self.space.variables, order)
        if order > self.space.order:
            raise ValueError(f"a polynomial of order {self.space.order} cannot be truncated to order {order}")
        return Taylor(space, self.coefficients[..., : space.size])

    def compose(self, derivatives: ArrayLike) -> Taylor:
        """A function of one variable applied to the polynomials.

        Parameters
        ----------
        derivatives : array (..., order + 1)
            The function's k-th derivative at `value` over k!, for k = 0 .. order.
        """
        series = np.asarray(derivatives, dtype=np.float64)
        shape = np.broadcast_shapes(self.shape, series.shape[:-1])
        rows = _rows(self.coefficients, shape)
        result = np.zeros_like(rows)
        compose(rows, _rows(series, shape), self.space.layout, result)
        return Taylor(self.space, result.reshape(*shape, -1))

    def _apply(self, series: functions.Series) -> Taylor:
        return self.compose(np.stack(series(np.asarray(self.value), self.space.order), axis=-1))

    def _other(self, other: Any) -> Taylor | Array | None:
        if isinstance(other, Taylor):
            self.space._same(other.space)
            return other
        try:
            number = np.asarray(other, dtype=np.float64)
        except (TypeError, ValueError):
            return None
        return number

    def _shifted(self, number: Array) -> Taylor:
        shape = np.broadcast_shapes(self.shape, number.shape)
        coefficients = np.broadcast_to(self.coefficients, (*shape, self.space.size)).copy()
        coefficients[..., 0] += number
        return Taylor(self.space, coefficients)

    def __neg__(self) -> Taylor:
        return Taylor(self.space, -self.coefficients)

    def __pos__(self) -> Taylor:
        return self

    def __abs__(self) -> Taylor:
        functions.require(self.value != 0.0, "the absolute value of a Taylor polynomial", "a value that is not zero")
        return self * np.sign(self.value)

    def __add__(self, other: Any) -> Taylor:
        right = self._other(other)
        if right is None:
            return NotImplemented
        if isinstance(right, Taylor):
            return Taylor(self.space, self.coefficients + right.coefficients)
        return self._shifted(right)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Taylor:
        right = self._other(other)
        if right is None:
            return NotImplemented
        if isinstance(right, Taylor):
            return Taylor(self.space, self.coefficients - right.coefficients)
        return self._shifted(-right)

    def __rsub__(self, other: Any) -> Taylor:
        left = self._other(other)
        return NotImplemented if left is None else -self + left

    def __mul__(self, other: Any) -> Taylor:
        right = self._other(other)
        if right is None:
            return NotImplemented
        if isinstance(right, Taylor):
            return self._kernel(multiply, right)
        return Taylor(self.space, self.coefficients * right[..., None])

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Taylor:
        right = self._other(other)
        if right is None:
            return NotImplemented
        if isinstance(right, Taylor):
            functions.require(right.value != 0.0, "division by a Taylor polynomial", "a value that is not zero")
            return self._kernel(divide, right)
        functions.require(right != 0.0, "division of a Taylor polynomial", "a divisor that is not zero")
        return Taylor(self.space, self.coefficients / right[..., None])

    def __rtruediv__(self, other: Any) -> Taylor:
        left = self._other(other)
        if left is None:
            return NotImplemented
        return self._apply(functions.reciprocal) * left

    def __pow__(self, other: Any) -> Taylor:
        if isinstance(other, Taylor):
            return (self._apply(functions.log) * other)._apply(functions.exp)
        exponent = np.asarray(other, dtype=np.float64)
        if exponent.ndim == 0 and exponent == np.rint(exponent) and 0 <= exponent <= 64:
            return self._whole_power(int(exponent))
        return self._apply(functions.power(exponent))

    def __rpow__(self, other: Any) -> Taylor:
        base = np.asarray(other, dtype=np.float64)
        functions.require(base > 0.0, "a power with a Taylor polynomial as its exponent", "a positive base")
        return (self * np.log(base))._apply(functions.exp)

    def _whole_power(self, exponent: int) -> Taylor:
        if exponent == 0:
            return self.space.constant(np.ones(self.shape))
        result, square = None, self
        while True:
            if exponent & 1:
                result = square if result is None else result * square
            exponent >>= 1
            if not exponent:
                assert result is not None
                return result
            square = square * square

    def _kernel(self, kernel: Any, other: Taylor) -> Taylor:
        shape = np.broadcast_shapes(self.shape, other.shape)
        left, right = _rows(self.coefficients, shape), _rows(other.coefficients, shape)
        result = np.zeros_like(left)
        kernel(left, right, self.space.layout, result)
        return Taylor(self.space, result.reshape(*shape, -1))

    def __lt__(self, other: Any) -> Any:
        return self.value < _value(other)

    def __le__(self, other: Any) -> Any:
        return self.value <= _value(other)

    def __gt__(self, other: Any) -> Any:
        return self.value > _value(other)

    def __ge__(self, other: Any) -> Any:
        return self.value >= _value(other)

    def __eq__(self, other: Any) -> Any:
        return self.value == _value(other)

    def __ne__(self, other: Any) -> Any:
        return self.value != _value(other)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if method != "__call__" or options or ufunc not in _UFUNCS:
            return NotImplemented
        return _UFUNCS[ufunc](*inputs)


def choose(condition: ArrayLike, if_true: Any, if_false: Any) -> Taylor:
    """The first polynomials where a condition (...) holds, the second elsewhere; one of them may be numbers."""
    space = if_true.space if isinstance(if_true, Taylor) else if_false.space
    first, second = (x if isinstance(x, Taylor) else space.constant(x) for x in (if_true, if_false))
    space._same(first.space)
    space._same(second.space)
    where = np.asarray(condition)[..., None]
    return Taylor(space, np.where(where, first.coefficients, second.coefficients))


def _rows(coefficients: Array, shape: tuple[int, ...]) -> Array:
    """Coefficients broadcast to a batch shape, contiguous, as (batch, size)."""
    if coefficients.shape[:-1] != shape:
        coefficients = np.broadcast_to(coefficients, (*shape, coefficients.shape[-1]))
    return np.ascontiguousarray(coefficients).reshape(-1, coefficients.shape[-1])


def _value(x: Any) -> Any:
    return x.value if isinstance(x, Taylor) else x


def _arctan2(y: Any, x: Any) -> Taylor:
    """Angle of (x, y), expanded about the direction of the values, so that it is regular all around."""
    y0, x0 = np.asarray(_value(y)), np.asarray(_value(x))
    square = x0 * x0 + y0 * y0
    functions.require(square > 0.0, "the angle of a point given by Taylor polynomials", "a point off the origin")
    ahead, across = (x * x0 + y * y0) / square, (y * x0 - x * y0) / square
    return (across / ahead)._apply(functions.arctan) + np.arctan2(y0, x0)


def _unary(series: functions.Series) -> Any:
    return lambda x: x._apply(series)


_UFUNCS: dict[np.ufunc, Any] = {
    np.add: lambda a, b: b + a if isinstance(b, Taylor) else a + b,
    np.subtract: lambda a, b: a - b if isinstance(a, Taylor) else b.__rsub__(a),
    np.multiply: lambda a, b: b * a if isinstance(b, Taylor) else a * b,
    np.divide: lambda a, b: a / b if isinstance(a, Taylor) else b.__rtruediv__(a),
    np.power: lambda a, b: a**b if isinstance(a, Taylor) else b.__rpow__(a),
    np.float_power: lambda a, b: a**b if isinstance(a, Taylor) else b.__rpow__(a),
    np.arctan2: _arctan2,
    np.hypot: lambda a, b: (a * a + b * b)._apply(functions.sqrt),
    np.maximum: lambda a, b: choose(_value(a) >= _value(b), a, b),
    np.minimum: lambda a, b: choose(_value(a) <= _value(b), a, b),
    np.negative: lambda a: -a,
    np.positive: lambda a: a,
    np.absolute: abs,
    np.fabs: abs,
    np.square: lambda a: a * a,
    np.deg2rad: lambda a: a * (np.pi / 180.0),
    np.radians: lambda a: a * (np.pi / 180.0),
    np.rad2deg: lambda a: a * (180.0 / np.pi),
    np.degrees: lambda a: a * (180.0 / np.pi),
    np.sign: lambda a: np.sign(a.value),
    np.rint: lambda a: np.rint(a.value),
    np.floor: lambda a: np.floor(a.value),
    np.isfinite: lambda a: np.isfinite(a.coefficients).all(axis=-1),
    np.less: lambda a, b: _value(a) < _value(b),
    np.less_equal: lambda a, b: _value(a) <= _value(b),
    np.greater: lambda a, b: _value(a) > _value(b),
    np.greater_equal: lambda a, b: _value(a) >= _value(b),
    np.equal: lambda a, b: _value(a) == _value(b),
    np.not_equal: lambda a, b: _value(a) != _value(b),
    np.reciprocal: _unary(functions.reciprocal),
    np.sqrt: _unary(functions.sqrt),
    np.exp: _unary(functions.exp),
    np.log: _unary(functions.log),
    np.sin: _unary(functions.sin),
    np.cos: _unary(functions.cos),
    np.tan: _unary(functions.tan),
    np.arcsin: _unary(functions.arcsin),
    np.arccos: _unary(functions.arccos),
    np.arctan: _unary(functions.arctan),
    np.sinh: _unary(functions.sinh),
    np.cosh: _unary(functions.cosh),
    np.tanh: _unary(functions.tanh),
}
