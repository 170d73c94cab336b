"""From an aircraft to a step: the Runge-Kutta step map, error coordinates, and the error map of a beat."""

from aerotube.dynamics.error_map import Linearisation, TaylorMap, error_map, linearise, taylor_map
from aerotube.dynamics.errors import (
    ERROR_NAMES,
    ERROR_UNITS,
    LATERAL,
    LONGITUDINAL,
    ErrorCoordinates,
    euler_error,
)
from aerotube.dynamics.step import rk4, step, step_components

__all__ = [
    "ERROR_NAMES",
    "ERROR_UNITS",
    "LATERAL",
    "LONGITUDINAL",
    "ErrorCoordinates",
    "Linearisation",
    "TaylorMap",
    "error_map",
    "euler_error",
    "linearise",
    "rk4",
    "step",
    "step_components",
    "taylor_map",
]
