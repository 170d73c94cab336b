import pickle

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from aerotube.aircraft import F16, state_derivatives
from aerotube.aircraft import f16_tables as published
from aerotube.aircraft.atmosphere import air_density, speed_of_sound
from aerotube.aircraft.f16 import INERTIA, MASS
from aerotube.aircraft.f16_aerodynamics import CHORD, SPAN, WING_AREA, aerodynamic_tables, coefficients
from aerotube.aircraft.rigid_body import velocity_from_flow
from aerotube.errors import InputError
from tests.aircraft.samples import DEG, states

INTERPOLATIONS = ["linear", "smooth"]
AIRCRAFT = {name: F16(interpolation=name) for name in INTERPOLATIONS}


def test_nominal_numbers_in_si():
    """Exact conversions of 20500 lbf at 32.17 ft/s2, slug ft2, ft2 and ft."""
    assert pytest.approx(9299.814, abs=5e-4) == MASS
    assert list(INERTIA) == pytest.approx([12874.847, 75673.623, 85552.113, 1331.413], abs=5e-4)
    lengths = [WING_AREA, SPAN, CHORD]
    assert lengths == pytest.approx([27.870912, 9.144, 3.450336], abs=5e-8)
    assert F16().gravity == pytest.approx(9.805416, abs=5e-7)
    assert F16().airframe.engine_momentum == pytest.approx(216.931, abs=5e-4)


def test_atmosphere_in_its_own_units():
    """Rankine, slug and feet: 519 R and 0.002377 slug/ft3 at sea level, 390 R above 35000 ft."""
    feet = np.array([0.0, 10000.0, 34999.0, 35000.0, 45000.0])
    share = 1.0 - 0.703e-5 * feet
    density = 0.002377 * share**4.14 * 515.378818
    assert air_density(feet * 0.3048) == pytest.approx(density, rel=1e-8)
    temperature = np.where(feet < 35000.0, 519.0 * share, 390.0)
    sound = np.sqrt(1.4 * 1716.3 * temperature) * 0.3048
    assert speed_of_sound(feet * 0.3048) == pytest.approx(sound, rel=1e-12)
    assert [speed_of_sound(height * 0.3048) for height in feet] == pytest.approx(sound, rel=1e-12)


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_coefficients_at_the_published_nodes(interpolation):
    """Total coefficients at nodes of the tables, from the formulas of the source in degrees."""
    tables, lever = aerodynamic_tables(interpolation), 0.35 - 0.3
    for row, elevator in enumerate(published.ELEVATOR[1:4], start=1):
        for column, attack in enumerate(published.ATTACK):
            for side, sideslip in enumerate(published.SIDESLIP):
                aileron, rudder, p, q, r, speed = 11.0, -7.0, 0.3, -0.2, 0.4, 180.0
                flow, control = (
                    (speed, attack * DEG, sideslip * DEG),
                    (elevator * DEG, 0.0, aileron * DEG, rudder * DEG),
                )
                pitch, roll, yaw = CHORD * q / (2 * speed), SPAN * p / (2 * speed), SPAN * r / (2 * speed)
                sign, one_sided = np.sign(sideslip), list(published.ABSOLUTE_SIDESLIP).index(abs(sideslip))
                cx = published.CX[row, column] + published.CX_Q[column] * pitch
                cy = -0.02 * sideslip + 0.021 * aileron / 20 + 0.086 * rudder / 30
                cy += published.CY_R[column] * yaw + published.CY_P[column] * roll
                cz = published.CZ[column] * (1 - (sideslip / 57.3) ** 2) - 0.19 * elevator / 25
                cz += published.CZ_Q[column] * pitch
                cl = sign * published.CL_ROLL[one_sided, column]
                cl += published.CL_ROLL_AILERON[side, column] * aileron / 20
                cl += published.CL_ROLL_RUDDER[side, column] * rudder / 30
                cl += published.CL_ROLL_R[column] * yaw + published.CL_ROLL_P[column] * roll
                cm = published.CM[row, column] + published.CM_Q[column] * pitch + cz * lever
                cn = sign * published.CN[one_sided, column]
                cn += published.CN_AILERON[side, column] * aileron / 20
                cn += published.CN_RUDDER[side, column] * rudder / 30
                cn += published.CN_R[column] * yaw + published.CN_P[column] * roll - cy * lever * CHORD / SPAN
                found = coefficients(tables, flow, (p, q, r), control, lever)
                assert np.array(found) == pytest.approx([cx, cy, cz, cl, cm, cn], abs=1e-11)


