"""The F-16 against published and independently computed numbers."""

import numpy as np
import pytest

from aerotube.aircraft import F16, state_derivatives, trim
from aerotube.aircraft.rigid_body import flow_angles, velocity_from_flow
from aerotube.numerics import euler_from_quaternion, quaternion_from_euler

FOOT = 0.3048


def test_textbook_check_case():
    """Stevens & Lewis, the check case of the F-16 model, in its own units; three moments use exact constants."""
    aircraft = F16(xcg=0.4, engine_lag=True)
    speed, attack, sideslip = 500.0, 0.5, -0.2
    roll, pitch, yaw, p, q, r = -1.0, 1.0, -1.0, 0.7, -0.8, 0.9
    velocity = velocity_from_flow(speed * FOOT, attack, sideslip)
    state = [*velocity, *quaternion_from_euler(roll, pitch, yaw), p, q, r, 0.0, 0.0, 10000.0 * FOOT, 90.0]
    control = [np.deg2rad(20.0), 0.9, np.deg2rad(-15.0), np.deg2rad(-20.0)]
    rates = state_derivatives(aircraft, state, control)

    u, v, w = np.array(velocity) / FOOT
    u_rate, v_rate, w_rate = rates[:3] / FOOT
    speed_rate = (u * u_rate + v * v_rate + w * w_rate) / speed
    assert speed_rate == pytest.approx(-75.2096, abs=5e-5)
    assert (u * w_rate - w * u_rate) / (u * u + w * w) == pytest.approx(-0.881192, abs=5e-7)
    sideslip_rate = (v_rate * speed - v * speed_rate) / (speed**2 * np.cos(sideslip))
    assert sideslip_rate == pytest.approx(-0.476006, abs=5e-7)
    assert rates[7] == pytest.approx(12.6531, abs=5e-5)
    assert rates[8] == pytest.approx(0.964905, abs=5e-7)
    assert rates[9] == pytest.approx(0.581365, abs=5e-7)
    assert rates[10:13] / FOOT == pytest.approx([342.4439, -266.7707, 248.1241], rel=1e-6)
    assert rates[13] == pytest.approx(-58.68999, rel=1e-6)

    # the printed rates of the Euler angles, through a small step of the quaternion
    quaternion, step = np.array(state[3:7]), 1e-6
    ahead = np.array(euler_from_quaternion(tuple(quaternion + step * rates[3:7])))
    behind = np.array(euler_from_quaternion(tuple(quaternion - step * rates[3:7])))
    assert (ahead - behind) / (2.0 * step) == pytest.approx([2.505734, 0.3250820, 2.145926], rel=1e-6)


@pytest.mark.parametrize(
    ("speed", "throttle", "elevator", "attack"),
    [(185.0, 0.219496, -1.86054, 1.96246), (250.0, 0.373524, -1.49243, 0.41679)],
)
def test_level_trim(speed, throttle, elevator, attack):
    state, control = trim(F16(), speed, 3000.0)
    assert control[1] == pytest.approx(throttle, abs=5e-7)
    assert np.rad2deg(control[0]) == pytest.approx(elevator, abs=5e-6)
    assert np.rad2deg(flow_angles(state[:3])[1]) == pytest.approx(attack, abs=5e-6)


PULL_OUT = {
    0.5: (183.25, 19.48, 12.89, -40.97, -1.94, -24.11, -6.01, -12.20),
    1.0: (183.29, 16.11, 9.04, -37.11, -0.37, -18.77, -9.43, -15.31),
    2.0: (186.55, 13.70, 13.41, -30.36, -0.95, -26.27, -9.05, -37.36),
    3.0: (189.24, 13.46, 14.49, -27.62, -0.91, -30.00, -9.21, -58.58),
    5.0: (194.48, 11.84, 14.36, -41.22, -0.63, -35.19, -9.45, -102.81),
}


def compiled_advance(aircraft, state, control, duration, steps):
    step = aircraft.compiled_step()
    return step(state[None], control[None], np.ones((1, 1)), np.zeros((1, 6)), duration, steps)[0]


def plain_advance(aircraft, state, control, duration, steps):
    held, step = tuple(control.tolist()), duration / steps

    def rates(x):
        return np.array(aircraft.rates(tuple(x.tolist()), held))

    for _ in range(steps):
        first = rates(state)
        second = rates(state + 0.5 * step * first)
        third = rates(state + 0.5 * step * second)
        fourth = rates(state + step * third)
        state = state + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
    return state


@pytest.mark.parametrize("advance", [plain_advance, compiled_advance])
def test_pull_out_with_constant_controls(advance):
    """Five seconds of the paper's Table 2 manoeuvre, RK4 at 1 ms: V (m/s), then angles and rates in degrees."""
    aircraft, deg = F16(xcg=0.30, engine_momentum=216.931), np.deg2rad
    velocity = velocity_from_flow(185.0, deg(19.3), deg(0.7))
    attitude = quaternion_from_euler(0.0, deg(-50.5), 0.0)
    state = np.array([*velocity, *attitude, deg(-19.7), deg(28.2), deg(-9.4), 0.0, 0.0, 3000.0])
    control, time = np.array([deg(-5.3), 0.75, deg(3.0), 0.0]), 0.0
    for until, expected in PULL_OUT.items():
        state = advance(aircraft, state, control, until - time, round(1000 * (until - time)))
        time = until
        speed, attack, sideslip = flow_angles(state[:3])
        roll, pitch, _ = euler_from_quaternion(tuple(state[3:7]))
        p, q, r = state[7:10]
        found = [speed, *np.rad2deg([attack, q, pitch, sideslip, p, r, roll])]
        assert found == pytest.approx(expected, abs=5.001e-3)
