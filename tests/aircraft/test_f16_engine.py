import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aerotube.aircraft import F16, state_derivatives
from aerotube.aircraft import f16_tables as published
from aerotube.aircraft.f16 import MASS
from aerotube.aircraft.f16_engine import (
    power_from_throttle,
    power_from_thrust,
    power_rate,
    throttle_from_power,
    thrust_from_power,
    thrust_levels,
    thrust_table,
)
from aerotube.aircraft.rigid_body import velocity_from_flow

INTERPOLATIONS = ["linear", "smooth"]
QUICK = {name: F16(interpolation=name) for name in INTERPOLATIONS}
LAGGING = {name: F16(interpolation=name, engine_lag=True) for name in INTERPOLATIONS}
POUND = 4.4482216152605


def state_at(speed=200.0, altitude=3000.0, attack=0.1):
    return np.array([*velocity_from_flow(speed, attack, 0.0), 1, 0, 0, 0, 0.1, 0.2, 0.3, 0, 0, altitude], dtype=float)


def thrust_of(aircraft, state, control):
    """Thrust (N) from the difference it makes to the forward acceleration, beside that at idle."""
    idle = np.array(control)
    idle[..., 1] = 0.0
    difference = state_derivatives(aircraft, state, control) - state_derivatives(aircraft, state, idle)
    return difference[..., 0] * MASS


def test_power_of_throttle_as_published():
    throttle = np.array([0.0, 0.3, 0.77, 0.7701, 0.9, 1.0])
    assert power_from_throttle(throttle) == pytest.approx(
        [0.0, 19.482, 50.0038, 217.38 * 0.7701 - 117.38, 78.262, 100.0], abs=1e-10
    )


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_thrust_of_power_at_the_nodes(interpolation):
    """Idle, military and maximum at 0, 50 and 100 percent; midway in between."""
    table = thrust_table(interpolation)
    mach, altitude = published.MACH[:, None], published.ALTITUDE * 0.3048
    levels = thrust_levels(table, mach, altitude)
    idle, military, maximum = published.THRUST_IDLE, published.THRUST_MILITARY, published.THRUST_MAXIMUM
    expected = {0: idle, 25: (idle + military) / 2, 50: military, 75: (military + maximum) / 2, 100: maximum}
    for power, pounds in expected.items():
        assert thrust_from_power(np.float64(power), levels) == pytest.approx(pounds * POUND, rel=1e-10, abs=1e-7)


@given(throttle=st.floats(0.0, 1.0))
def test_throttle_to_power_and_back(throttle):
    power = power_from_throttle(throttle)
    again = throttle_from_power(power)
    assert power_from_throttle(again) == pytest.approx(power, abs=1e-11)
    # in the sliver past the kink two throttles command one power
    assert again == pytest.approx(throttle, abs=1e-12 if not 0.77 < throttle < 0.770006 else 3e-5)


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@given(throttle=st.floats(0.0, 1.0), mach=st.floats(0.2, 0.95), altitude=st.floats(0.0, 13000.0))
@settings(max_examples=60, deadline=None)
def test_throttle_to_thrust_and_back(interpolation, throttle, mach, altitude):
    levels = thrust_levels(QUICK[interpolation].airframe.thrust, mach, altitude)
    assert levels[0] < levels[1] < levels[2]
    thrust = thrust_from_power(power_from_throttle(throttle), levels)
    again = throttle_from_power(power_from_thrust(thrust, levels))
    assert again == pytest.approx(throttle, abs=1e-10 if not 0.77 < throttle < 0.770006 else 3e-5)
    assert thrust_from_power(power_from_throttle(again), levels) == pytest.approx(thrust, abs=1e-6)


@pytest.mark.parametrize(
    ("power", "command", "rate"),
    [
        (90.0, 78.262, 5.0 * (78.262 - 90.0)),  # both high: fast
        (60.0, 40.0, 5.0 * (40.0 - 60.0)),  # coming down through 50: fast towards 40
        (50.0, 50.0, 0.0),
        (30.0, 90.0, 0.82 * 30.0),  # going up through 50: towards 60, at 1.9 - 0.036 * 30
        (40.0, 80.0, 1.0 * 20.0),
        (20.0, 40.0, 1.0 * 20.0),  # both low, a small gap
        (45.0, 5.0, 1.0 * -40.0),  # a gap downwards counts as small
        (0.0, 30.0, (1.9 - 0.036 * 30.0) * 30.0),
        (0.0, 49.9, (1.9 - 0.036 * 49.9) * 49.9),
        (0.0, 100.0, 0.1 * 60.0),  # a large gap: slow
    ],
)
def test_lag_of_power(power, command, rate):
    assert power_rate(power, command) == pytest.approx(rate, abs=1e-12)
    assert power_rate(np.array([power]), np.array([command]))[0] == pytest.approx(rate, abs=1e-12)