def test_known_misprints_are_not_ours():
    assert published.CZ[3] == -0.416
    assert published.CZ[6] == -1.366
    assert published.CM_Q[1] == -5.40
    assert published.CY_P[-1] == -0.227
    assert published.THRUST_IDLE[3, 1] == -710.0


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_a_batch_is_its_members(interpolation):
    aircraft = AIRCRAFT[interpolation]
    state, control = states(12)
    whole = state_derivatives(aircraft, state.reshape(3, 4, 13), control.reshape(3, 4, 4))
    assert whole.shape == (3, 4, 13)
    for i in range(12):
        assert whole.reshape(12, 13)[i] == pytest.approx(state_derivatives(aircraft, state[i], control[i]), rel=1e-13)
    # one control for all, and parameters that add an axis
    mass = np.array([0.95, 1.0, 1.05]).reshape(3, 1, 1)
    spread = state_derivatives(aircraft, state, control[0], mass)
    assert spread.shape == (3, 12, 13)
    assert spread[1] == pytest.approx(state_derivatives(aircraft, state, control[0]), rel=1e-13)


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_rates_are_affine_in_inverse_mass(interpolation):
    """And only the accelerations feel it: the inertias are left alone."""
    state, control = states(20, seed=1)
    light, nominal, heavy = (
        state_derivatives(AIRCRAFT[interpolation], state, control, [sigma]) for sigma in (0.9, 1.0, 1.1)
    )
    assert 0.5 * (light + heavy) == pytest.approx(nominal, rel=1e-12, abs=1e-12)
    assert light[:, 3:] == pytest.approx(heavy[:, 3:], abs=0)
    assert np.all(np.abs(heavy[:, 0] - light[:, 0]) > 0)


def test_rates_turn_with_the_heading_and_not_with_the_place():
    """Flat earth, still air: yaw and north, east change nothing but the direction of the ground velocity."""
    aircraft = AIRCRAFT["smooth"]
    state, control = states(20, seed=2)
    moved = state.copy()
    moved[:, 10:12] += 1000.0
    half = 0.35
    q0, q1, q2, q3 = state[:, 3:7].T
    c, s = np.cos(half), np.sin(half)
    moved[:, 3:7] = np.stack([c * q0 - s * q3, c * q1 - s * q2, c * q2 + s * q1, c * q3 + s * q0], axis=-1)
    before, after = (state_derivatives(aircraft, x, control) for x in (state, moved))
    body = [0, 1, 2, 7, 8, 9, 12]
    assert after[:, body] == pytest.approx(before[:, body], rel=1e-11, abs=1e-11)
    ground = (before[:, 10] + 1j * before[:, 11]) * np.exp(2j * half)
    assert after[:, 10] + 1j * after[:, 11] == pytest.approx(ground, rel=1e-12)


