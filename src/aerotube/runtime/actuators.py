"""Actuators: what lies between a command and the position of a control."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Actuators:
    """First-order lags with rate limits, one for each control; the throttle has the engine's lag, if any.

    Attributes
    ----------
    bandwidth : ndarray (4,)
        1/s; infinite where there is no lag. Stevens and Lewis give 20.2 for the F-16's surfaces.
    rate : ndarray (4,)
        Largest rate, in the control's unit per second. Theirs: 60 deg/s elevator, 80 aileron, 120 rudder.
    """

    bandwidth: Array = field(default_factory=lambda: np.array([20.2, np.inf, 20.2, 20.2]))
    rate: Array = field(default_factory=lambda: np.array([*np.radians([60.0]), np.inf, *np.radians([80.0, 120.0])]))

    def move(self, position: Array, command: Array, seconds: float) -> Array:
        """Positions (4,) after some seconds under a command (4,)."""
        share = np.where(np.isinf(self.bandwidth), 1.0, -np.expm1(-np.minimum(self.bandwidth, 1e6) * seconds))
        most = np.where(np.isinf(self.rate), np.inf, self.rate * seconds)
        return np.asarray(position + np.clip(share * (command - position), -most, most))
