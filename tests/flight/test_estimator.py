import numpy as np
import pytest

from aerotube.dynamics import ErrorCoordinates, step
from aerotube.errors import InputError
from aerotube.flight import Dryden, draw, extended_kalman_filter

EULER = ErrorCoordinates("euler")
RUNS = 1000


def follow(table2, estimator, noise, gusts=None):
    """Errors of the estimate (run, beat, ...) and of the measurement, along uncompensated flights."""
    nominal, aircraft = table2.nominal, table2.aircraft
    draws = draw(table2.box, [21], RUNS, mass_error=0.05)
    sensor = noise * draws.measurement_noise(nominal.beats)
    wind = np.zeros((RUNS, nominal.beats, 6))
    if gusts is not None:
        wind = gusts.sample(draws.gust_noise(nominal.beats, 8), nominal.dt)
    state = EULER.retract(nominal.states[0], draws.initial_error)
    estimate = estimator.start(RUNS)
    estimated, measured, blown = [], [], []
    for beat in range(nominal.beats):
        reference = nominal.states[beat]
        true = estimator.coordinates.difference(state, reference)
        seen = estimator.coordinates.difference(EULER.retract(state, sensor[:, beat]), reference)
        estimate = estimator.correct(beat, estimate, seen)
        estimated.append(np.concatenate([estimate.error - true, estimate.parameters - draws.parameters], axis=1))
        measured.append(seen - true)
        blown.append(estimate.gust @ estimator.gusts.output.T - wind[:, beat])
        control = np.tile(nominal.controls[beat], (RUNS, 1))
        state = step(aircraft, state, control, nominal.dt, parameters=draws.parameters, wind=wind[:, beat])
        estimate = estimator.predict(beat, estimate, control)
    return np.stack(estimated, 1), np.stack(measured, 1), np.stack(blown, 1)


def believed(estimator, size=9):
    return estimator.covariances[:, :size, :size]


def normalised(errors, covariances):
    return np.einsum("rti,tij,rtj->rt", errors, np.linalg.inv(covariances), errors).mean(axis=0)


@pytest.fixture(scope="module")
def calm(table2):
    estimator = extended_kalman_filter(table2.aircraft, table2.nominal, table2.box, 1.0, mass_error=0.05)
    return estimator, *follow(table2, estimator, 1.0)[:2]


def test_the_filter_is_consistent(calm):
    estimator, errors, _ = calm
    # The normalised square of a consistent filter's error has mean 9; the spread of a mean over the runs is
    # sqrt(2 * 9 / 1000) = 0.13. Linear at first; later the curvature of the model may show, within a tenth or two.
    squares = normalised(errors, believed(estimator))
    assert np.all(np.abs(squares[:20] - 9) < 5 * 0.13)
    assert np.all((squares > 7.2) & (squares < 12))
    deviations = np.sqrt((errors**2).mean(axis=0) / np.einsum("tii->ti", believed(estimator)))
    # Each component by itself: a deviation from 1000 runs is known to 2.2 per cent.
    assert np.all(np.abs(deviations - 1) < 0.12)


def test_the_filter_is_better_than_its_sensor_and_gets_better(calm):
    _, errors, sensor = calm
    share = (errors[:, :, :8] ** 2).mean(axis=0) / (sensor**2).mean(axis=0)
    assert np.all(share[0] < 0.6)
    assert np.all(share[-1] < 0.05)
    mass = errors[:, :, 8].std(axis=0)
    assert mass[0] == pytest.approx(0.05 / np.sqrt(3), rel=0.1)
    assert mass[-1] < 0.2 * mass[0]


def test_equal_prior_and_sensor_share_the_first_correction(table2):
    estimator = extended_kalman_filter(table2.aircraft, table2.nominal, table2.box, 1.0, coordinates=EULER)
    np.testing.assert_allclose(estimator.gains[0, :8], 0.5 * np.eye(8), atol=1e-9)
    np.testing.assert_allclose(np.diag(estimator.covariances[0])[:8], table2.box**2 / 6, rtol=1e-6)


def test_coordinates_do_not_matter_to_what_is_estimated(table2, calm):
    relative, errors, _ = calm
    euler = extended_kalman_filter(table2.aircraft, table2.nominal, table2.box, 1.0, mass_error=0.05, coordinates=EULER)
    other = follow(table2, euler, 1.0)[0]
    same = [0, 1, 2, 4, 5, 6, 8]
    deviation = errors[:, :, same].std(axis=0)
    assert np.all(np.abs((errors - other)[:, :, same]).max(axis=0) < 0.15 * deviation)
    np.testing.assert_allclose(
        np.diagonal(believed(relative), axis1=1, axis2=2)[:, same],
        np.diagonal(believed(euler), axis1=1, axis2=2)[:, same],
        rtol=0.01,
    )


def test_a_perfect_sensor_is_believed(table2):
    estimator = extended_kalman_filter(table2.aircraft, table2.nominal, table2.box, 0.0, mass_error=0.05)
    np.testing.assert_allclose(estimator.gains[:, :8], np.broadcast_to(np.eye(8), (60, 8, 8)), atol=0.02)


def test_gusts_are_reckoned_with(table2):
    gusts = Dryden("light", 3000, 185, 9.144)
    aware = extended_kalman_filter(table2.aircraft, table2.nominal, table2.box, 1.0, mass_error=0.05, gusts=gusts)
    unaware = extended_kalman_filter(table2.aircraft, table2.nominal, table2.box, 1.0, mass_error=0.05)
    errors, sensor, wind = follow(table2, aware, 1.0, gusts)
    squares = normalised(errors, believed(aware))
    assert np.all((squares > 7.2) & (squares < 12))
    naive = follow(table2, unaware, 1.0, gusts)[0]
    mean_square = [(e[:, 20:, :8] ** 2).mean(axis=(0, 1)) / table2.box**2 for e in (errors, naive)]
    assert mean_square[0].sum() < 0.5 * mean_square[1].sum()
    assert np.all((errors[:, 20:, :8] ** 2).mean(axis=0) < (sensor[:, 20:] ** 2).mean(axis=0))
    # The side and vertical gusts show in sideslip and attack; what is left of them is less than what blew.
    left = (wind[:, 20:, 1:3] ** 2).mean(axis=(0, 1))
    assert np.all(left < 0.5 * gusts.intensity[1:] ** 2)


def test_mistakes_are_named(table2):
    with pytest.raises(InputError, match="noise"):
        extended_kalman_filter(table2.aircraft, table2.nominal, table2.box, -1.0)
    with pytest.raises(InputError, match="2 uncertain parameters given, the model has 1"):
        extended_kalman_filter(table2.aircraft, table2.nominal, table2.box, 1.0, other_parameters=[(0.0, 1.0)])
