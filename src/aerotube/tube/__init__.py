"""Disturbance sets, ellipsoids, and the shapes in which tubes are measured."""

from aerotube.tube import ellipsoid
from aerotube.tube.disturbance import DisturbanceBox, DisturbanceSet, parameter_ranges
from aerotube.tube.disturbance_ellipsoid import DisturbanceEllipsoid
from aerotube.tube.disturbance_polytope import DisturbancePolytope
from aerotube.tube.lowner import least_volume_around_points
from aerotube.tube.named import disturbance_set
from aerotube.tube.semialgebraic import SemialgebraicSet
from aerotube.tube.shapes import cost_to_go, riccati, tracking_weights

__all__ = [
    "DisturbanceBox",
    "DisturbanceEllipsoid",
    "DisturbancePolytope",
    "DisturbanceSet",
    "SemialgebraicSet",
    "cost_to_go",
    "disturbance_set",
    "ellipsoid",
    "least_volume_around_points",
    "parameter_ranges",
    "riccati",
    "tracking_weights",
]
