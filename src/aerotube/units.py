"""The one place where units are converted: SI and radians inside, an engineer's units at the edge."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

_DEGREE = math.pi / 180.0
_FOOT = 0.3048
_SLUG_FOOT2 = 1.3558179483314004

#: Units understood in scenarios and on the command line: kind -> unit -> factor to SI.
UNITS: dict[str, dict[str, float]] = {
    "speed": {"m/s": 1.0, "km/h": 1 / 3.6, "kt": 1852 / 3600, "ft/s": _FOOT},
    "angle": {"deg": _DEGREE, "rad": 1.0},
    "angular rate": {"deg/s": _DEGREE, "rad/s": 1.0},
    "length": {"m": 1.0, "km": 1000.0, "ft": _FOOT},
    "time": {"s": 1.0, "ms": 1e-3},
    "ratio": {"%": 0.01},
    "rate of thrust": {"N/s": 1.0, "kN/s": 1000.0, "lbf/s": 4.4482216152605},
    "angular momentum": {"kg m^2/s": 1.0, "slug ft^2/s": _SLUG_FOOT2},
}

_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(\S.*?)?\s*")


def parse_quantity(value: Any, kind: str) -> float:
    """Read a quantity with its unit, such as ``"19.3 deg"``.

    Parameters
    ----------
    value : str
        A number followed by one of the units of `kind`.
    kind : str
        A key of `UNITS`.

    Returns
    -------
    float
        The value in SI (radians for angles, 1 for ratios).

    Raises
    ------
    ValueError
        If `value` is no text, has no number, or has no unit of this kind.
    """
    units = UNITS[kind]
    choice = " or ".join(units)
    example = next(iter(units))

    def meant(number: float | str) -> str:
        # What is one at most was given as a share, of which a percent would be a hundredth.
        share = kind == "ratio" and abs(float(number)) <= 1.0
        return f"{100.0 * float(number):g} {example}" if share else f"{number} {example}"

    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise ValueError(f"{str(value).lower()} is no {kind}; write a number with its unit ({choice}) in quotes")
    if not isinstance(value, str):
        raise ValueError(f'{value} has no unit; write it with one, in quotes, such as "{meant(value)}"')
    match = _QUANTITY.fullmatch(value)
    if match is None:
        raise ValueError(f'"{value}" is no {kind}; write a number with its unit ({choice})')
    number, unit = match.groups()
    if unit is None:
        raise ValueError(f'"{value}" has no unit; write it with one, such as "{meant(number)}"')
    if unit not in units:
        raise ValueError(f'"{unit}" is no unit of {kind}; use {choice}')
    result = float(number) * units[unit]
    if not math.isfinite(result):
        raise ValueError(f'"{value}" is not a finite {kind}')
    return result


def quantity_parser(kind: str) -> Callable[[Any], float]:
    """Return `parse_quantity` for one kind, in the form that a validator takes."""

    def parse(value: Any) -> float:
        return parse_quantity(value, kind)

    return parse


@dataclass(frozen=True)
class Display:
    """How a quantity is shown: ``shown = factor * value_in_SI``, with a symbol and a unit."""

    symbol: str
    name: str
    unit: str
    factor: float = 1.0

    @property
    def label(self) -> str:
        """The symbol with the unit, as an axis label."""
        return f"{self.symbol} ({self.unit or '–'})"


_PER_DEGREE = 1.0 / _DEGREE

#: How the error states and the controls are shown, by their names in the datasets.
DISPLAY: dict[str, Display] = {
    "V": Display("V", "airspeed", "m/s"),
    "alpha": Display("α", "angle of attack", "deg", _PER_DEGREE),
    "q": Display("q", "pitch rate", "deg/s", _PER_DEGREE),
    "theta": Display("θ", "pitch angle", "deg", _PER_DEGREE),
    "beta": Display("β", "sideslip", "deg", _PER_DEGREE),
    "p": Display("p", "roll rate", "deg/s", _PER_DEGREE),
    "r": Display("r", "yaw rate", "deg/s", _PER_DEGREE),
    "phi": Display("φ", "roll angle", "deg", _PER_DEGREE),
    "elevator": Display("δe", "elevator", "deg", _PER_DEGREE),
    "throttle": Display("δth", "throttle", ""),
    "aileron": Display("δa", "aileron", "deg", _PER_DEGREE),
    "rudder": Display("δr", "rudder", "deg", _PER_DEGREE),
}
