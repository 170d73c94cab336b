"""Random flight inside the tables of the F-16."""

import numpy as np

from aerotube.aircraft.rigid_body import velocity_from_flow
from aerotube.numerics import quaternion_from_euler

DEG = np.pi / 180.0


def states(count, seed=0):
    """Random flight inside the tables, (count, 13), and controls (count, 4)."""
    random = np.random.default_rng(seed)

    def draw(low, high):
        return random.uniform(low, high, count)

    velocity = velocity_from_flow(draw(120, 280), draw(-8, 40) * DEG, draw(-25, 25) * DEG)
    attitude = quaternion_from_euler(draw(-3, 3), draw(-1.5, 1.5), draw(-3, 3))
    place = (*random.uniform(-1, 1, (5, count)), draw(500, 12000))
    control = np.stack([draw(-20, 20) * DEG, draw(0, 1), draw(-20, 20) * DEG, draw(-30, 30) * DEG], axis=-1)
    return np.stack([*velocity, *attitude, *place], axis=-1), control
