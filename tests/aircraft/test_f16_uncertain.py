"""Uncertain mass, inertia, lift and control effectiveness of the F-16."""

import itertools

import numpy as np
import pytest

from aerotube.aircraft import F16, make, state_derivatives
from aerotube.aircraft.f16 import UNCERTAIN
from aerotube.aircraft.f16_aerodynamics import coefficients
from aerotube.aircraft.rigid_body import flow_angles
from aerotube.dynamics import ErrorCoordinates, error_map
from aerotube.errors import InputError
from aerotube.nominal import constant_controls
from aerotube.numerics import ModelSpace, TaylorSpace
from aerotube.tube import parameter_ranges
from tests.aircraft.samples import states
from tests.aircraft.test_compiled import reference
from tests.samples import TABLE2_CONTROL, table2_state

ALL = tuple(UNCERTAIN)
AIRCRAFT = {kind: F16(interpolation=kind, uncertain=ALL) for kind in ("linear", "smooth")}


@pytest.mark.parametrize("kind", AIRCRAFT)
def test_nominal_parameters_change_nothing(kind):
    state, control = states(20, seed=70)
    plain = state_derivatives(F16(interpolation=kind), state, control)
    assert state_derivatives(AIRCRAFT[kind], state, control) == pytest.approx(plain, rel=1e-12, abs=1e-12)
    again = state_derivatives(AIRCRAFT[kind], state, control, np.ones(4))
    assert again == pytest.approx(plain, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("kind", AIRCRAFT)
@pytest.mark.parametrize("which", range(4))
def test_rates_are_affine_in_each_parameter_with_the_others_held(kind, which):
    state, control = states(20, seed=71)
    held = np.random.default_rng(72).uniform(0.8, 1.2, (20, 4))
    low, middle, high = (held.copy() for _ in range(3))
    low[:, which], middle[:, which], high[:, which] = 0.7, 1.0, 1.3
    below, between, above = (state_derivatives(AIRCRAFT[kind], state, control, sigma) for sigma in (low, middle, high))
    assert 0.5 * (below + above) == pytest.approx(between, rel=1e-11, abs=1e-11)
    assert np.all(np.abs(above - below).max(axis=1) > 1e-3)


def test_inertia_divides_moments_and_leaves_the_accelerations():
    """At rest in rotation nothing is coupled: the angular accelerations go with the inverse inertia."""
    state, control = states(20, seed=73)
    state[:, 7:10] = 0.0
    plain = state_derivatives(AIRCRAFT["linear"], state, control, np.ones(4))
    half = state_derivatives(AIRCRAFT["linear"], state, control, [1.0, 0.5, 1.0, 1.0])
    assert half[:, 7:10] == pytest.approx(0.5 * plain[:, 7:10], rel=1e-12)
    assert half[:, :3] == pytest.approx(plain[:, :3], abs=0)


def test_gyroscopic_moments_are_those_of_a_scaled_body():
    """Without air, the rotation of a body does not depend on the scale of its inertia."""
    aircraft = F16(uncertain=ALL, engine_momentum=0.0)
    state, control = states(20, seed=74)
    state[:, 12] = 1.0 / 0.703e-5 * 0.3048 * (1 - 1e-12)  # where the atmosphere ends
    one, two = (state_derivatives(aircraft, state, control, [1.0, s, 1.0, 1.0])[:, 7:10] for s in (1.0, 0.3))
    assert one == pytest.approx(two, rel=1e-9, abs=1e-9)


def test_lift_grows_across_the_air_and_drag_stays():
    aircraft = AIRCRAFT["linear"]
    state, control = states(30, seed=75)
    flow = flow_angles(tuple(state.T[:3]))
    attack = flow[1]

    def wind_axes(lift):
        cx, cy, cz, *_ = coefficients(
            aircraft.airframe.aerodynamics, flow, tuple(state.T[7:10]), tuple(control.T), 0.05, lift
        )
        return cx * np.sin(attack) - cz * np.cos(attack), -cx * np.cos(attack) - cz * np.sin(attack), cy

    (lift, drag, side), (more, same, unmoved) = wind_axes(None), wind_axes(1.2)
    assert more == pytest.approx(1.2 * lift, rel=1e-12)
    assert same == pytest.approx(drag, rel=1e-12, abs=1e-14)
    assert unmoved == pytest.approx(side, abs=0)


def test_effectiveness_scales_what_deflection_adds():
    aircraft = AIRCRAFT["smooth"]
    state, control = states(30, seed=76)
    neutral = control * [0, 1, 0, 0]
    sigma = [1.0, 1.0, 1.0, 0.6]
    base, full = (state_derivatives(aircraft, state, a) for a in (neutral, control))
    assert state_derivatives(aircraft, state, neutral, sigma) == pytest.approx(base, rel=1e-12, abs=1e-12)
    weak = state_derivatives(aircraft, state, control, sigma)
    assert weak == pytest.approx(base + 0.6 * (full - base), rel=1e-11, abs=1e-11)


@pytest.mark.parametrize("options", [{}, {"engine_lag": True}], ids=["quick", "lag"])
@pytest.mark.parametrize("chosen", [ALL, ("mass", "lift")], ids=["all", "two"])
def test_compiled_step_is_the_numpy_step(options, chosen):
    aircraft, (state, control) = F16(uncertain=chosen, **options), states(20, seed=77)
    random = np.random.default_rng(78)
    if aircraft.engine_lag:
        state = np.column_stack([state, random.uniform(0.0, 100.0, 20)])
    parameters, wind = random.uniform(0.8, 1.2, (20, len(chosen))), np.zeros((20, 6))
    found = aircraft.compiled_step()(state, control, parameters, wind, 0.05, 2)
    expected = reference(aircraft, state, control, parameters, wind, 0.05, 2)
    assert found == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_parameters_run_through_taylor_arithmetic():
    """Exactly affine in each: the polynomial in the parameters alone is the map."""
    aircraft, (state, control) = AIRCRAFT["smooth"], states(4, seed=79)
    space = TaylorSpace(4, 3)
    found = space.stack(aircraft.rates(tuple(state.T), tuple(control.T), [space.variable(i, 1.0) for i in range(4)]))
    assert found[..., (space.exponents >= 2).any(axis=1)] == pytest.approx(0.0, abs=1e-11)
    change = np.random.default_rng(80).uniform(-0.2, 0.2, (7, 4))
    value = np.einsum("pk,fck->fpc", space.monomials(change), found)
    true = state_derivatives(aircraft, state[:, None], control[:, None], 1.0 + change)
    # lift and effectiveness multiply: with mass or inertia that is the third order
    assert value == pytest.approx(true, rel=1e-11, abs=1e-11)


def test_parameters_run_through_taylor_models():
    """Polynomial and remainder enclose the rates, the parameters and the angle of attack being variables."""
    aircraft, (state, control) = AIRCRAFT["smooth"], states(4, seed=81)
    space = ModelSpace((1,) * 5, 3)
    reach = np.eye(5)
    x = [space.constant(c) for c in state.T]
    x[2] = space.affine(state[:, 2], np.broadcast_to(0.5 * reach[4], (4, 5)))
    sigma = [space.affine(np.ones(4), np.broadcast_to(0.1 * reach[i], (4, 5))) for i in range(4)]
    rates = aircraft.rates(x, [space.constant(c) for c in control.T], sigma)
    z = np.random.default_rng(82).uniform(-1.0, 1.0, (50, 5))
    moved = np.repeat(state[:, None], 50, axis=1)
    moved[..., 2] += 0.5 * z[:, 4]
    true = state_derivatives(aircraft, moved, control[:, None], 1.0 + 0.1 * z[:, :4])
    for i in (0, 1, 2, 7, 8, 9):
        model = rates[i] + np.zeros(4)
        error = np.abs(model.coefficients @ space.taylor.monomials(z).T - true[..., i])
        assert np.all(error <= model.remainder[:, None] + 1e-9 * np.abs(true[..., i]))
        assert np.all(model.remainder < 0.05 * (1.0 + np.abs(true[..., i]).max()))


def test_extremes_exceed_what_lies_between_over_a_step():
    """A step composes rates, so that it is affine in the parameters only nearly: by how much is measured here."""
    aircraft = F16(uncertain=ALL)
    nominal = constant_controls(aircraft, table2_state(), TABLE2_CONTROL, 0.05, 6)
    ranges = parameter_ranges(aircraft, dict.fromkeys(ALL, 0.1))
    vertices = np.array(list(itertools.product(*ranges)))
    inside = np.random.default_rng(83).uniform(*ranges.T, (300, 4))
    metric = np.diag([0.01, *[np.degrees(1.0)] * 7]) ** 2

    def sizes(sigma):
        error = np.zeros((6, len(sigma), 8))
        parameters = np.broadcast_to(sigma, (6, *sigma.shape))
        end = error_map(aircraft, nominal, range(6), ErrorCoordinates(), error, parameters=parameters)
        return np.einsum("buj,ij,bui->bu", end, metric, end).max(axis=1)

    assert np.all(sizes(inside) <= sizes(vertices) * (1 + 1e-6))


def test_names_and_mistakes():
    assert F16().parameter_names == ("inverse_mass",)
    assert F16(uncertain=("lift",)).parameter_names == ("inverse_mass", "lift")
    assert make("f16", uncertain=ALL).parameter_names == tuple(UNCERTAIN.values())
    ranges = parameter_ranges(F16(uncertain=ALL), {"inertia": 0.25, "lift": 0.1})
    assert ranges == pytest.approx(np.array([[1, 1], [0.8, 1 / 0.75], [0.9, 1.1], [1, 1]]))
    with pytest.raises(InputError, match="choose among mass, inertia"):
        F16(uncertain=("weight",))
    with pytest.raises(InputError, match="no uncertain lift"):
        parameter_ranges(F16(), {"lift": 0.1})