@given(power=st.floats(0.0, 100.0), command=st.floats(0.0, 100.0))
def test_power_moves_towards_its_command(power, command):
    assert np.sign(power_rate(power, command)) in (np.sign(command - power), 0.0)


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_no_increment_changes_nothing(interpolation):
    state, control = state_at(), np.array([-0.05, 0.75, 0.02, 0.01])
    for aircraft, x in ((QUICK[interpolation], state), (LAGGING[interpolation], np.append(state, 48.0))):
        rates = aircraft.rates_virtual(tuple(x), tuple(control), (0.0, 0.0, 0.0, 0.0))
        assert np.array(rates) == pytest.approx(state_derivatives(aircraft, x, control), rel=1e-12, abs=1e-12)
        assert aircraft.realise(x, control, np.zeros(4)) == pytest.approx(control, abs=1e-12)


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@given(
    nominal=st.floats(0.0, 1.0),
    share=st.floats(0.0, 1.0),
    speed=st.floats(150.0, 250.0),
    altitude=st.floats(500.0, 9000.0),
)
@settings(max_examples=30, deadline=None)
def test_realised_controls_give_the_virtual_increment(interpolation, nominal, share, speed, altitude):
    """Anywhere between the limits at a state, the controls found give the rates that the increment asked for."""
    aircraft, state = QUICK[interpolation], state_at(speed, altitude)
    control = np.array([-0.05, nominal, 0.02, 0.01])
    lower, upper = aircraft.virtual_limits(state, control)
    assert np.all(lower <= 0.0)
    assert np.all(upper >= 0.0)
    increment = lower + share * (upper - lower)
    realised = aircraft.realise(state, control, increment)
    assert np.all((realised >= aircraft.control_lower) & (realised <= aircraft.control_upper))
    wanted = np.array(aircraft.rates_virtual(tuple(state), tuple(control), tuple(increment)))
    assert state_derivatives(aircraft, state, realised) == pytest.approx(wanted, rel=1e-9, abs=1e-9)


def test_limits_are_the_ends_of_the_travel():
    aircraft, state = QUICK["linear"], state_at()
    control = np.array([-0.05, 0.75, 0.02, 0.01])
    lower, upper = aircraft.virtual_limits(state, control)
    surfaces = [0, 2, 3]
    assert lower[surfaces] == pytest.approx((aircraft.control_lower - control)[surfaces], abs=1e-15)
    assert upper[surfaces] == pytest.approx((aircraft.control_upper - control)[surfaces], abs=1e-15)
    here = thrust_of(aircraft, state, control)
    ends = [thrust_of(aircraft, state, np.array([-0.05, end, 0.02, 0.01])) for end in (0.0, 1.0)]
    assert [lower[1], upper[1]] == pytest.approx([ends[0] - here, ends[1] - here], rel=1e-10)


def test_increments_beyond_the_limits_are_cut_off():
    aircraft, state = QUICK["linear"], np.stack([state_at(), state_at(230.0, 6000.0)])
    control = np.array([-0.05, 0.75, 0.02, 0.01])
    big = np.array([1.0, 1e6, 1.0, 1.0])
    assert aircraft.realise(state, control, big) == pytest.approx(np.tile(aircraft.control_upper, (2, 1)), abs=1e-12)
    assert aircraft.realise(state, control, -big) == pytest.approx(np.tile(aircraft.control_lower, (2, 1)), abs=1e-12)


def test_batches_of_increments():
    aircraft = QUICK["linear"]
    state = np.stack([state_at(180.0), state_at(220.0), state_at(200.0, 8000.0)])
    control = np.array([[-0.05, 0.5, 0.0, 0.0], [0.0, 0.8, 0.0, 0.0]])[:, None]
    increment = np.random.default_rng(50).uniform(-1.0, 1.0, (4, 1, 1, 4)) * [0.02, 5000.0, 0.02, 0.02]
    lower, upper = aircraft.virtual_limits(state, control)
    assert lower.shape == upper.shape == (2, 3, 4)
    realised = aircraft.realise(state, control, increment)
    assert realised.shape == (4, 2, 3, 4)
    for index in np.ndindex(4, 2, 3):
        alone = aircraft.realise(state[index[2]], control[index[1], 0], increment[index[0], 0, 0])
        assert realised[index] == pytest.approx(alone, abs=1e-13)


def test_lagging_engine_reaches_what_the_quick_one_gives_at_once():
    """At rest the power is the command's, and the thirteen rates are those of the quasi-static aircraft."""
    state, control = state_at(), np.array([-0.05, 0.6, 0.02, 0.01])
    (power,) = LAGGING["linear"].settled(tuple(control))
    rates = state_derivatives(LAGGING["linear"], np.append(state, power), control)
    assert rates[:13] == pytest.approx(state_derivatives(QUICK["linear"], state, control), rel=1e-12, abs=1e-12)
    assert rates[13] == pytest.approx(0.0, abs=1e-12)
    # a commanded thrust increment moves the command, not the thrust
    increment = (0.0, 8000.0, 0.0, 0.0)
    moved = np.array(LAGGING["linear"].rates_virtual((*state, power), tuple(control), increment))
    assert moved[:13] == pytest.approx(rates[:13], rel=1e-12, abs=1e-12)
    throttle = QUICK["linear"].realise(state, control, increment)[1]
    assert moved[13] == pytest.approx(power_rate(power, power_from_throttle(throttle)), rel=1e-9)
    assert moved[13] > 1.0


def test_names_and_units_match():
    for aircraft in (QUICK["linear"], LAGGING["linear"]):
        assert len(aircraft.state_names) == len(aircraft.state_units)
        assert len(aircraft.virtual_names) == len(aircraft.virtual_units) == len(aircraft.control_names)
        assert aircraft.control_lower.shape == aircraft.control_upper.shape == (len(aircraft.control_names),)
        assert aircraft.parameter_nominal.tolist() == [1.0]
    assert LAGGING["linear"].state_names[-1] == "power"
    assert QUICK["linear"].virtual_names[1] == "thrust"
    assert QUICK["linear"].virtual_units[1] == "N"
