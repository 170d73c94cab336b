from types import SimpleNamespace

import numpy as np
import pytest

from aerotube.aircraft import F16
from aerotube.nominal import constant_controls
from aerotube.numerics import quaternion_from_euler

#: Half-widths of Table 2: V (m/s), then alpha, q, theta, beta, p, r, phi in degrees and degrees per second.
BOX = np.array([5.0, *np.deg2rad([0.5, 0.5, 1.0, 0.5, 1.0, 0.5, 1.0])])
CONTROL = np.array([*np.deg2rad([-5.3]), 0.75, *np.deg2rad([3.0, 0.0])])


def table2_state():
    alpha, beta = np.deg2rad([19.3, 0.7])
    velocity = 185.0 * np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    attitude = quaternion_from_euler(0.0, np.deg2rad(-50.5), 0.0)
    return np.array([*velocity, *attitude, *np.deg2rad([-19.7, 28.2, -9.4]), 0.0, 0.0, 3000.0])


@pytest.fixture(scope="session")
def table2():
    """The manoeuvre of Table 2, 3 s, with the published tables."""
    aircraft = F16(xcg=0.30)
    nominal = constant_controls(aircraft, table2_state(), CONTROL, 0.05, 60)
    return SimpleNamespace(aircraft=aircraft, nominal=nominal, box=BOX, state=table2_state(), control=CONTROL)
