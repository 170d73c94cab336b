import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from aerotube.numerics import (
    body_to_earth,
    earth_to_body,
    euler_from_quaternion,
    normalise,
    quaternion_conjugate,
    quaternion_from_euler,
    quaternion_product,
    quaternion_rates,
    wrap_angle,
)

angle = st.floats(-np.pi, np.pi)
pitch_angle = st.floats(-np.pi / 2, np.pi / 2)
component = st.floats(-1.0, 1.0)
vector = st.tuples(component, component, component)


def reference(roll, pitch, yaw):
    return Rotation.from_euler("ZYX", [yaw, pitch, roll])


@given(angle, pitch_angle, angle, vector)
def test_quaternion_of_euler_angles_turns_body_into_earth(roll, pitch, yaw, body):
    quaternion = quaternion_from_euler(roll, pitch, yaw)
    turned = body_to_earth(quaternion, body)
    assert np.array(turned) == pytest.approx(reference(roll, pitch, yaw).apply(body), abs=1e-14)
    assert np.array(earth_to_body(quaternion, turned)) == pytest.approx(np.array(body), abs=1e-14)


@given(angle, pitch_angle, angle)
@example(0.3, np.pi / 2, 0.5)
@example(0.3, -np.pi / 2, 0.5)
@example(0.3, np.pi / 2 - 1e-9, 0.5)
@example(-2.9, -np.pi / 2 + 1e-12, 3.1)
def test_euler_angles_describe_the_attitude_at_any_pitch(roll, pitch, yaw):
    quaternion = quaternion_from_euler(roll, pitch, yaw)
    found = euler_from_quaternion(quaternion)
    again = quaternion_from_euler(*found)
    # a quaternion and its negative are one attitude
    assert abs(np.dot(quaternion, again)) == pytest.approx(1.0, abs=1e-14)
    error = quaternion_product(quaternion_conjugate(quaternion), again)
    assert np.linalg.norm(error[1:]) < 4e-15
    assert abs(found[0]) <= np.pi + 1e-15
    assert abs(found[1]) <= np.pi / 2 + 1e-15
    assert abs(found[2]) <= np.pi + 1e-15


@given(angle, st.floats(-1.5, 1.5), angle)
def test_euler_angles_return_away_from_the_vertical(roll, pitch, yaw):
    found = np.array(euler_from_quaternion(quaternion_from_euler(roll, pitch, yaw)))
    error = found - [roll, pitch, yaw]
    assert wrap_angle(error) == pytest.approx(0.0, abs=1e-13)


@given(st.tuples(angle, pitch_angle, angle), st.tuples(angle, pitch_angle, angle))
def test_product_composes_rotations(outer, inner):
    product = quaternion_product(quaternion_from_euler(*outer), quaternion_from_euler(*inner))
    matrix = (reference(*outer) * reference(*inner)).as_matrix()
    columns = [body_to_earth(product, tuple(axis)) for axis in np.eye(3)]
    turned = np.array(columns).T
    assert turned == pytest.approx(matrix, abs=1e-14)


@given(st.floats(0.01, 100.0), angle, pitch_angle, angle)
def test_normalise(length, roll, pitch, yaw):
    unit = np.array(quaternion_from_euler(roll, pitch, yaw))
    assert np.array(normalise(tuple(length * unit))) == pytest.approx(unit, abs=1e-15)


@given(angle, pitch_angle, angle, vector)
def test_rates_turn_at_the_body_rates(roll, pitch, yaw, rotation):
    """Half the product with the pure quaternion of the rates; and the norm does not change."""
    quaternion = quaternion_from_euler(roll, pitch, yaw)
    rates = np.array(quaternion_rates(quaternion, rotation))
    product = quaternion_product(quaternion, (0.0, *rotation))
    assert rates == pytest.approx(0.5 * np.array(product), abs=1e-15)
    assert np.dot(rates, quaternion) == pytest.approx(0.0, abs=1e-15)


@given(st.floats(-50.0, 50.0))
def test_wrap_angle(angle):
    wrapped = wrap_angle(angle)
    assert abs(wrapped) <= np.pi + 1e-14
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-13)
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-13)


def test_components_may_be_arrays():
    random = np.random.default_rng(7)
    roll, pitch, yaw = random.uniform(-1.4, 1.4, (3, 5, 4))
    found = euler_from_quaternion(quaternion_from_euler(roll, pitch, yaw))
    assert np.array(found) == pytest.approx(np.array([roll, pitch, yaw]), abs=1e-14)
