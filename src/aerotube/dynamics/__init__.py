"""From an aircraft to a step: the Runge-Kutta step map, error coordinates, the error map of a beat and its bounds."""

from aerotube.dynamics.enclosure import BeatSet, ErrorEnclosure, beat_set, enclose_error_map, linear_law, polynomial_law
from aerotube.dynamics.error_map import Linearisation, TaylorMap, error_map, linearise, slopes, taylor_map
from aerotube.dynamics.errors import (
    ERROR_NAMES,
    ERROR_UNITS,
    LATERAL,
    LONGITUDINAL,
    ErrorCoordinates,
    euler_error,
)
from aerotube.dynamics.flown_map import flown_map
from aerotube.dynamics.remainder import Excess, SizeSamples, excess, graded_sizes, size_samples
from aerotube.dynamics.step import rk4, step, step_components

__all__ = [
    "ERROR_NAMES",
    "ERROR_UNITS",
    "LATERAL",
    "LONGITUDINAL",
    "BeatSet",
    "ErrorCoordinates",
    "ErrorEnclosure",
    "Excess",
    "Linearisation",
    "SizeSamples",
    "TaylorMap",
    "beat_set",
    "enclose_error_map",
    "error_map",
    "euler_error",
    "excess",
    "flown_map",
    "graded_sizes",
    "linear_law",
    "linearise",
    "polynomial_law",
    "rk4",
    "size_samples",
    "slopes",
    "step",
    "step_components",
    "taylor_map",
]
