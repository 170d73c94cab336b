import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from aerotube.dynamics import ErrorCoordinates, Linearisation, linearise
from aerotube.errors import InputError
from aerotube.flight import METRIC_SCALE, best_lqr, draw, extended_kalman_filter, simulate, time_varying_lqr
from aerotube.nominal import Nominal

EULER = ErrorCoordinates("euler")


@pytest.fixture(scope="module")
def linear(table2):
    return linearise(table2.aircraft, table2.nominal, EULER)


def test_far_from_the_end_the_gain_is_the_stationary_one(table2, linear):
    beats = 3000
    frozen = Nominal(0.05, np.tile(table2.nominal.states[30], (beats + 1, 1)), np.tile(table2.control, (beats, 1)))
    a, b = linear.A[30], linear.B[30]
    repeated = Linearisation(np.tile(a, (beats, 1, 1)), np.tile(b, (beats, 1, 1)), np.zeros((beats, 8)))
    law = time_varying_lqr(table2.aircraft, frozen, repeated, EULER, control_weight=0.1)
    lower, upper = table2.aircraft.virtual_limits(table2.nominal.states[30], table2.control)
    half = (upper - lower) / 2
    weight = 0.1 * np.eye(4)
    scaled = b * half
    cost = solve_discrete_are(a, scaled, np.diag(METRIC_SCALE**2 / 8), weight)
    gain = -half[:, None] * np.linalg.solve(weight + scaled.T @ cost @ scaled, scaled.T @ cost @ a)
    np.testing.assert_allclose(law.gains[0], gain, rtol=1e-5, atol=1e-7 * np.abs(gain).max())


def expected_cost(table2, linear, gains, control_weight, noise_weight):
    """Cost along the nominal of a linear law whose measurements have noise in proportion to the error."""
    lower, upper = table2.aircraft.virtual_limits(table2.nominal.states[:-1], table2.nominal.controls)
    weight = np.diag(METRIC_SCALE**2 / 8)
    moment, cost = np.diag(table2.box**2 / 3), 0.0
    for t, (a, b, k) in enumerate(zip(linear.A, linear.B, gains, strict=True)):
        used = k / ((upper - lower)[t, :, None] / 2)
        cost += np.trace(weight @ moment) + control_weight * np.trace(used @ moment @ used.T)
        moment = (a + b @ k) @ moment @ (a + b @ k).T + noise_weight * b @ k @ moment @ k.T @ b.T
    return cost + np.trace(weight @ moment)


@pytest.mark.parametrize(("control_weight", "noise_weight"), [(1e-3, 0.0), (0.1, 0.0), (1e-2, 1.0), (1e-2, 4.0)])
def test_no_other_gains_cost_less(table2, linear, control_weight, noise_weight):
    law = time_varying_lqr(table2.aircraft, table2.nominal, linear, EULER, control_weight, noise_weight)
    least = expected_cost(table2, linear, law.gains, control_weight, noise_weight)
    rng = np.random.default_rng(0)
    for _ in range(20):
        other = law.gains * (1 + 0.05 * rng.standard_normal(law.gains.shape))
        assert expected_cost(table2, linear, other, control_weight, noise_weight) > least
    for factor in (0.9, 1.1):
        assert expected_cost(table2, linear, factor * law.gains, control_weight, noise_weight) > least
    assert expected_cost(table2, linear, 0 * law.gains, control_weight, noise_weight) > 1.5 * least


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_the_sweep_keeps_the_best(table2, linear, noise):
    draws = draw(table2.box, [3, 4, 5, 6], 20, mass_error=0.05)
    sweep = best_lqr(
        table2.aircraft,
        table2.nominal,
        linear,
        EULER,
        draws,
        noise=noise,
        control_weights=(1e-2, 1.0),
        noise_weights=(0.0, 4.0),
        seeds=2,
        substeps=2,
    )
    assert sweep.seeds == (3, 4)
    alone = np.empty((2, 2))
    for i, control_weight in enumerate((1e-2, 1.0)):
        for j, noise_weight in enumerate((0.0, 4.0)):
            law = time_varying_lqr(table2.aircraft, table2.nominal, linear, EULER, control_weight, noise_weight)
            some = draw(table2.box, [3, 4], 20, mass_error=0.05)
            flights = simulate(table2.aircraft, table2.nominal, law, some, noise=noise, substeps=2)
            alone[i, j] = flights.mean_upper_error().mean()
    np.testing.assert_allclose(sweep.scores, alone, rtol=1e-9)
    i, j = np.unravel_index(np.argmin(alone), (2, 2))
    assert (sweep.control_weight, sweep.noise_weight) == ((1e-2, 1.0)[i], (0.0, 4.0)[j])


def test_the_baseline_is_hard_to_beat_and_the_filter_helps_it(table2, linear):
    draws = draw(table2.box, range(5), 100, mass_error=0.05)
    estimator = extended_kalman_filter(table2.aircraft, table2.nominal, table2.box, 1.0, mass_error=0.05)
    none = simulate(table2.aircraft, table2.nominal, None, draws).mean_upper_error().mean()

    def error(noise, estimator):
        arguments = (table2.aircraft, table2.nominal)
        sweep = {"control_weights": (1e-3, 1e-2), "noise_weights": (0.0, 4.0), "seeds": 1}
        law = best_lqr(*arguments, linear, EULER, draws, noise=noise, estimator=estimator, **sweep).law
        flights = simulate(*arguments, law, draws, noise=noise, estimator=estimator)
        assert not flights.diverged
        return flights.mean_upper_error().mean()

    calm, noisy, filtered = error(0.0, None), error(1.0, None), error(1.0, estimator)
    # Prototypes of the same regulator on the same aircraft: 0.33 of 1.27 without noise, 0.77 with it.
    assert calm < 0.34 / 1.27 * none
    assert noisy < 0.77 / 1.27 * none
    assert calm < filtered < 0.7 * noisy


def test_mistakes_are_named(table2, linear):
    for options, words in (({"control_weight": 0.0}, "control weight"), ({"noise_weight": -1.0}, "noise weight")):
        with pytest.raises(InputError, match=words):
            time_varying_lqr(table2.aircraft, table2.nominal, linear, EULER, **options)
    draws = draw(table2.box, [0], 1)
    for options, words in (({"control_weights": ()}, "empty"), ({"seeds": 0}, "at least one seed")):
        with pytest.raises(InputError, match=words):
            best_lqr(table2.aircraft, table2.nominal, linear, EULER, draws, **options)
