"""The manoeuvre of Table 2 and its disturbances, for tests."""

from functools import lru_cache

import numpy as np

from aerotube.aircraft import F16
from aerotube.aircraft.rigid_body import velocity_from_flow
from aerotube.nominal import Nominal, constant_controls
from aerotube.numerics import quaternion_from_euler
from aerotube.tube import DisturbanceBox

HALF_WIDTHS = np.array([5.0, *np.radians([0.5, 0.5, 1.0, 0.5, 1.0, 0.5, 1.0])])
BOX = DisturbanceBox(HALF_WIDTHS, {"mass": 0.05})


def table2_state() -> np.ndarray:
    velocity = velocity_from_flow(185.0, np.radians(19.3), np.radians(0.7))
    quaternion = quaternion_from_euler(0.0, np.radians(-50.5), 0.0)
    rates = np.radians([-19.7, 28.2, -9.4])
    return np.array([*velocity, *quaternion, *rates, 0.0, 0.0, 3000.0])


TABLE2_CONTROL = np.array([np.radians(-5.3), 0.75, np.radians(3.0), 0.0])


@lru_cache
def aircraft(interpolation: str = "linear") -> F16:
    return F16(interpolation=interpolation)


@lru_cache
def table2(beats: int = 10, interpolation: str = "linear") -> Nominal:
    return constant_controls(aircraft(interpolation), table2_state(), TABLE2_CONTROL, 0.05, beats)
