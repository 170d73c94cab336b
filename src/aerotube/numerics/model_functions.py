"""What NumPy's functions do with Taylor models."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerotube.numerics import taylor_functions as functions
from aerotube.numerics.interval import Interval
from aerotube.numerics.taylor_model import SLACK, UFUNCS, TaylorModel, enclosed

Array = NDArray[np.float64]


def larger(first: Any, second: Any) -> TaylorModel:
    """The larger of two models, or of a model and numbers: the one larger at the centre, and what it may lack."""
    space = next(x.space for x in (first, second) if isinstance(x, TaylorModel))
    a, b = (x if isinstance(x, TaylorModel) else space.constant(x) for x in (first, second))
    excess = b - a
    ahead = excess.value > 0.0
    data = np.where(ahead[..., None], b.data, a.data)
    bounds = excess.bounds
    data[..., -1] = (data[..., -1] + np.maximum(np.where(ahead, -bounds.lower, bounds.upper), 0.0)) * SLACK
    return TaylorModel(space, data)


def _arctan2(y: Any, x: Any) -> TaylorModel:
    """Angle of (x, y) from its direction at the centre of the domain; a range across the half turn is refused."""
    y0, x0 = (np.asarray(z.value if isinstance(z, TaylorModel) else z, dtype=np.float64) for z in (y, x))
    functions.require(x0 * x0 + y0 * y0 > 0.0, "the angle of a point given by Taylor models", "a point off the origin")
    scale = 1.0 / (x0 * x0 + y0 * y0)
    ahead, across = (x * x0 + y * y0) * scale, (y * x0 - x * y0) * scale
    functions.require(ahead.bounds > 0.0, "the angle of a point given by Taylor models", "a point within a half plane")
    origin: Any = Interval(y0)
    start = np.arctan2(origin, x0)
    angle = (across / ahead).function("arc tangent").shifted(start.middle, start.radius)
    within = np.abs(angle.value) + angle.reach < np.pi
    functions.require(within, "the angle of a point given by Taylor models", "to stay within half a turn of zero")
    return angle


def _rint(x: TaylorModel) -> Array:
    bounds = x.bounds
    functions.require(
        np.rint(bounds.lower) == np.rint(bounds.upper), "rounding a Taylor model", "a range that rounds to one number"
    )
    return np.asarray(np.rint(x.value))


def _unary(series: Callable[..., list[Any]]) -> Any:
    return lambda x: x.compose(series)


def _named(name: str) -> Any:
    return lambda x: x.function(name)


def _compared(a: Any, b: Any) -> Any:
    return a - b if isinstance(a, TaylorModel) else b.__rsub__(a)


_DEGREE = Interval(np.nextafter(np.pi, 0.0), np.nextafter(np.pi, 4.0)) / 180.0

_TABLE: dict[np.ufunc, Any] = {
    np.add: lambda a, b: b + a if isinstance(b, TaylorModel) else a + b,
    np.subtract: _compared,
    np.multiply: lambda a, b: b * a if isinstance(b, TaylorModel) else a * b,
    np.divide: lambda a, b: a / b if isinstance(a, TaylorModel) else b.__rtruediv__(a),
    np.power: lambda a, b: a**b if isinstance(a, TaylorModel) else b.__rpow__(a),
    np.float_power: lambda a, b: a**b if isinstance(a, TaylorModel) else b.__rpow__(a),
    np.arctan2: _arctan2,
    np.hypot: lambda a, b: (a * a + b * b).function("square root"),
    np.maximum: larger,
    np.minimum: lambda a, b: -larger(-a, -b),
    np.negative: lambda a: -a,
    np.positive: lambda a: a,
    np.absolute: lambda a: larger(a, -a),
    np.fabs: lambda a: larger(a, -a),
    np.square: lambda a: a * a,
    np.deg2rad: lambda a: a * enclosed(a.space, _DEGREE),
    np.radians: lambda a: a * enclosed(a.space, _DEGREE),
    np.rad2deg: lambda a: a * enclosed(a.space, 1.0 / _DEGREE),
    np.degrees: lambda a: a * enclosed(a.space, 1.0 / _DEGREE),
    np.rint: _rint,
    np.less: lambda a, b: _compared(a, b) < 0.0,
    np.less_equal: lambda a, b: _compared(a, b) <= 0.0,
    np.greater: lambda a, b: _compared(a, b) > 0.0,
    np.greater_equal: lambda a, b: _compared(a, b) >= 0.0,
    np.reciprocal: _named("reciprocal"),
    np.sqrt: _named("square root"),
    np.exp: _named("exponential"),
    np.log: _named("logarithm"),
    np.sin: _named("sine"),
    np.cos: _named("cosine"),
    np.tan: _unary(functions.tan),
    np.arcsin: _named("arc sine"),
    np.arccos: _unary(functions.arccos),
    np.arctan: _named("arc tangent"),
    np.sinh: _unary(functions.sinh),
    np.cosh: _unary(functions.cosh),
    np.tanh: _unary(functions.tanh),
}

UFUNCS.update(_TABLE)