def test_energy_is_gained_by_force_times_velocity_only():
    """Kinetic and potential energy change by the power of aerodynamic force and thrust; rotation by the moments."""
    state, control = states(20, seed=3)
    rates = state_derivatives(F16(engine_momentum=0.0), state, control)
    gyroscopic = state_derivatives(F16(engine_momentum=5000.0), state, control)
    inertia = np.array([[INERTIA.xx, 0.0, -INERTIA.xz], [0.0, INERTIA.yy, 0.0], [-INERTIA.xz, 0.0, INERTIA.zz]])
    spin = state[:, 7:10]
    power = [np.einsum("ni,ij,nj->n", spin, inertia, x[:, 7:10]) for x in (rates, gyroscopic)]
    assert power[0] == pytest.approx(power[1], rel=1e-9), "the engine's spin does no work"
    assert np.all(np.abs(rates[:, 8:10] - gyroscopic[:, 8:10]).max(axis=1) > 1e-6)
    # M falls by r h and N rises by q h
    change = (gyroscopic - rates)[:, 7:10] @ inertia.T
    expected = 5000.0 * np.stack([0.0 * spin[:, 0], -spin[:, 2], spin[:, 1]], axis=-1)
    assert change == pytest.approx(expected, rel=1e-8, abs=1e-8)
    # weightless specific force along the velocity is what changes speed and height together
    light = state_derivatives(F16(), state, control, [0.0])
    energy_rate = np.sum(state[:, :3] * light[:, :3], axis=1) + F16().gravity * light[:, 12]
    assert energy_rate == pytest.approx(0.0, abs=1e-9)


def test_wind_enters_the_aerodynamics_only():
    """Drifting with a uniform wind, an aircraft feels what it feels in still air, and its ground speed adds up."""
    aircraft = AIRCRAFT["linear"]
    state, control = states(20, seed=4)
    wind = np.random.default_rng(5).uniform(-8, 8, (20, 6)) * [1, 1, 1, 0.01, 0.01, 0.01]
    drifting = state.copy()
    drifting[:, :3] += wind[:, :3]
    still = state_derivatives(aircraft, state, control)
    blown = state_derivatives(aircraft, drifting, control, wind=wind * [1, 1, 1, 0, 0, 0])
    coriolis = -np.cross(state[:, 7:10], wind[:, :3])
    assert blown[:, :3] == pytest.approx(still[:, :3] + coriolis, rel=1e-10, abs=1e-10)
    assert blown[:, 7:10] == pytest.approx(still[:, 7:10], rel=1e-10)
    turning = state_derivatives(aircraft, state, control, wind=wind * [0, 0, 0, 1, 1, 1])
    assert turning[:, 3:7] == pytest.approx(still[:, 3:7], abs=0)
    assert np.all(np.abs(turning[:, 7] - still[:, 7]) > 0)


def test_signs_of_the_controls():
    """Elevator up pitches up, aileron up rolls left, rudder up turns the nose left."""
    state = np.array([*velocity_from_flow(200.0, 0.05, 0.0), 1, 0, 0, 0, 0, 0, 0, 0, 0, 3000.0])
    base = state_derivatives(F16(), state, [0, 0.3, 0, 0])
    assert state_derivatives(F16(), state, [0.1, 0.3, 0, 0])[8] < base[8]
    assert state_derivatives(F16(), state, [0, 0.3, 0.1, 0])[7] < base[7]
    assert state_derivatives(F16(), state, [0, 0.3, 0, 0.1])[9] < base[9]
    assert state_derivatives(F16(), state, [0, 0.6, 0, 0])[0] > base[0]


def test_smooth_and_linear_tables_are_one_aircraft():
    """Through the same nodes: nowhere inside the tables do they part by more than a tenth of a coefficient's range."""
    linear, smooth = (aerodynamic_tables(name) for name in INTERPOLATIONS)
    random = np.random.default_rng(6)
    attack, sideslip, elevator = random.uniform([-10, -30, -20], [45, 30, 20], (2000, 3)).T * DEG
    still = (0.0, 0.0, 0.0)
    one, other = (
        np.array(coefficients(tables, (200.0, attack, sideslip), still, (elevator, 0, 0.2, 0.3), 0.0))
        for tables in (linear, smooth)
    )
    assert np.all(np.abs(one - other).max(axis=1) < 0.1 * np.ptp(one, axis=1))
    assert other[1] == pytest.approx(one[1], abs=1e-12), "at rest the side force needs no table"


