"""Flying a law: Monte Carlo of the full nonlinear aircraft, noise, gusts, an estimator, baselines and metrics."""

from aerotube.flight.containment import FORMS, REASONS, Containment, containment
from aerotube.flight.draws import Draws, draw
from aerotube.flight.estimator import Estimate, ExtendedKalmanFilter, extended_kalman_filter
from aerotube.flight.gusts import Dryden, GustModel
from aerotube.flight.inversion import DynamicInversion
from aerotube.flight.library import LawLibrary, build_library, nearby_nominals
from aerotube.flight.lqr import time_varying_lqr
from aerotube.flight.metrics import (
    METRIC_SCALE,
    error_metric,
    mean_absolute_error,
    mean_upper_error,
    root_mean_square_error,
    upper_envelope,
)
from aerotube.flight.simulate import Divergence, Flights, Law, Trace, simulate
from aerotube.flight.sweep import (
    CONTROL_WEIGHTS,
    NOISE_WEIGHTS,
    InversionSweep,
    LqrSweep,
    best_inversion,
    best_lqr,
)

__all__ = [
    "CONTROL_WEIGHTS",
    "FORMS",
    "METRIC_SCALE",
    "NOISE_WEIGHTS",
    "REASONS",
    "Containment",
    "Divergence",
    "Draws",
    "Dryden",
    "DynamicInversion",
    "Estimate",
    "ExtendedKalmanFilter",
    "Flights",
    "GustModel",
    "InversionSweep",
    "Law",
    "LawLibrary",
    "LqrSweep",
    "Trace",
    "best_inversion",
    "best_lqr",
    "build_library",
    "containment",
    "draw",
    "error_metric",
    "extended_kalman_filter",
    "mean_absolute_error",
    "mean_upper_error",
    "nearby_nominals",
    "root_mean_square_error",
    "simulate",
    "time_varying_lqr",
    "upper_envelope",
]
