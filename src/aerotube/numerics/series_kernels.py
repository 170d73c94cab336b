"""Compiled enclosures of the Taylor series of elementary functions, for Taylor models.

The recurrences of `aerotube.numerics.taylor_functions` in interval arithmetic, with the rounding and the assumptions of
`aerotube.numerics.interval`: every sum, product, quotient and square root widened by one unit in the last place, every
library function by `LIBRARY_ULPS`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from aerotube.numerics.interval import LIBRARY_ULPS

Array = NDArray[np.float64]

RECIPROCAL, SQRT, POWER, EXP, LOG, SIN, COS, ARCTAN, ARCSIN = range(9)

_WIDENING = LIBRARY_ULPS * 1.01 * 2.0**-52
_LEAST = 2.0**-1070
_FARTHEST_ANGLE = 1e6


@njit(cache=True, nogil=True)
def _out(low: float, high: float) -> Any:
    return np.nextafter(low, -np.inf), np.nextafter(high, np.inf)


@njit(cache=True, nogil=True)
def _library(low: float, high: float) -> Any:
    return low - (_WIDENING * abs(low) + _LEAST), high + (_WIDENING * abs(high) + _LEAST)


@njit(cache=True, nogil=True)
def _times(x: Any, y: Any) -> Any:
    a, b, c, d = x[0] * y[0], x[0] * y[1], x[1] * y[0], x[1] * y[1]
    return _out(min(min(a, b), min(c, d)), max(max(a, b), max(c, d)))


@njit(cache=True, nogil=True)
def _plus(x: Any, y: Any) -> Any:
    return _out(x[0] + y[0], x[1] + y[1])


@njit(cache=True, nogil=True)
def _ratio(x: float, y: float) -> Any:
    return _out(x / y, x / y)


@njit(cache=True, nogil=True)
def _square(x: Any) -> Any:
    largest = max(abs(x[0]), abs(x[1]))
    least = 0.0 if x[0] <= 0.0 <= x[1] else min(abs(x[0]), abs(x[1]))
    low, high = _out(least * least, largest * largest)
    return max(low, 0.0), high


@njit(cache=True, nogil=True)
def _put(terms: Array, k: int, x: Any) -> None:
    terms[k, 0] = x[0]
    terms[k, 1] = x[1]


@njit(cache=True, nogil=True)
def _wave(low: float, high: float, at_low: float, at_high: float, peak: float) -> Any:
    """Range of a wave whose maxima lie at `peak` and whole turns from it; ends near an extreme count as past it."""
    least, most = _library(min(at_low, at_high), max(at_low, at_high))
    size = max(abs(low), abs(high))
    margin, turn = 1e-12 * (1.0 + size), 2.0 * np.pi
    far = size > _FARTHEST_ANGLE
    if far or np.floor((high + margin - peak) / turn) >= np.ceil((low - margin - peak) / turn):
        most = 1.0
    trough = peak + np.pi
    if far or np.floor((high + margin - trough) / turn) >= np.ceil((low - margin - trough) / turn):
        least = -1.0
    return max(least, -1.0), min(most, 1.0)


@njit(cache=True, nogil=True)
def _powers(x: Any, exponent: float, terms: Array) -> None:
    """Fill in the series of a power of what is positive, its value given: ratios of terms are (p - k + 1) / (k x)."""
    inverse = _out(1.0 / x[1], 1.0 / x[0])
    for k in range(1, terms.shape[0]):
        factor = _out(exponent - (k - 1.0), exponent - (k - 1.0))
        scaled = _times(_times((terms[k - 1, 0], terms[k - 1, 1]), factor), _ratio(1.0, float(k)))
        _put(terms, k, _times(scaled, inverse))


@njit(cache=True, nogil=True)
def _arcs(x: Any, sign: float, terms: Array) -> None:
    """Fill in the series of the arc tangent (sign 1) or sine (-1), the value given: their slope g satisfies

    (1 + x**2) g = 1 and (1 - x**2) g' = x g.
    """
    square = _square(x)
    base = _plus((1.0, 1.0), square if sign > 0.0 else (-square[1], -square[0]))
    scale = _out(1.0 / base[1], 1.0 / base[0])
    before = (0.0, 0.0)
    low, high = _out(np.sqrt(scale[0]), np.sqrt(scale[1]))
    slope = scale if sign > 0.0 else (max(low, 0.0), high)
    for k in range(terms.shape[0] - 1):
        _put(terms, k + 1, _times(slope, _ratio(1.0, k + 1.0)))
        if sign > 0.0:
            rest = _plus(_times((-2.0 * x[1], -2.0 * x[0]), slope), (-before[1], -before[0]))
            slope, before = _times(rest, scale), slope
        else:
            rest = _times(_times((2.0 * k + 1.0, 2.0 * k + 1.0), x), slope)
            rest = _plus(rest, _times((float(k), float(k)), before))
            slope, before = _times(_times(rest, scale), _ratio(1.0, k + 1.0)), slope


@njit(cache=True, nogil=True)
def enclose(kind: int, exponent: float, low: float, high: float, terms: Array) -> bool:
    """Write enclosures (order + 1, 2) of the k-th derivatives over k! on an interval; False where they do not exist."""
    x, count = (low, high), terms.shape[0]
    if not low <= high:
        return False
    if kind == RECIPROCAL:
        if low <= 0.0 <= high:
            return False
        inverse = _out(1.0 / high, 1.0 / low)
        _put(terms, 0, inverse)
        for k in range(1, count):
            _put(terms, k, _times((terms[k - 1, 0], terms[k - 1, 1]), (-inverse[1], -inverse[0])))
    elif kind in (SQRT, POWER, LOG):
        if low <= 0.0:
            return False
        if kind == SQRT:
            _put(terms, 0, _out(np.sqrt(low), np.sqrt(high)))
            _powers(x, 0.5, terms)
        elif kind == POWER:
            a, b = low**exponent, high**exponent
            _put(terms, 0, _library(min(a, b), max(a, b)))
            _powers(x, exponent, terms)
        else:
            _put(terms, 0, _library(np.log(low), np.log(high)))
            inverse = _out(1.0 / high, 1.0 / low)
            power = inverse
            for k in range(1, count):
                _put(terms, k, _times(power, _ratio(1.0, float(k))))
                power = _times(power, (-inverse[1], -inverse[0]))
    elif kind in (EXP, SIN, COS):
        if kind == EXP:
            first = _library(np.exp(low), np.exp(high))
            second = first
        else:
            sine = _wave(low, high, np.sin(low), np.sin(high), 0.5 * np.pi)
            cosine = _wave(low, high, np.cos(low), np.cos(high), 0.0)
            first, second = (sine, cosine) if kind == SIN else (cosine, (-sine[1], -sine[0]))
        factorial = 1.0
        for k in range(count):
            factorial *= max(k, 1)  # exact up to 22!
            value = first if k % 2 == 0 else second
            if kind != EXP and k % 4 >= 2:
                value = (-value[1], -value[0])
            _put(terms, k, _times(value, _ratio(1.0, factorial)))
    elif kind == ARCTAN:
        _put(terms, 0, _library(np.arctan(low), np.arctan(high)))
        _arcs(x, 1.0, terms)
    else:
        if not (low > -1.0 and high < 1.0 and _square(x)[1] < 1.0):
            return False
        _put(terms, 0, _library(np.arcsin(low), np.arcsin(high)))
        _arcs(x, -1.0, terms)
    return True


@njit(cache=True, nogil=True)
def expand_rows(
    kind: int, exponent: float, middle: Array, reach: Array, low: Array, high: Array, series: Array, extra: Array
) -> int:
    """Write series (batch, order + 1) at the points `middle` (batch,) and bounds `extra` (batch,) of what they miss.

    The argument lies between `low` and `high`, no further than `reach` from `middle`. The index of the first row where
    the function is not defined throughout is returned, -1 if there is none.
    """
    count = series.shape[1]
    terms = np.empty((count + 1, 2))
    for row in range(middle.size):
        if not enclose(kind, exponent, low[row], high[row], terms):
            return row
        power = 1.0
        for _ in range(count):
            power *= reach[row]
        missed = max(abs(terms[count, 0]), abs(terms[count, 1])) * power
        enclose(kind, exponent, middle[row], middle[row], terms)
        power = 1.0
        for k in range(count):
            centre = 0.5 * terms[k, 0] + 0.5 * terms[k, 1]
            series[row, k] = centre
            missed += np.nextafter(max(centre - terms[k, 0], terms[k, 1] - centre), np.inf) * power
            power *= reach[row]
        extra[row] = missed * (1.0 + 2.0**-40)
    return -1
