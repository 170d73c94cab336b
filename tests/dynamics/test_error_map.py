import numpy as np
import pytest

from aerotube.dynamics import ErrorCoordinates, error_map, linearise, slopes, step, taylor_map
from tests.samples import HALF_WIDTHS, aircraft, table2

CHART = ErrorCoordinates()


def sample(rng, beats, count, scale):
    return scale * HALF_WIDTHS * rng.uniform(-1, 1, (beats, count, 8))


@pytest.mark.parametrize("kind", ["relative", "euler"])
@pytest.mark.parametrize("interpolation", ["linear", "smooth"])
def test_no_error_stays_no_error(kind, interpolation):
    nominal = table2(4, interpolation)
    end = error_map(aircraft(interpolation), nominal, range(4), ErrorCoordinates(kind), np.zeros((4, 1, 8)))
    np.testing.assert_allclose(end, 0.0, atol=1e-11)


def test_map_is_a_step_between_two_nominal_states():
    plane, nominal = aircraft(), table2(6)
    rng = np.random.default_rng(0)
    error = sample(rng, 2, 3, 2.0)
    sigma = rng.uniform(0.95, 1.05, (2, 3, 1))
    end = error_map(plane, nominal, [1, 5], CHART, error, parameters=sigma)
    for row, beat in enumerate((1, 5)):
        for run in range(3):
            start = CHART.retract(nominal.states[beat], error[row, run])
            state = step(plane, start, nominal.controls[beat], 0.05, parameters=sigma[row, run])
            np.testing.assert_allclose(
                end[row, run], CHART.difference(state, nominal.states[beat + 1]), rtol=0, atol=1e-12
            )


def test_errors_compose_along_the_trajectory():
    """The errors of one flight, beat by beat, are the map applied again and again; altitude is no error."""
    plane, nominal = aircraft(), table2(5)
    error = HALF_WIDTHS * [1, -1, 1, -1, 1, -1, 1, -1]
    state = CHART.retract(nominal.states[0], error)
    for beat in range(5):
        error = error_map(plane, nominal, [beat], CHART, error[None, None])[0, 0]
        state = step(plane, state, nominal.controls[beat], 0.05)
        state[12] = nominal.states[beat + 1, 12]
    np.testing.assert_allclose(error, CHART.difference(state, nominal.states[5]), rtol=0, atol=1e-10)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_taylor_polynomial_agrees_within_its_remainder(order):
    """Halving the errors divides the remainder by two to the order plus one."""
    plane, nominal = aircraft("smooth"), table2(6, "smooth")
    rng = np.random.default_rng(order)
    beats = [0, 3, 5]
    polynomial = taylor_map(plane, nominal, beats, CHART, order=order, parameters=(0,))
    direction = sample(rng, 3, 20, 4.0)
    push = rng.uniform(-1, 1, (3, 20, 4)) * np.array([0.02, 3000.0, 0.02, 0.03])
    mass = rng.uniform(-0.05, 0.05, (3, 20, 1))

    def remainder(scale):
        exact = error_map(
            plane, nominal, beats, CHART, scale * direction, increment=scale * push, parameters=1 + scale * mass
        )
        points = np.concatenate([scale * direction, scale * push, scale * mass], axis=-1)
        return np.linalg.norm((exact - polynomial(points)) / HALF_WIDTHS)

    ratio = remainder(0.5) / remainder(0.25)
    assert 2 ** (order + 1) * 0.8 < ratio < 2 ** (order + 1) * 1.4
    assert remainder(0.25) < 0.25 * np.linalg.norm(direction / HALF_WIDTHS) * 0.05


def test_polynomials_of_a_half_are_those_of_the_whole_with_the_rest_at_zero():
    plane, nominal = aircraft("smooth"), table2(3, "smooth")
    half = taylor_map(plane, nominal, [1], CHART, order=2, errors=(4, 5, 6, 7), increments=(2, 3))
    whole = taylor_map(plane, nominal, [1], CHART, order=2)
    rng = np.random.default_rng(3)
    points = rng.uniform(-1, 1, (1, 10, 6)) * [*HALF_WIDTHS[4:], 0.01, 0.01]
    full = np.zeros((1, 10, 12))
    full[..., [4, 5, 6, 7, 10, 11]] = points
    np.testing.assert_allclose(half(points), whole(full), rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize("interpolation", ["linear", "smooth"])
def test_linearisation_agrees_with_differences(interpolation):
    plane, nominal = aircraft(interpolation), table2(4, interpolation)
    linear = linearise(plane, nominal, CHART)
    h = 1e-5 * HALF_WIDTHS
    beats = np.arange(4)
    ends = error_map(plane, nominal, beats, CHART, np.broadcast_to(np.diag(h), (4, 8, 8)))
    starts = error_map(plane, nominal, beats, CHART, np.broadcast_to(-np.diag(h), (4, 8, 8)))
    slope = np.swapaxes((ends - starts) / (2 * h[:, None]), 1, 2)
    np.testing.assert_allclose(
        linear.A / HALF_WIDTHS[:, None] * HALF_WIDTHS, slope / HALF_WIDTHS[:, None] * HALF_WIDTHS, atol=1e-6
    )
    k = np.array([1e-6, 1.0, 1e-6, 1e-6])
    still = np.zeros((4, 4, 8))
    up = error_map(plane, nominal, beats, CHART, still, increment=np.broadcast_to(np.diag(k), (4, 4, 4)))
    down = error_map(plane, nominal, beats, CHART, still, increment=np.broadcast_to(-np.diag(k), (4, 4, 4)))
    slope = np.swapaxes((up - down) / (2 * k[:, None]), 1, 2)
    unit = np.array([0.1, 1e4, 0.1, 0.1])
    np.testing.assert_allclose(linear.B * unit / HALF_WIDTHS[:, None], slope * unit / HALF_WIDTHS[:, None], atol=1e-5)
    np.testing.assert_allclose(linear.offset, 0.0, atol=1e-11)


@pytest.mark.parametrize("kind", ["relative", "euler"])
def test_slopes_are_the_linearisation(kind):
    plane, nominal, chart = aircraft(), table2(6), ErrorCoordinates(kind)
    scale = HALF_WIDTHS / HALF_WIDTHS[:, None]  # so that errors are in half-widths
    span = 0.5 * np.ptp(plane.virtual_limits(nominal.states[0], nominal.controls[0]), axis=0)
    for mass in (1.0, 0.95):
        expected = linearise(plane, nominal, chart, [mass])
        found = slopes(plane, nominal, [4, 1], chart, np.full((2, 1), mass))
        for row, beat in enumerate((4, 1)):
            np.testing.assert_allclose(found.A[row] * scale, expected.A[beat] * scale, rtol=0, atol=1e-7)
            moved = found.B[row] * span / HALF_WIDTHS[:, None]
            np.testing.assert_allclose(moved, expected.B[beat] * span / HALF_WIDTHS[:, None], rtol=0, atol=1e-6)
            np.testing.assert_allclose(found.offset[row], expected.offset[beat], rtol=0, atol=1e-12)
