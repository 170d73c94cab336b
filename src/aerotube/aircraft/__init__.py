"""What flies: aircraft, their equations of motion and steady flight."""

from aerotube.aircraft.base import (
    CONTROLS,
    RIGID_BODY_STATES,
    RIGID_BODY_UNITS,
    Aircraft,
    Range,
    state_derivatives,
)
from aerotube.aircraft.f16 import F16
from aerotube.aircraft.registry import available, make
from aerotube.aircraft.trim import trim

__all__ = [
    "CONTROLS",
    "F16",
    "RIGID_BODY_STATES",
    "RIGID_BODY_UNITS",
    "Aircraft",
    "Range",
    "available",
    "make",
    "state_derivatives",
    "trim",
]
