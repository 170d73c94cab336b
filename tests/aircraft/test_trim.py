import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aerotube.aircraft import F16, state_derivatives, trim
from aerotube.errors import ComputationError, InputError
from aerotube.numerics import body_to_earth, earth_to_body, euler_from_quaternion

AIRCRAFT = {name: F16(interpolation=name) for name in ("linear", "smooth")}


@pytest.mark.parametrize("interpolation", ["linear", "smooth"])
@given(
    speed=st.floats(160.0, 250.0),
    altitude=st.floats(500.0, 5000.0),
    turn=st.floats(-8.0, 8.0),
    climb=st.floats(-5.0, 3.0),
)
@settings(max_examples=15, deadline=None)
def test_trim_is_steady_coordinated_flight(interpolation, speed, altitude, turn, climb):
    aircraft = AIRCRAFT[interpolation]
    state, control = trim(aircraft, speed, altitude, np.deg2rad(turn), np.deg2rad(climb))
    rates = state_derivatives(aircraft, state, control)
    assert rates[[0, 1, 2, 7, 8, 9]] == pytest.approx(0.0, abs=1e-8)
    assert rates[12] == pytest.approx(speed * np.sin(np.deg2rad(climb)), abs=1e-6)
    assert np.hypot(rates[10], rates[11]) == pytest.approx(speed * np.cos(np.deg2rad(climb)), abs=1e-6)
    # heading turns at the rate asked for, pitch and roll stay: Euler rates from body rates
    roll, pitch, _ = euler_from_quaternion(tuple(state[3:7]))
    p, q, r = state[7:10]
    heading_rate = (q * np.sin(roll) + r * np.cos(roll)) / np.cos(pitch)
    assert heading_rate == pytest.approx(np.deg2rad(turn), abs=1e-12)
    assert q * np.cos(roll) - r * np.sin(roll) == pytest.approx(0.0, abs=1e-12)
    assert p + heading_rate * np.sin(pitch) == pytest.approx(0.0, abs=1e-12)
    assert np.all((control >= aircraft.control_lower) & (control <= aircraft.control_upper))


def test_a_turn_carries_the_weight_on_its_bank():
    """Ball centred, the specific force lies in the plane of symmetry and balances weight and turn."""
    aircraft, turn = F16(), np.deg2rad(10.0)
    state, control = trim(aircraft, 200.0, 3000.0, turn_rate=turn)
    rates = state_derivatives(aircraft, state, control)
    quaternion, velocity, rotation = state[3:7], state[:3], state[7:10]
    weight = np.array(earth_to_body(tuple(quaternion), (0.0, 0.0, aircraft.gravity)))
    specific_force = rates[:3] + np.cross(rotation, velocity) - weight
    assert specific_force[1] == pytest.approx(0.0, abs=1e-8)
    in_earth = np.array(body_to_earth(tuple(quaternion), tuple(specific_force)))
    assert np.hypot(in_earth[0], in_earth[1]) == pytest.approx(200.0 * turn, abs=1e-7)
    assert in_earth[2] == pytest.approx(-aircraft.gravity, abs=1e-7)
    assert control[1] > trim(aircraft, 200.0, 3000.0)[1][1]


def test_lagging_engine_rests_at_the_power_it_is_asked_for():
    lagging, quick = F16(engine_lag=True), F16()
    state, control = trim(lagging, 200.0, 3000.0)
    assert state.shape == (14,)
    assert state_derivatives(lagging, state, control)[13] == pytest.approx(0.0, abs=1e-9)
    assert control == pytest.approx(trim(quick, 200.0, 3000.0)[1], abs=1e-9)


def test_impossible_flight_is_refused_in_words():
    with pytest.raises(ComputationError, match=r"throttle|trim"):
        trim(F16(), 185.0, 3000.0, flight_path=np.deg2rad(60.0))
    with pytest.raises(ComputationError, match="aircraft f16"):
        trim(F16(), 60.0, 14000.0)
    with pytest.raises(InputError, match="positive speed"):
        trim(F16(), -1.0, 3000.0)
    with pytest.raises(InputError, match="positive speed"):
        trim(F16(), 200.0, float("nan"))
    with pytest.raises(InputError, match="less than 90 deg"):
        trim(F16(), 200.0, 3000.0, flight_path=2.0)
