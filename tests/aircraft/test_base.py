"""The smallest aircraft one can write, through everything the base class gives it."""

import numpy as np
import pytest

from aerotube.aircraft import F16, Aircraft, Range, available, make, state_derivatives, trim
from aerotube.aircraft.registry import register
from aerotube.aircraft.rigid_body import Inertia, flow_angles, rigid_body_rates
from aerotube.errors import ComputationError, InputError
from aerotube.numerics import TaylorSpace


class Glider(Aircraft):
    """Linear aerodynamics, a thrust of a hundred newtons per unit of throttle."""

    name = "glider"
    control_lower = np.array([-0.3, 0.0, -0.3, -0.3])
    control_upper = np.array([0.3, 1.0, 0.3, 0.3])
    domain = (Range("airspeed", "m/s", 5.0, 60.0),)

    def domain_values(self, state):
        return (flow_angles(tuple(state[:3]))[0],)

    def rates(self, state, control, parameters=None, wind=None):
        x, air = tuple(state), (0.0,) * 6 if wind is None else tuple(wind)
        sigma = 1.0 if parameters is None else parameters[0]
        speed, attack, sideslip = flow_angles((x[0] - air[0], x[1] - air[1], x[2] - air[2]))
        pressure = 0.6 * speed * speed
        lift, drag = pressure * (0.3 + 5.0 * attack), pressure * (0.02 + 0.8 * attack * attack)
        force = (100.0 * control[1] - drag + lift * attack, -0.5 * pressure * sideslip, -lift)
        damping = 0.5 * pressure / speed
        moment = (
            pressure * (0.2 * control[2] - 0.1 * sideslip) - 4.0 * damping * x[7],
            pressure * (0.05 - 0.6 * attack - control[0]) - 8.0 * damping * x[8],
            pressure * (0.1 * control[3] + 0.1 * sideslip) - 2.0 * damping * x[9],
        )
        per_mass = sigma / 20.0
        scaled = tuple(per_mass * component for component in force)
        return rigid_body_rates(x, scaled, moment, Inertia(3.0, 4.0, 6.0, 0.1), 0.0, self.gravity)


def test_a_new_aircraft_flies_trims_and_expands():
    glider = Glider()
    state, control = trim(glider, 20.0, 100.0)
    assert state_derivatives(glider, state, control)[[0, 1, 2, 7, 8, 9]] == pytest.approx(0.0, abs=1e-8)
    state, control = trim(glider, 20.0, 100.0, turn_rate=0.2)
    rates = state_derivatives(glider, state, control)
    assert rates[[0, 1, 2, 7, 8, 9]] == pytest.approx(0.0, abs=1e-8)
    space = TaylorSpace(1, 2)
    x = [space.constant(value) for value in state]
    x[8] = space.variable(0, state[8])
    expanded = space.stack(glider.rates(x, control))
    assert expanded[:, 0] == pytest.approx(rates, abs=1e-12)
    step = state + 1e-6 * (np.arange(13) == 8)
    difference = (state_derivatives(glider, step, control) - rates) / 1e-6
    assert expanded[:, 1] == pytest.approx(difference, rel=1e-5, abs=1e-5)


def test_virtual_controls_are_the_controls_unless_said_otherwise():
    glider = Glider()
    assert glider.virtual_names == glider.control_names
    assert glider.virtual_units == glider.control_units
    state, control = trim(glider, 20.0, 100.0)
    increment = np.array([0.1, -0.1, 0.2, -0.2])
    moved = glider.rates_virtual(tuple(state), tuple(control), tuple(increment))
    assert np.array(moved) == pytest.approx(state_derivatives(glider, state, control + increment), abs=1e-12)
    lower, upper = glider.virtual_limits(state, control)
    assert lower == pytest.approx(glider.control_lower - control, abs=1e-15)
    assert upper == pytest.approx(glider.control_upper - control, abs=1e-15)
    assert glider.realise(state, control, 10.0 * np.ones(4)) == pytest.approx(glider.control_upper, abs=0)
    assert glider.settled(tuple(control)) == ()
    assert glider.compiled_step() is None


def test_domain():
    glider = Glider()
    state = np.zeros((2, 13))
    state[:, 0], state[:, 3] = [20.0, 61.0], 1.0
    assert glider.in_domain(state).tolist() == [True, False]
    sentence = glider.domain_violation(state)
    assert sentence is not None
    assert sentence.startswith("airspeed is 61 m/s (state 1), outside the range 5 to 60 m/s")
    with pytest.raises(ComputationError, match="airspeed is 61 m/s, outside"):
        trim(glider, 61.0, 100.0)


def test_trim_beyond_the_controls_names_the_control():
    with pytest.raises(ComputationError, match="needs throttle"):
        trim(Glider(), 30.0, 100.0, flight_path=0.5)


def test_registry_makes_aircraft_by_name():
    assert "f16" in available()
    made = make("f16", xcg=0.33, interpolation="smooth", engine_lag=True)
    assert isinstance(made, F16)
    assert (made.xcg, made.interpolation, made.engine_lag) == (0.33, "smooth", True)
    with pytest.raises(InputError, match="no aircraft 'f17'; choose one of: f16"):
        make("f17")
    with pytest.raises(InputError, match="no option 'cg'; choose among: xcg, interpolation"):
        make("f16", cg=0.3)
    with pytest.raises(InputError, match="name 'f16' is taken"):
        register("f16", Glider)


def test_a_registered_aircraft_is_made(monkeypatch):
    monkeypatch.setattr("aerotube.aircraft.registry._AIRCRAFT", {"f16": F16})
    register("glider", Glider)
    assert isinstance(make("glider"), Glider)
    register("glider", Glider)
    assert available() == ("f16", "glider")
