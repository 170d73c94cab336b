import numpy as np
import pytest

from aerotube.compensation import COUPLED, DECOUPLED
from aerotube.compensation.forecast import forecast
from aerotube.dynamics import Linearisation

BEATS = 6


def problem(seed, coupled=True):
    rng = np.random.default_rng(seed)
    A = np.eye(8) + 0.15 * rng.normal(size=(BEATS, 8, 8))
    B = rng.normal(size=(BEATS, 8, 4))
    if not coupled:
        A[:, :4, 4:] = A[:, 4:, :4] = B[:, :4, 2:] = B[:, 4:, :2] = 0.0
    linear = Linearisation(A, B, 0.05 * rng.normal(size=(BEATS, 8)))
    weights = np.broadcast_to(np.diag(rng.uniform(0.5, 2.0, 8)), (BEATS + 1, 8, 8))
    effort = np.broadcast_to(0.3 * np.eye(4), (BEATS, 4, 4))
    widths = np.broadcast_to(rng.uniform(0.5, 2.0, 8), (BEATS, 8))
    effects = 0.1 * rng.normal(size=(BEATS, 1, 8))
    return linear, weights, effort, widths, effects


def test_moments_are_those_of_flying_the_law():
    """Second route: flights of the linear system, with fresh errors at every beat."""
    linear, weights, effort, widths, effects = problem(0)
    fresh = 0.1
    expected = forecast(linear, weights, effort, widths, effects, 0.5, fresh, COUPLED)
    rng = np.random.default_rng(1)
    runs = 400_000
    x = rng.uniform(-1, 1, (runs, 8)) * widths[0]
    sigma = rng.uniform(-1, 1, (runs, 1))
    for t in range(BEATS):
        state = np.concatenate([x, sigma, np.ones((runs, 1))], axis=1)
        scale = np.sqrt(np.diagonal(expected.moment[t]))
        np.testing.assert_allclose(
            state.T @ state / runs / np.outer(scale, scale), expected.moment[t] / np.outer(scale, scale), atol=0.01
        )
        noise = rng.normal(size=(runs, 8)) @ np.linalg.cholesky(expected.noise[t]).T
        u = (x + noise) @ expected.gain[t].T
        x = x @ linear.A[t].T + u @ linear.B[t].T + sigma * effects[t, 0] + linear.offset[t]
        x += np.sqrt(fresh) * rng.uniform(-1, 1, (runs, 8)) * widths[min(t + 1, BEATS - 1)]


def flown_cost(gain, linear, weights, effort, widths, effects, noise_weight, fresh):
    """Expected cost of a law, written anew: the mean of the errors' squares, beat by beat."""
    M = np.zeros((10, 10))
    M[:8, :8], M[8, 8], M[9, 9] = np.diag(widths[0] ** 2 / 3), 1 / 3, 1.0
    total = np.trace(weights[0] @ M[:8, :8])
    for t in range(BEATS):
        V = noise_weight * np.diag(widths[t] ** 2 / 3)
        F = np.eye(10)
        F[:8, :8], F[:8, 8], F[:8, 9] = linear.A[t] + linear.B[t] @ gain[t], effects[t, 0], linear.offset[t]
        total += np.trace(effort[t] @ gain[t] @ (M[:8, :8] + V) @ gain[t].T)
        M = F @ M @ F.T
        M[:8, :8] += linear.B[t] @ gain[t] @ V @ gain[t].T @ linear.B[t].T
        M[:8, :8] += fresh * np.diag(widths[min(t + 1, BEATS - 1)] ** 2 / 3)
        total += np.trace(weights[t + 1] @ M[:8, :8])
    return total


@pytest.mark.parametrize("parts", [COUPLED, DECOUPLED])
def test_the_law_is_a_stationary_point_of_the_expected_cost(parts):
    """With coupled motion, parameters and an offset, for halves that see no more than their own errors."""
    given = problem(2)
    expected = forecast(*given, 1.0, 0.05, parts, passes=300, tolerance=1e-15)

    def cost(gain):
        return flown_cost(gain, *given, 1.0, 0.05)

    rng = np.random.default_rng(3)
    free = np.zeros((4, 8))
    for part in parts:
        free[np.ix_(part.controls, part.errors)] = 1.0
    assert (expected.gain * (1 - free) == 0).all()
    for _ in range(10):
        change = rng.normal(size=expected.gain.shape) * free
        slope = (cost(expected.gain + 1e-5 * change) - cost(expected.gain - 1e-5 * change)) / 2e-5
        assert abs(slope) < 1e-5 * cost(expected.gain)
        assert cost(expected.gain + 0.3 * change) > cost(expected.gain)


def test_what_is_expected_of_the_other_half_makes_decoupled_laws_cheaper():
    given = problem(6)
    expected = forecast(*given, 1.0, 0.05, DECOUPLED)
    _, weights, effort, widths, effects = given
    apart = problem(6, coupled=False)[0]
    alone = forecast(apart, weights, effort, widths, effects, 1.0, 0.05, DECOUPLED)
    assert flown_cost(expected.gain, *given, 1.0, 0.05) < 0.999 * flown_cost(alone.gain, *given, 1.0, 0.05)


def test_without_noise_and_parameters_the_cost_is_the_regulators():
    from aerotube.tube import cost_to_go

    linear, weights, effort, widths, effects = problem(4)
    linear = Linearisation(linear.A, linear.B, 0.0 * linear.offset)
    expected = forecast(linear, weights, effort, widths, 0.0 * effects, 0.0, 0.01, COUPLED, passes=4)
    regulator, gain = cost_to_go(linear.A, linear.B, weights, effort)
    np.testing.assert_allclose(expected.cost[:, :8, :8], regulator, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(expected.gain, gain, rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("noise_weight", [0.0, 1.0])
def test_costs_and_moments_are_those_of_a_positive_form(noise_weight):
    expected = forecast(*problem(5), noise_weight, 0.01, DECOUPLED)
    assert np.linalg.eigvalsh(expected.cost[:, :8, :8]).min() > 0
    assert np.linalg.eigvalsh(expected.moment).min() > -1e-12
