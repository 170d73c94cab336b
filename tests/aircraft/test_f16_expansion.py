"""Taylor polynomials through the F-16's own equations."""

import numpy as np
import pytest

from aerotube.aircraft import F16, state_derivatives
from aerotube.aircraft.rigid_body import velocity_from_flow
from aerotube.numerics import TaylorSpace, quaternion_from_euler

DEG = np.pi / 180.0
SCALE = np.array([5, 5, 5, *[0.01] * 4, *[0.02] * 3, 10, 10, 50, 0.01, 0.02, 0.01, 0.01, 0.02])


def flights():
    attack, sideslip = np.array([19.3, 2.1, 33.7, -4.2]) * DEG, np.array([0.7, -2.3, 11.9, 0.2]) * DEG
    velocity = velocity_from_flow(np.array([185.0, 250.0, 140.0, 210.0]), attack, sideslip)
    attitude = quaternion_from_euler(np.array([0.1, 1.0, -2.0, 0.0]), np.array([-0.9, 0.1, 0.7, 1.2]), 0.4)
    rates = np.array([[-0.3, 0.5, -0.2], [0.1, 0.0, 0.1], [1.0, 0.2, -0.4], [0.0, 0.3, 0.0]]).T
    state = np.stack([*velocity, *attitude, *rates, *np.zeros((2, 4)), [3000.0, 1000.0, 7000.0, 5000.0]], axis=-1)
    control = np.tile([-5.3 * DEG, 0.75, 3.0 * DEG, 0.01], (4, 1))
    return state, control


def expansion(aircraft, order, state, control):
    """Rates (4 flights, 13, coefficients) in 13 states, 4 controls and the inverse mass."""
    space = TaylorSpace(18, order)
    x = [space.variable(i, state[:, i]) for i in range(13)]
    a = [space.variable(13 + i, control[:, i]) for i in range(4)]
    return space, space.stack(aircraft.rates(x, a, [space.variable(17, 1.0)]))


def true_rates(aircraft, state, control, change):
    points = change.shape[0]
    x = np.broadcast_to(state[:, None], (4, points, 13)) + change[:, :13]
    a = np.broadcast_to(control[:, None], (4, points, 4)) + change[:, 13:17]
    return state_derivatives(aircraft, x, a, 1.0 + change[:, 17:])


@pytest.mark.parametrize("interpolation", ["linear", "smooth"])
def test_first_derivatives_are_those_of_finite_differences(interpolation):
    aircraft, (state, control) = F16(interpolation=interpolation), flights()
    _, found = expansion(aircraft, 1, state, control)
    assert found[..., 0] == pytest.approx(state_derivatives(aircraft, state, control), rel=1e-12, abs=1e-12)
    steps = 1e-4 * np.diag(SCALE)
    difference = true_rates(aircraft, state, control, steps) - true_rates(aircraft, state, control, -steps)
    expected = np.moveaxis(difference, 1, 2) / 2e-4  # per unit of scale
    assert found[..., 1:] * SCALE == pytest.approx(expected, rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("order", [2, 3, 4])
def test_remainder_has_the_order_it_should(order):
    """Halving the increment divides the remainder by 2**(order + 1), wherever it is above rounding."""
    aircraft, (state, control) = F16(interpolation="smooth"), flights()
    space, found = expansion(aircraft, order, state, control)
    directions = SCALE * np.random.default_rng(40).uniform(-1.0, 1.0, (5, 18))
    errors = []
    for scale in (0.2, 0.1):
        change = scale * directions
        value = np.einsum("pk,fck->fpc", space.monomials(change), found)
        errors.append(np.linalg.norm(value - true_rates(aircraft, state, control, change), axis=-1))
    ratio = errors[0] / errors[1]
    assert np.all(errors[0] < 10.0 ** (-order))
    assert np.median(ratio) == pytest.approx(2.0 ** (order + 1), rel=0.1)


def test_two_orders_agree_in_what_they_share():
    aircraft, (state, control) = F16(interpolation="smooth"), flights()
    low_space, low = expansion(aircraft, 2, state, control)
    _, high = expansion(aircraft, 3, state, control)
    assert high[..., : low_space.size] == pytest.approx(low, rel=1e-12, abs=1e-12)


def test_rates_are_affine_in_inverse_mass_to_every_order():
    aircraft, (state, control) = F16(interpolation="smooth"), flights()
    space, found = expansion(aircraft, 3, state, control)
    assert found[..., space.exponents[:, 17] >= 2] == pytest.approx(0.0, abs=1e-12)


def test_thrust_increment_enters_affinely():
    """The virtual control: thrust over mass in the forward acceleration, nothing else, no higher order."""
    aircraft, (state, control) = F16(interpolation="smooth"), flights()
    space = TaylorSpace(2, 3)
    thrust, sigma = space.variable(0, 0.0), space.variable(1, 1.0)
    found = space.stack(aircraft.rates_virtual(tuple(state.T), tuple(control.T), (0.0, thrust, 0.0, 0.0), (sigma,)))
    with_thrust = space.exponents[:, 0] >= 1
    nonzero = np.argwhere(np.abs(found[:, :, with_thrust]) > 0)
    assert set(nonzero[:, 1]) == {0}
    linear = found[:, 0, (space.exponents == [1, 0]).all(axis=1)]
    assert linear == pytest.approx(np.full((4, 1), 1.0 / 9299.814), rel=1e-7)
    assert not found[:, :, space.exponents[:, 0] >= 2].any()
