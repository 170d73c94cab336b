"""Interval arithmetic with outward rounding, over arrays.

An interval is two arrays, lower and upper; the result of every operation holds the exact result for all numbers in
its arguments. What is assumed of the machine: IEEE 754 double precision, rounding to nearest, so that sums, products,
quotients and square roots are widened by one unit in the last place; and that the elementary functions of NumPy and
of the C library (exp, log, sin, ..., pow) err by at most `LIBRARY_ULPS` units in the last place, by which their values
are widened. Sine and cosine of arguments beyond 1e6 are taken as [-1, 1].

Reference: W. Tucker, *Validated Numerics*, Princeton University Press 2011, chapters 2 and 3.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

LIBRARY_ULPS = 4.0

_WIDENING = LIBRARY_ULPS * 1.01 * 2.0**-52
_LEAST = 2.0**-1070
_FARTHEST_ANGLE = 1e6


class Interval:
    """Intervals ``[lower, upper]``, a batch of them.

    Runs through code written in plain NumPy. Comparisons are true where they hold for all numbers in both sides.

    Parameters
    ----------
    lower : float or array (...)
    upper : float or array (...), optional
        The same as `lower` if not given.

    Raises
    ------
    ValueError
        If a lower end is above an upper one, or an end is not a number. Operations raise it where they are not
        defined throughout their arguments (division by zero, root or logarithm of what may be negative, ...).
    """

    __slots__ = ("lower", "upper")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, lower: ArrayLike, upper: ArrayLike | None = None) -> None:
        self.lower = np.asarray(lower, dtype=np.float64)
        self.upper = self.lower if upper is None else np.asarray(upper, dtype=np.float64)
        if not (self.lower <= self.upper).all():
            raise ValueError("the ends of an interval must be numbers, the lower one not above the upper one")

    def __repr__(self) -> str:
        return f"Interval({self.lower!r}, {self.upper!r})"

    def __getitem__(self, key: Any) -> Interval:
        return Interval(self.lower[key], self.upper[key])

    @property
    def shape(self) -> tuple[int, ...]:
        """Batch shape."""
        return np.broadcast_shapes(self.lower.shape, self.upper.shape)

    @property
    def middle(self) -> Array:
        """A number near the middle, (...)."""
        return np.asarray(0.5 * self.lower + 0.5 * self.upper)

    @property
    def radius(self) -> Array:
        """How far, at most, any number of the interval is from `middle`, (...)."""
        middle = self.middle
        return np.nextafter(np.maximum(middle - self.lower, self.upper - middle), np.inf)

    @property
    def magnitude(self) -> Array:
        """Largest absolute value, (...)."""
        return np.maximum(np.abs(self.lower), np.abs(self.upper))

    def holds(self, values: ArrayLike) -> NDArray[np.bool_]:
        """Whether the intervals hold values (...)."""
        x = np.asarray(values, dtype=np.float64)
        return np.asarray((self.lower <= x) & (x <= self.upper))

    def __neg__(self) -> Interval:
        return _made(-self.upper, -self.lower)

    def __pos__(self) -> Interval:
        return self

    def __abs__(self) -> Interval:
        across = (self.lower < 0.0) & (self.upper > 0.0)
        least = np.minimum(np.abs(self.lower), np.abs(self.upper))
        return Interval(np.where(across, 0.0, least), self.magnitude)

    def __add__(self, other: Any) -> Interval:
        right = _interval(other)
        return NotImplemented if right is None else _rounded(self.lower + right.lower, self.upper + right.upper)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Interval:
        right = _interval(other)
        return NotImplemented if right is None else _rounded(self.lower - right.upper, self.upper - right.lower)

    def __rsub__(self, other: Any) -> Interval:
        left = _interval(other)
        return NotImplemented if left is None else left - self

    def __mul__(self, other: Any) -> Interval:
        if other is self:
            return _square(self)
        right = _interval(other)
        if right is None:
            return NotImplemented
        if right.lower is right.upper:
            a, b = self.lower * right.lower, self.upper * right.lower
            return _rounded(np.minimum(a, b), np.maximum(a, b))
        a, b = self.lower * right.lower, self.lower * right.upper
        c, d = self.upper * right.lower, self.upper * right.upper
        return _rounded(
            np.minimum(np.minimum(a, b), np.minimum(c, d)),
            np.maximum(np.maximum(a, b), np.maximum(c, d)),
        )

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Interval:
        right = _interval(other)
        return NotImplemented if right is None else self * _reciprocal(right)

    def __rtruediv__(self, other: Any) -> Interval:
        left = _interval(other)
        return NotImplemented if left is None else left * _reciprocal(self)

    def __pow__(self, other: Any) -> Interval:
        return _power(self, other)

    def __lt__(self, other: Any) -> Any:
        return self.upper < _certainly(other).lower

    def __le__(self, other: Any) -> Any:
        return self.upper <= _certainly(other).lower

    def __gt__(self, other: Any) -> Any:
        return self.lower > _certainly(other).upper

    def __ge__(self, other: Any) -> Any:
        return self.lower >= _certainly(other).upper

    def __eq__(self, other: Any) -> Any:
        right = _certainly(other)
        return (self.lower == right.upper) & (self.upper == right.lower)

    def __ne__(self, other: Any) -> Any:
        right = _certainly(other)
        return (self.upper < right.lower) | (self.lower > right.upper)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if method != "__call__" or options or ufunc not in _UFUNCS:
            return NotImplemented
        first = inputs[0] if isinstance(inputs[0], Interval) else _certainly(inputs[0])
        return _UFUNCS[ufunc](first, *inputs[1:])


def _made(lower: Any, upper: Any) -> Interval:
    """An interval whose ends are known to be in order, or not numbers: those are caught where they are used."""
    made = Interval.__new__(Interval)
    made.lower, made.upper = np.asarray(lower), np.asarray(upper)
    return made


def hull(first: Interval, second: Interval) -> Interval:
    """The smallest interval that holds both."""
    return _made(np.minimum(first.lower, second.lower), np.maximum(first.upper, second.upper))


def _interval(x: Any) -> Interval | None:
    if isinstance(x, Interval):
        return x
    try:
        return Interval(x)
    except TypeError:
        return None


def _certainly(x: Any) -> Interval:
    return x if isinstance(x, Interval) else Interval(x)


def _rounded(lower: Any, upper: Any) -> Interval:
    """The next numbers outside: sound for correctly rounded operations."""
    return _made(np.nextafter(lower, -np.inf), np.nextafter(upper, np.inf))


def _library(lower: Any, upper: Any) -> Interval:
    """Widened by what the elementary functions may err."""
    return _made(lower - (_WIDENING * np.abs(lower) + _LEAST), upper + (_WIDENING * np.abs(upper) + _LEAST))


def _need(condition: Any, operation: str, needed: str) -> None:
    if not np.all(condition):
        raise ValueError(f"{operation} of an interval needs {needed} throughout")


def _square(x: Interval) -> Interval:
    least = abs(x).lower
    largest = x.magnitude
    squares = _rounded(least * least, largest * largest)
    return Interval(np.maximum(squares.lower, 0.0), squares.upper)


def _reciprocal(x: Interval) -> Interval:
    _need((x.lower > 0.0) | (x.upper < 0.0), "the reciprocal", "what is not zero")
    return _rounded(1.0 / x.upper, 1.0 / x.lower)


def _sqrt(x: Interval) -> Interval:
    _need(x.lower >= 0.0, "the square root", "what is not negative")
    roots = _rounded(np.sqrt(x.lower), np.sqrt(x.upper))
    return Interval(np.maximum(roots.lower, 0.0), roots.upper)


def _power(x: Interval, exponent: Any) -> Interval:
    """A power with a constant exponent: between the powers of the ends, and zero where an even one passes it."""
    if isinstance(exponent, int) and 1 <= exponent <= 64 and ((x.lower > 0.0) | (x.upper < 0.0)).all():
        if exponent == 1:
            return x
        half = _power(x, exponent // 2)
        return x * _square(half) if exponent % 2 else _square(half)
    p = np.asarray(exponent, dtype=np.float64)
    if p.ndim == 0 and p == 2.0:
        return _square(x)
    whole = p == np.rint(p)
    across = (x.lower <= 0.0) & (x.upper >= 0.0)
    _need((x.lower >= 0.0) & (p > 0.0) | (x.lower > 0.0) | whole, "a power", "what is positive")
    _need(~across | (p >= 0.0), "a negative power", "what is not zero")
    a, b = np.power(x.lower, p), np.power(x.upper, p)
    ends = _library(np.minimum(a, b), np.maximum(a, b))
    even = across & whole & (np.mod(p, 2.0) == 0.0) & (p != 0.0)
    return Interval(np.where(even, 0.0, ends.lower), ends.upper)


def _rising(function: Any) -> Any:
    return lambda x: _library(function(x.lower), function(x.upper))


def _log(x: Interval) -> Interval:
    _need(x.lower > 0.0, "the logarithm", "what is positive")
    return _library(np.log(x.lower), np.log(x.upper))


def _arcsin(x: Interval) -> Interval:
    _need((x.lower >= -1.0) & (x.upper <= 1.0), "the arc sine", "what is between -1 and 1")
    return _library(np.arcsin(x.lower), np.arcsin(x.upper))


def _arccos(x: Interval) -> Interval:
    _need((x.lower >= -1.0) & (x.upper <= 1.0), "the arc cosine", "what is between -1 and 1")
    return _library(np.arccos(x.upper), np.arccos(x.lower))


def _cosh(x: Interval) -> Interval:
    size = abs(x)
    return _library(np.cosh(size.lower), np.cosh(size.upper))


def _wave(function: Any, peak: float) -> Any:
    """Sine or cosine, whose maxima lie at `peak` and whole turns from it; ends near an extreme count as past it."""

    def passes(x: Interval, place: float) -> Any:
        margin = 1e-12 * (1.0 + x.magnitude)
        return np.floor((x.upper + margin - place) / (2.0 * np.pi)) >= np.ceil(
            (x.lower - margin - place) / (2.0 * np.pi)
        )

    def evaluate(x: Interval) -> Interval:
        at_lower, at_upper = function(x.lower), function(x.upper)
        ends = _library(np.minimum(at_lower, at_upper), np.maximum(at_lower, at_upper))
        far = x.magnitude > _FARTHEST_ANGLE
        return Interval(
            np.maximum(np.where(far | passes(x, peak + np.pi), -1.0, ends.lower), -1.0),
            np.minimum(np.where(far | passes(x, peak), 1.0, ends.upper), 1.0),
        )

    return evaluate


_sin, _cos = _wave(np.sin, 0.5 * np.pi), _wave(np.cos, 0.0)


def _tan(x: Interval) -> Interval:
    below = (_cos(x) != 0.0) & (x.upper - x.lower < 3.0)
    _need(below, "the tangent", "what holds no odd multiple of a right angle")
    return _library(np.tan(x.lower), np.tan(x.upper))


def _arctan2(y: Interval, x: Any) -> Interval:
    """Angles of a box: extreme at corners, unless it holds the origin or meets the cut along the negative x axis."""
    ahead = _certainly(x)
    corners = [np.arctan2(b, a) for b in (y.lower, y.upper) for a in (ahead.lower, ahead.upper)]
    angles = _library(np.minimum.reduce(corners), np.maximum.reduce(corners))
    cut = (ahead.lower <= 0.0) & (y.lower <= 0.0) & (y.upper >= 0.0)
    whole = np.nextafter(np.pi, 4.0)
    return Interval(np.where(cut, -whole, angles.lower), np.where(cut, whole, angles.upper))


_UFUNCS: dict[np.ufunc, Any] = {
    np.add: lambda a, b: a + b,
    np.subtract: lambda a, b: a - b,
    np.multiply: lambda a, b: a * b,
    np.divide: lambda a, b: a / b,
    np.power: _power,
    np.float_power: _power,
    np.negative: lambda a: -a,
    np.positive: lambda a: a,
    np.absolute: abs,
    np.fabs: abs,
    np.square: _square,
    np.reciprocal: _reciprocal,
    np.sqrt: _sqrt,
    np.hypot: lambda a, b: _sqrt(abs(_square(a) + _square(_certainly(b)))),
    np.exp: _rising(np.exp),
    np.log: _log,
    np.sin: _sin,
    np.cos: _cos,
    np.tan: _tan,
    np.arcsin: _arcsin,
    np.arccos: _arccos,
    np.arctan: _rising(np.arctan),
    np.arctan2: _arctan2,
    np.sinh: _rising(np.sinh),
    np.cosh: _cosh,
    np.tanh: _rising(np.tanh),
    np.less: lambda a, b: a < b,
    np.less_equal: lambda a, b: a <= b,
    np.greater: lambda a, b: a > b,
    np.greater_equal: lambda a, b: a >= b,
    np.equal: lambda a, b: a == b,
    np.not_equal: lambda a, b: a != b,
}
