"""Taylor models: a polynomial and a rigorous bound of what it leaves out, batched.

A Taylor model of a function f over a domain D is a polynomial P and a remainder r with ``|f(z) - P(z)| <= r`` for all
z in D. Code written in plain NumPy runs on models unchanged and gives a model of its result: the polynomial part is
that of `aerotube.numerics.Taylor` up to rounding, and the remainder covers truncation, rounding and the remainders of
the arguments.

The domain is a product of unit balls, of which an interval [-1, 1] is the one-dimensional case; a box is as many
intervals. On a ball, the part p of one degree d of a polynomial obeys ``|p(z)|**2 <= sum of c**2 / multinomial(e)``
over its coefficients c and exponents e (p is a symmetric tensor applied to d copies of z; Cauchy and Schwarz), exactly
for d = 1, and this norm of a product is at most the product of the norms (B. Beauzamy, E. Bombieri, P. Enflo, H. L.
Montgomery, "Products of polynomials in many variables", J. Number Theory 36, 1990). What a product leaves out is so
bounded without being computed.

Functions of one variable are expanded to the order of the space; the next coefficient, enclosed over the whole range
of the argument, bounds the rest (Lagrange).

Reference: K. Makino, M. Berz, "Taylor models and other validated functional inclusion methods", Int. J. Pure Appl.
Math. 4, 2003.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import factorial, prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerotube.numerics import model_kernels as kernels
from aerotube.numerics import series_kernels
from aerotube.numerics import taylor_functions as functions
from aerotube.numerics.interval import Interval
from aerotube.numerics.taylor import Taylor, TaylorSpace
from aerotube.numerics.truth import Truth, truth_of

Array = NDArray[np.float64]

SLACK = kernels.SLACK
UFUNCS: dict[np.ufunc, Any] = {}  # filled in by `model_functions`


@lru_cache(maxsize=32)
def _layout(balls: tuple[int, ...], order: int) -> kernels.ModelLayout:
    space = TaylorSpace(sum(balls), order)
    plain, exponents = space.layout, space.exponents
    ball_of = np.repeat(np.arange(len(balls)), balls)
    in_balls = np.stack([exponents[:, ball_of == ball].sum(axis=1) for ball in range(len(balls))], axis=1)
    kinds, classes = np.unique(in_balls, axis=0, return_inverse=True)
    factorials = np.array([factorial(k) for k in range(order + 1)], dtype=np.float64)
    weights = factorials[exponents].prod(axis=1) / factorials[in_balls].prod(axis=1)
    # a weight that is not a binary fraction errs by an ulp, which the kernels' slack covers
    lengths = plain.up_to[order - plain.degrees]
    return kernels.ModelLayout(
        plain.up_to, lengths, plain.starts, plain.targets, weights, classes.reshape(-1), kinds.sum(axis=1)
    )


@dataclass(frozen=True)
class ModelSpace:
    """Taylor models of one order over one domain.

    Parameters
    ----------
    balls : tuple of int
        The domain: the product of unit balls of these dimensions, over as many consecutive variables each. All ones
        is the box [-1, 1]^n.
    order : int
        Total degree of the polynomial part, at least 1.

    Raises
    ------
    ValueError
        If there is no variable, a dimension is not positive, or the order is less than 1.
    """

    balls: tuple[int, ...]
    order: int

    def __post_init__(self) -> None:
        if not self.balls or min(self.balls) < 1 or self.order < 1:
            raise ValueError(f"a space of Taylor models needs balls of positive dimension and an order, not {self}")

    @property
    def taylor(self) -> TaylorSpace:
        """The space of the polynomial parts."""
        return TaylorSpace(sum(self.balls), self.order)

    @property
    def layout(self) -> kernels.ModelLayout:
        """Index tables of the product and weights of the norms."""
        return _layout(self.balls, self.order)

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return len(self.layout.weights)

    def constant(self, value: ArrayLike, radius: ArrayLike = 0.0) -> TaylorModel:
        """A constant (...), known up to a radius (...)."""
        return self.affine(value, (), radius)

    def variable(self, index: int, middle: ArrayLike = 0.0, reach: ArrayLike = 1.0) -> TaylorModel:
        """``middle + reach * z[index]``; middle and reach (...)."""
        if not 0 <= index < sum(self.balls):
            raise ValueError(f"there is no variable {index} among {sum(self.balls)}")
        row = np.zeros((*np.shape(reach), sum(self.balls)))
        row[..., index] = reach
        return self.affine(middle, row)

    def affine(self, constant: ArrayLike, gradient: ArrayLike, radius: ArrayLike = 0.0) -> TaylorModel:
        """``constant + gradient . z``, constant (...), gradient (..., variables), known up to a radius (...)."""
        middle, slope = np.asarray(constant, dtype=np.float64), np.asarray(gradient, dtype=np.float64)
        given = slope.shape[-1]
        shape = np.broadcast_shapes(middle.shape, slope.shape[:-1], np.shape(radius))
        coefficients = np.zeros((*shape, self.size))
        coefficients[..., 0] = middle
        coefficients[..., 1 : 1 + given] = slope
        return self.model(coefficients, radius)

    def model(self, coefficients: ArrayLike, remainder: ArrayLike = 0.0) -> TaylorModel:
        """The polynomial with coefficients (..., size), in graded order, and a remainder (...)."""
        given, rest = np.asarray(coefficients, dtype=np.float64), np.asarray(remainder, dtype=np.float64)
        if given.ndim == 0 or given.shape[-1] != self.size:
            raise ValueError(f"coefficients have shape {given.shape}; the last axis must have {self.size} of {self}")
        if not (rest >= 0.0).all():
            raise ValueError("the remainder of a Taylor model must be a number and not negative")
        shape = np.broadcast_shapes(given.shape[:-1], rest.shape)
        data = np.zeros((*shape, self.size + self.order + 2))
        data[..., : self.size] = given
        data[..., -1] = rest
        for row in data.reshape(-1, data.shape[-1]):
            kernels.set_norms(row, self.layout)
        return TaylorModel(self, data)


class TaylorModel:
    """Taylor models of one space, a batch of them. Made by the space.

    Comparisons give a `Truth`; `aerotube.numerics.select` and ``np.where`` take it, and where it is undecided enclose
    both branches.

    Raises
    ------
    ValueError
        By operations that are not defined at all points of the domain.
    """

    __slots__ = ("data", "space")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, space: ModelSpace, data: Array) -> None:
        self.space = space
        self.data = data

    def __repr__(self) -> str:
        return f"TaylorModel(balls={self.space.balls}, order={self.space.order}, shape={self.shape})"

    @property
    def shape(self) -> tuple[int, ...]:
        """Batch shape."""
        return self.data.shape[:-1]

    @property
    def coefficients(self) -> Array:
        """Of the polynomial part, (..., size)."""
        return self.data[..., : self.space.size]

    @property
    def polynomial(self) -> Taylor:
        """The polynomial part."""
        return Taylor(self.space.taylor, self.coefficients)

    @property
    def value(self) -> Array:
        """The polynomial part at the centre of the domain, (...)."""
        return self.data[..., 0]

    @property
    def norms(self) -> Array:
        """Bounds of the absolute value of the polynomial's part of each degree, (..., order + 1)."""
        return self.data[..., self.space.size : -1]

    @property
    def remainder(self) -> Array:
        """Bound of the absolute value of what the polynomial leaves out, (...)."""
        return self.data[..., -1]

    @property
    def reach(self) -> Array:
        """How far from `value` the function gets, at most, (...)."""
        return np.asarray(self.data[..., self.space.size + 1 :].sum(axis=-1) * SLACK)

    @property
    def bounds(self) -> Interval:
        """Enclosure of the function over the domain, (...)."""
        middle, reach = self.value, self.reach
        return Interval(np.nextafter(middle - reach, -np.inf), np.nextafter(middle + reach, np.inf))

    def compose(self, series: Callable[[Any, int], list[Any]]) -> TaylorModel:
        """A function of one variable applied to the models.

        Parameters
        ----------
        series : callable
            From intervals and an order to enclosures of the function's k-th derivatives over k!, k = 0 .. order.
        """
        order, middle, bounds = self.space.order, self.value, self.bounds
        both = Interval(np.stack([middle, bounds.lower]), np.stack([middle, bounds.upper]))
        found = [_as_interval(term) for term in series(both, order + 1)]
        known = found[: order + 1]
        terms = Interval(
            np.stack([term.lower[0] for term in known], axis=-1), np.stack([term.upper[0] for term in known], axis=-1)
        )
        powers = self.reach[..., None] ** np.arange(order + 2)
        extra = found[-1][1].magnitude * powers[..., -1] + (terms.radius * powers[..., :-1]).sum(axis=-1)
        return self.expand(terms.middle, extra * SLACK)

    def function(self, name: str, exponent: float = 0.0) -> TaylorModel:
        """One of `FUNCTIONS` applied to the models, compiled; `exponent` is that of a power."""
        kind, needed = FUNCTIONS[name]
        bounds, middle = self.bounds, self.value.reshape(-1)
        series, extra = np.empty((middle.size, self.space.order + 1)), np.empty(middle.size)
        reach, low, high = (part.reshape(-1) for part in (self.reach, bounds.lower, bounds.upper))
        failed = series_kernels.expand_rows(kind, exponent, middle, reach, low, high, series, extra)
        if failed >= 0:
            where = ", ".join(str(i) for i in np.unravel_index(failed, self.shape))
            raise ValueError(
                f"the {name} of a Taylor model needs {needed} throughout its range"
                + (f" (batch index {where})" if where else "")
            )
        return self.expand(series.reshape(*self.shape, -1), extra.reshape(self.shape))

    def expand(self, series: Array, extra: Array) -> TaylorModel:
        """``sum of series[..., k] * (model - value)**k``, known up to `extra` (...)."""
        shape = np.broadcast_shapes(self.shape, series.shape[:-1])
        rows = _rows(self.data, shape)
        out = np.empty_like(rows)
        terms = np.ascontiguousarray(np.broadcast_to(series, (*shape, series.shape[-1])))
        kernels.compose_rows(rows, terms.reshape(-1, series.shape[-1]), _numbers(extra, shape), self.space.layout, out)
        return TaylorModel(self.space, out.reshape(*shape, -1))

    def _operand(self, other: Any) -> TaylorModel | Array | None:
        if isinstance(other, TaylorModel):
            if other.space != self.space:
                raise ValueError(f"Taylor models of different spaces do not mix: {self.space} and {other.space}")
            return other
        if isinstance(other, (Taylor, Interval)):
            return None
        try:
            return np.asarray(other, dtype=np.float64)
        except (TypeError, ValueError):
            return None

    def shifted(self, number: ArrayLike, radius: ArrayLike = 0.0) -> TaylorModel:
        """The models plus a number (...) known up to a radius (...)."""
        shape = np.broadcast_shapes(self.shape, np.shape(number), np.shape(radius))
        rows = _rows(self.data, shape)
        out = np.empty_like(rows)
        kernels.shift_rows(rows, _numbers(number, shape), _numbers(radius, shape), self.space.size, out)
        return TaylorModel(self.space, out.reshape(*shape, -1))

    def _added(self, other: TaylorModel, sign: float) -> TaylorModel:
        left, right, shape = _pair(self.data, other.data)
        out = np.empty_like(left)
        kernels.add_rows(left, right, sign, self.space.layout, out)
        return TaylorModel(self.space, out.reshape(shape))

    def _scaled(self, number: Array) -> TaylorModel:
        shape = np.broadcast_shapes(self.shape, number.shape)
        rows = _rows(self.data, shape)
        out = np.empty_like(rows)
        kernels.scale_rows(rows, _numbers(number, shape), self.space.layout, out)
        return TaylorModel(self.space, out.reshape(*shape, -1))

    def __neg__(self) -> TaylorModel:
        data = self.data.copy()
        data[..., : self.space.size] *= -1.0
        return TaylorModel(self.space, data)

    def __pos__(self) -> TaylorModel:
        return self

    def __abs__(self) -> TaylorModel:
        return UFUNCS[np.absolute](self)

    def __add__(self, other: Any) -> TaylorModel:
        right = self._operand(other)
        if right is None:
            return NotImplemented
        return self._added(right, 1.0) if isinstance(right, TaylorModel) else self.shifted(right)

    __radd__ = __add__

    def __sub__(self, other: Any) -> TaylorModel:
        right = self._operand(other)
        if right is None:
            return NotImplemented
        return self._added(right, -1.0) if isinstance(right, TaylorModel) else self.shifted(-right)

    def __rsub__(self, other: Any) -> TaylorModel:
        left = self._operand(other)
        return NotImplemented if left is None else -self + left

    def __mul__(self, other: Any) -> TaylorModel:
        right = self._operand(other)
        if right is None:
            return NotImplemented
        if not isinstance(right, TaylorModel):
            return self._scaled(right)
        first, second, shape = _pair(self.data, right.data)
        out = np.empty_like(first)
        kernels.multiply_rows(first, second, self.space.layout, out)
        return TaylorModel(self.space, out.reshape(shape))

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> TaylorModel:
        right = self._operand(other)
        if right is None:
            return NotImplemented
        if isinstance(right, TaylorModel):
            return self * right.function("reciprocal")
        functions.require(right != 0.0, "division of a Taylor model", "a divisor that is not zero")
        return self * enclosed(self.space, 1.0 / Interval(right))

    def __rtruediv__(self, other: Any) -> TaylorModel:
        left = self._operand(other)
        return NotImplemented if left is None else self.function("reciprocal") * left

    def __pow__(self, other: Any) -> TaylorModel:
        if isinstance(other, TaylorModel):
            return (self.function("logarithm") * other).function("exponential")
        exponent = np.asarray(other, dtype=np.float64)
        if exponent.ndim == 0 and exponent == np.rint(exponent) and 1 <= exponent <= 64:
            whole = int(exponent)
            half = self ** (whole // 2) if whole > 1 else None
            if half is None:
                return self
            return half * half * self if whole % 2 else half * half
        if exponent.ndim == 0 and exponent != np.rint(exponent):
            return self.function("power", float(exponent))
        return self.compose(_power(exponent))

    def __rpow__(self, other: Any) -> TaylorModel:
        base: Any = Interval(np.asarray(other, dtype=np.float64))
        logarithm = np.log(base)
        return (self * enclosed(self.space, logarithm)).function("exponential")

    def __lt__(self, other: Any) -> Truth:
        return _compare(self, other, lambda x: x < 0.0, lambda x: x >= 0.0)

    def __le__(self, other: Any) -> Truth:
        return _compare(self, other, lambda x: x <= 0.0, lambda x: x > 0.0)

    def __gt__(self, other: Any) -> Truth:
        return ~(self <= other)

    def __ge__(self, other: Any) -> Truth:
        return ~(self < other)

    def __eq__(self, other: Any) -> Any:
        return (self <= other) & (self >= other)

    def __ne__(self, other: Any) -> Any:
        return ~(self == other)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if method != "__call__" or options or ufunc not in UFUNCS:
            return NotImplemented
        return UFUNCS[ufunc](*inputs)

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        if function is np.where and len(args) == 3 and not kwargs:
            return choose(*args)
        if function is np.zeros_like and len(args) == 1 and not kwargs:
            return np.zeros(self.shape)
        return NotImplemented


FUNCTIONS = {
    "reciprocal": (series_kernels.RECIPROCAL, "what is not zero"),
    "square root": (series_kernels.SQRT, "what is positive"),
    "power": (series_kernels.POWER, "what is positive"),
    "exponential": (series_kernels.EXP, "numbers"),
    "logarithm": (series_kernels.LOG, "what is positive"),
    "sine": (series_kernels.SIN, "numbers"),
    "cosine": (series_kernels.COS, "numbers"),
    "arc tangent": (series_kernels.ARCTAN, "numbers"),
    "arc sine": (series_kernels.ARCSIN, "what is between -1 and 1"),
}


def choose(condition: Any, if_true: Any, if_false: Any) -> TaylorModel:
    """The first models where a condition (...) holds, the second elsewhere; one of them may be numbers.

    Where a `Truth` is undecided: the branch that holds at the centre of the domain, its remainder enlarged to as much
    as the other may differ from its polynomial.
    """
    truth = truth_of(condition)
    space = next(x.space for x in (if_true, if_false) if isinstance(x, TaylorModel))
    first, second = (x if isinstance(x, TaylorModel) else space.constant(x) for x in (if_true, if_false))
    data = np.where(truth.central[..., None], first.data, second.data)
    undecided = truth.possible & ~truth.certain
    if undecided.any():
        gap = second - first
        apart = np.abs(gap.value) + gap.reach
        other = np.maximum(np.maximum(first.remainder, second.remainder), apart) * SLACK
        data[..., -1] = np.where(undecided, other, data[..., -1])
    return TaylorModel(space, data)


def combine(terms: Sequence[TaylorModel], series: Array, extra: Array) -> tuple[TaylorModel, ...]:
    """Models ``sum over t of series[..., output, t] * terms[t]``, each known up to ``extra[..., output]``."""
    space, shape = terms[0].space, np.broadcast_shapes(*(term.shape for term in terms))
    outputs = series.shape[-2]
    rows = np.stack([_rows(term.data, shape) for term in terms])
    out = np.empty((outputs, *rows.shape[1:]))
    factors = np.ascontiguousarray(series).reshape(-1, *series.shape[-2:])
    kernels.combine_rows(rows, factors, extra.reshape(-1, outputs), space.layout, out)
    return tuple(TaylorModel(space, row.reshape(*shape, -1)) for row in out)


def _compare(left: Any, right: Any, holds: Any, fails: Any) -> Truth:
    gap = left - right
    bounds = gap.bounds
    certain, possible = np.asarray(holds(bounds)), ~np.asarray(fails(bounds))
    return Truth(certain, possible, (np.asarray(holds(gap.value)) | certain) & possible)


def _pair(left: Array, right: Array) -> tuple[Array, Array, tuple[int, ...]]:
    """Rows of two models, and the shape of their broadcast data."""
    if left.ndim == 2 and left.shape == right.shape:
        return left, right, left.shape
    shape = np.broadcast_shapes(left.shape[:-1], right.shape[:-1])
    return _rows(left, shape), _rows(right, shape), (*shape, left.shape[-1])


def _rows(data: Array, shape: tuple[int, ...]) -> Array:
    if data.shape[:-1] != shape:
        data = np.broadcast_to(data, (*shape, data.shape[-1]))
    elif data.ndim == 2:
        return data
    return np.ascontiguousarray(data).reshape(prod(shape), data.shape[-1])


def _numbers(values: ArrayLike, shape: tuple[int, ...]) -> Array:
    numbers = np.asarray(values, dtype=np.float64)
    if numbers.ndim == 0:
        return np.full(prod(shape), numbers)
    if numbers.shape != shape:
        numbers = np.broadcast_to(numbers, shape)
    return np.ascontiguousarray(numbers).reshape(-1)


def _as_interval(x: Any) -> Interval:
    return x if isinstance(x, Interval) else Interval(x)


def enclosed(space: ModelSpace, interval: Interval) -> TaylorModel:
    """A constant known to lie in an interval (...)."""
    return space.constant(interval.middle, interval.radius)


def _power(exponent: Array) -> Callable[[Any, int], list[Any]]:
    def series(x: Interval, order: int) -> list[Any]:
        terms: list[Any] = [x**exponent]
        for k in range(1, order + 1):
            terms.append(terms[-1] * (Interval(exponent) - (k - 1.0)) / (float(k) * x))
        return terms

    return series
