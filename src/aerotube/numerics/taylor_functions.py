"""Taylor series of the elementary functions of one variable, about arrays of points.

Each function takes points (...) and an order, and returns a list of arrays (...): the k-th derivative over k!,
for k = 0 .. order. The recurrences follow from the differential equation that each function satisfies
(A. Griewank, A. Walther, *Evaluating Derivatives*, 2nd ed., SIAM 2008, section 13.2).
"""

from __future__ import annotations

from collections.abc import Callable
from math import factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Series = Callable[[Array, int], list[Array]]


def require(condition: Any, operation: str, needed: str) -> None:
    """ValueError if an expansion does not exist somewhere in a batch (a value that is not a number among them)."""
    holds = np.asarray(condition)
    if not holds.all():
        index = tuple(int(i) for i in np.argwhere(~holds)[0])
        where = f" (batch index {', '.join(map(str, index))})" if index else ""
        raise ValueError(f"{operation} needs {needed}{where}")


def exp(x: Array, order: int) -> list[Array]:
    """Exponential."""
    value = np.exp(x)
    return [value / factorial(k) for k in range(order + 1)]


def log(x: Array, order: int) -> list[Array]:
    """Natural logarithm."""
    require(x > 0.0, "the logarithm of a Taylor polynomial", "a positive value")
    return [np.log(x)] + [-((-1.0 / x) ** k) / k for k in range(1, order + 1)]


def power(exponent: Array) -> Series:
    """Power with a constant exponent (...)."""

    def series(x: Array, order: int) -> list[Array]:
        whole = exponent == np.rint(exponent)
        require((x > 0.0) | (whole & (x != 0.0)), "a power of a Taylor polynomial", "a positive value")
        terms = [np.power(x, exponent)]
        for k in range(1, order + 1):
            terms.append(terms[-1] * (exponent - (k - 1)) / (k * x))
        return terms

    return series


def sqrt(x: Array, order: int) -> list[Array]:
    """Square root."""
    require(x > 0.0, "the square root of a Taylor polynomial", "a positive value")
    terms = [np.sqrt(x)]
    for k in range(1, order + 1):
        terms.append(terms[-1] * (1.5 - k) / (k * x))
    return terms


def reciprocal(x: Array, order: int) -> list[Array]:
    """One over the argument."""
    require(x != 0.0, "division by a Taylor polynomial", "a value that is not zero")
    inverse = 1.0 / x
    return [inverse * (-inverse) ** k for k in range(order + 1)]


def sin(x: Array, order: int) -> list[Array]:
    """Sine."""
    cycle = (np.sin(x), np.cos(x))
    return [(1 - 2 * (k // 2 % 2)) * cycle[k % 2] / factorial(k) for k in range(order + 1)]


def cos(x: Array, order: int) -> list[Array]:
    """Cosine."""
    cycle = (np.cos(x), np.sin(x))
    return [(1 - 2 * ((k + 1) // 2 % 2)) * cycle[k % 2] / factorial(k) for k in range(order + 1)]


def sinh(x: Array, order: int) -> list[Array]:
    """Hyperbolic sine."""
    cycle = (np.sinh(x), np.cosh(x))
    return [cycle[k % 2] / factorial(k) for k in range(order + 1)]


def cosh(x: Array, order: int) -> list[Array]:
    """Hyperbolic cosine."""
    cycle = (np.cosh(x), np.sinh(x))
    return [cycle[k % 2] / factorial(k) for k in range(order + 1)]


def tan(x: Array, order: int) -> list[Array]:
    """Tangent: t' = 1 + t**2."""
    return _own_square(np.tan(x), order, 1.0)


def tanh(x: Array, order: int) -> list[Array]:
    """Hyperbolic tangent: t' = 1 - t**2."""
    return _own_square(np.tanh(x), order, -1.0)


def _own_square(value: Array, order: int, sign: float) -> list[Array]:
    """Series of a function t with t' = 1 + sign * t**2."""
    terms = [value]
    for k in range(order):
        square: Any = sum(terms[i] * terms[k - i] for i in range(k + 1))
        terms.append((sign * square + (1.0 if k == 0 else 0.0)) / (k + 1))
    return terms


def arctan(x: Array, order: int) -> list[Array]:
    """Arc tangent: the derivative g satisfies (1 + x**2) g = 1."""
    scale = 1.0 / (1.0 + x * x)
    slope: list[Array] = []
    for k in range(order):
        before = slope[k - 1] if k >= 1 else 0.0
        earlier = slope[k - 2] if k >= 2 else 0.0
        slope.append(((1.0 if k == 0 else 0.0) - 2.0 * x * before - earlier) * scale)
    return [np.arctan(x)] + [slope[k] / (k + 1) for k in range(order)]


def arcsin(x: Array, order: int) -> list[Array]:
    """Arc sine: the derivative g satisfies (1 - x**2) g' = x g."""
    require(np.abs(x) < 1.0, "the arc sine or cosine of a Taylor polynomial", "a value between -1 and 1")
    scale = 1.0 / (1.0 - x * x)
    slope: list[Array] = [np.sqrt(scale)]
    for k in range(order - 1):
        before = slope[k - 1] if k >= 1 else 0.0
        slope.append(((2 * k + 1) * x * slope[k] + k * before) * scale / (k + 1))
    return [np.arcsin(x)] + [slope[k] / (k + 1) for k in range(order)]


def arccos(x: Array, order: int) -> list[Array]:
    """Arc cosine."""
    sine = arcsin(x, order)
    return [np.arccos(x)] + [-term for term in sine[1:]]
