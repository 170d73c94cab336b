import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aerotube.dynamics.errors import ErrorCoordinates, euler_error
from aerotube.errors import InputError
from aerotube.numerics import attitude

angle = st.floats(-3.1, 3.1)
pitch = st.floats(-1.55, 1.55)


def full_state(speed=180.0, alpha=0.3, beta=0.02, roll=0.0, pitch=0.0, yaw=0.0, rates=(0.1, -0.2, 0.3)):
    velocity = speed * np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    quaternion = np.array(attitude.quaternion_from_euler(roll, pitch, yaw), dtype=float)
    return np.concatenate([velocity, quaternion, rates, [100.0, -50.0, 3000.0]])


errors = st.tuples(st.floats(-20, 20), *[st.floats(-0.2, 0.2)] * 3, *[st.floats(-0.2, 0.2)] * 4).map(np.array)


@given(angle, st.floats(-np.pi / 2, np.pi / 2), angle, errors)
def test_relative_difference_undoes_retract_at_any_attitude(roll, theta, yaw, error):
    nominal = full_state(roll=roll, pitch=theta, yaw=yaw)
    chart = ErrorCoordinates("relative")
    back = chart.difference(chart.retract(nominal, error), nominal)
    np.testing.assert_allclose(back, error, atol=1e-9, rtol=1e-9)


@given(angle, st.floats(-1.2, 1.2), angle, errors)
def test_euler_difference_undoes_retract_away_from_the_singularity(roll, theta, yaw, error):
    nominal = full_state(roll=roll, pitch=theta, yaw=yaw)
    chart = ErrorCoordinates("euler")
    back = chart.difference(chart.retract(nominal, error), nominal)
    np.testing.assert_allclose(back, error, atol=1e-9, rtol=1e-9)


@given(angle, pitch, angle)
def test_retract_keeps_the_quaternion_a_rotation_and_the_rest_untouched(roll, theta, yaw):
    nominal = full_state(roll=roll, pitch=theta, yaw=yaw)
    error = np.array([3.0, 0.02, 0.1, 0.3, -0.03, 0.2, -0.1, -0.4])
    for kind in ("relative", "euler"):
        state = ErrorCoordinates(kind).retract(nominal, error)
        assert np.linalg.norm(state[3:7]) == pytest.approx(1.0, abs=1e-12)
        np.testing.assert_array_equal(state[10:], nominal[10:])


def test_both_kinds_agree_to_first_order_with_the_cosine_of_pitch():
    nominal = full_state(roll=0.4, pitch=-0.8, yaw=1.0)
    step = 1e-6
    error = np.array([0.1, 1e-6, 2e-6, step, 1e-6, 0.0, 0.0, step])
    state = ErrorCoordinates("euler").retract(nominal, error)
    relative = ErrorCoordinates("relative").difference(state, nominal)
    expected = error.copy()
    expected[7] *= np.cos(-0.8)
    np.testing.assert_allclose(relative, expected, atol=1e-11)


def test_tilt_is_the_angle_between_the_down_directions():
    nominal = full_state(roll=1.1, pitch=0.7)
    state = full_state(roll=0.6, pitch=1.2)
    x = ErrorCoordinates("relative").difference(state, nominal)
    down = [np.array([-np.sin(t), np.cos(t) * np.sin(r), np.cos(t) * np.cos(r)]) for r, t in [(1.1, 0.7), (0.6, 1.2)]]
    tilt = np.arccos(down[0] @ down[1])
    assert 2 * np.arctan(np.hypot(x[3], x[7]) / 2) == pytest.approx(tilt, abs=1e-12)


def test_relative_errors_do_not_depend_on_heading():
    nominal = full_state(roll=0.5, pitch=0.2, yaw=0.0)
    one = ErrorCoordinates().difference(full_state(roll=0.6, pitch=0.1, yaw=0.3), nominal)
    other = ErrorCoordinates().difference(full_state(roll=0.6, pitch=0.1, yaw=2.8), nominal)
    np.testing.assert_allclose(one, other, atol=1e-12)


def test_euler_error_wraps_the_roll_angle():
    error = euler_error(full_state(roll=3.1), full_state(roll=-3.1))
    assert error[7] == pytest.approx(6.2 - 2 * np.pi, abs=1e-12)


@given(angle, st.floats(-1.4, 1.4), st.floats(-1, 1), st.floats(-1, 1))
def test_box_holds_every_euler_difference_of_the_given_box(roll, theta, a, b):
    widths = np.array([5.0, *np.radians([0.5, 0.5, 1.0, 0.5, 1.0, 0.5, 1.0])])
    nominal = full_state(roll=roll, pitch=theta)
    chart = ErrorCoordinates("relative")
    state = ErrorCoordinates("euler").retract(nominal, widths * [0, 0, 0, a, 0, 0, 0, b])
    x = chart.difference(state, nominal)
    box = chart.box(nominal, widths)
    assert abs(x[3]) <= box[3]
    assert abs(x[7]) <= box[7]
    assert box[7] >= 0.1 * widths[7]
    np.testing.assert_array_equal(np.delete(box, [3, 7]), np.delete(widths, [3, 7]))


def test_batches_broadcast():
    nominal = np.stack([full_state(pitch=p) for p in (0.1, 0.5, -0.9)])
    error = np.random.default_rng(0).normal(size=(4, 3, 8)) * 0.05
    for kind in ("relative", "euler"):
        chart = ErrorCoordinates(kind)
        state = chart.retract(nominal, error)
        assert state.shape == (4, 3, 13)
        np.testing.assert_allclose(chart.difference(state, nominal), error, atol=1e-12)
        np.testing.assert_allclose(state[2, 1], chart.retract(nominal[1], error[2, 1]), rtol=0, atol=1e-12)


def test_an_unknown_kind_is_refused():
    with pytest.raises(InputError, match="quaternion"):
        ErrorCoordinates("quaternion")
