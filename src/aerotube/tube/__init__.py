"""Disturbance sets, ellipsoids, and the shapes in which tubes are measured."""

from aerotube.tube import ellipsoid
from aerotube.tube.disturbance import DisturbanceBox, parameter_ranges
from aerotube.tube.shapes import cost_to_go, riccati, tracking_weights

__all__ = [
    "DisturbanceBox",
    "cost_to_go",
    "ellipsoid",
    "parameter_ranges",
    "riccati",
    "tracking_weights",
]