@given(
    speed=st.floats(1.0, 500.0), attack=st.floats(-60, 80), sideslip=st.floats(-60, 60), altitude=st.floats(-500, 20000)
)
@settings(max_examples=60, deadline=None)
def test_domain_is_that_of_the_tables(speed, attack, sideslip, altitude):
    aircraft = AIRCRAFT["linear"]
    state = np.array([*velocity_from_flow(speed, attack * DEG, sideslip * DEG), 1, 0, 0, 0, 0, 0, 0, 0, 0, altitude])
    edges = [attack + 10, attack - 45, sideslip + 30, sideslip - 30, speed / speed_of_sound(altitude) - 1]
    assume(np.abs(edges).min() > 1e-9)  # on an edge rounding decides
    in_flow = -10 <= attack <= 45 and -30 <= sideslip <= 30
    in_air = 0 <= altitude <= 15240 and speed <= speed_of_sound(altitude)
    engine = aircraft.domain_values(tuple(state))[4] >= 0
    assert bool(aircraft.in_domain(state)) == (in_flow and in_air and engine)
    assert (aircraft.domain_violation(state) is None) == (in_flow and in_air and engine)


def test_domain_violation_says_what_and_where():
    aircraft = AIRCRAFT["linear"]
    state, _ = states(6, seed=7)
    state = state.reshape(2, 3, 13)
    assert aircraft.domain_violation(state) is None
    assert aircraft.in_domain(state).shape == (2, 3)
    state[1, 2, :3] = velocity_from_flow(200.0, 50 * DEG, 0.0)
    assert aircraft.in_domain(state).tolist() == [[True, True, True], [True, True, False]]
    sentence = aircraft.domain_violation(state)
    assert sentence is not None
    assert "angle of attack is 50 deg (state 1, 2)" in sentence
    assert "-10 to 45 deg" in sentence
    state[0, 1, 8] = np.nan
    assert not aircraft.in_domain(state)[0, 1]
    sentence = aircraft.domain_violation(state)
    assert sentence is not None
    assert "q is nan (state 0, 1)" in sentence


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"xcg": 30.0}, "fraction of the chord"),
        ({"xcg": float("nan")}, "fraction of the chord"),
        ({"interpolation": "cubic"}, "choose 'linear' or 'smooth'"),
        ({"engine_momentum": float("inf")}, "engine_momentum"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        F16(**options)


def test_an_aircraft_travels_to_other_processes_and_tells_what_it_is():
    aircraft = F16(xcg=0.33, interpolation="smooth", engine_lag=True)
    again = pickle.loads(pickle.dumps(aircraft))
    assert repr(again) == repr(aircraft)
    assert "xcg=0.33, interpolation='smooth'" in repr(again)
    state, control = states(3, seed=8)
    state = np.column_stack([state, [20.0, 50.0, 80.0]])
    assert np.array_equal(state_derivatives(again, state, control), state_derivatives(aircraft, state, control))


def test_shared_limits_cannot_be_changed_in_place():
    with pytest.raises(ValueError, match="read-only"):
        F16().control_upper[0] = 1.0


def test_bad_shapes_are_refused():
    with pytest.raises(InputError, match="state of the aircraft f16 has shape"):
        state_derivatives(F16(), np.zeros(14), np.zeros(4))
    with pytest.raises(InputError, match="control of the aircraft f16 has shape"):
        state_derivatives(F16(), np.zeros(13), np.zeros(3))
    with pytest.raises(InputError, match="parameters of the aircraft f16 has shape"):
        state_derivatives(F16(), np.zeros(13), np.zeros(4), parameters=1.0)
    with pytest.raises(InputError, match="wind of the aircraft f16 has shape"):
        state_derivatives(F16(), np.zeros(13), np.zeros(4), wind=np.zeros(3))
