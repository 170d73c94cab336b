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


def gains(linear, effort, expected, parts):
    out = np.zeros((BEATS, 4, 8))
    for t in range(BEATS):
        for part in parts:
            e, c = np.ix_(part.errors, part.errors), np.ix_(part.controls, part.controls)
            B = linear.B[t][np.ix_(part.errors, part.controls)]
            P, M, V = expected.cost[t + 1][e], expected.moment[t][e], expected.noise[t][e]
            regulator = np.linalg.solve(effort[t][c] + B.T @ P @ B, B.T @ P @ linear.A[t][e])
            out[t][np.ix_(part.controls, part.errors)] = -regulator @ M @ np.linalg.inv(M + V)
    return out


def test_moments_and_costs_are_those_of_flying_the_law():
    """At the fixed point, second moments and expected cost agree with flights of the linear system."""
    linear, weights, effort, widths, effects = problem(0)
    expected = forecast(linear, weights, effort, widths, effects, 0.5, COUPLED, passes=60)
    K = gains(linear, effort, expected, COUPLED)
    rng = np.random.default_rng(1)
    runs = 400_000
    x = rng.uniform(-1, 1, (runs, 8)) * widths[0]
    sigma = rng.uniform(-1, 1, (runs, 1))
    for t in range(BEATS):
        scale = np.sqrt(np.diagonal(expected.moment[t]))
        np.testing.assert_allclose(
            x.T @ x / runs / np.outer(scale, scale), expected.moment[t] / np.outer(scale, scale), atol=0.01
        )
        noise = rng.normal(size=(runs, 8)) @ np.linalg.cholesky(expected.noise[t]).T
        u = (x + noise) @ K[t].T
        x = x @ linear.A[t].T + u @ linear.B[t].T + sigma * effects[t, 0] + linear.offset[t]


def test_the_fixed_point_is_a_stationary_point_of_the_expected_cost():
    linear, weights, effort, widths, effects = problem(2, coupled=False)
    effects = 0.0 * effects
    linear = Linearisation(linear.A, linear.B, 0.0 * linear.offset)
    expected = forecast(linear, weights, effort, widths, effects, 1.0, DECOUPLED, passes=200)
    K = gains(linear, effort, expected, DECOUPLED)

    def cost(gain):
        M = np.diag(widths[0] ** 2 / 3)
        total = np.trace(weights[0] @ M)
        for t in range(BEATS):
            F = linear.A[t] + linear.B[t] @ gain[t]
            total += np.trace(effort[t] @ gain[t] @ (M + expected.noise[t]) @ gain[t].T)
            M = F @ M @ F.T + linear.B[t] @ gain[t] @ expected.noise[t] @ gain[t].T @ linear.B[t].T
            total += np.trace(weights[t + 1] @ M)
        return total

    rng = np.random.default_rng(3)
    for _ in range(10):
        change = rng.normal(size=K.shape)
        change[:, :2, 4:] = change[:, 2:, :4] = 0.0
        slope = (cost(K + 1e-5 * change) - cost(K - 1e-5 * change)) / 2e-5
        assert abs(slope) < 1e-5 * cost(K)
        assert cost(K + 0.3 * change) > cost(K)


def test_without_noise_the_cost_is_the_regulators():
    from aerotube.tube import cost_to_go

    linear, weights, effort, widths, effects = problem(4)
    expected = forecast(linear, weights, effort, widths, effects, 0.0, COUPLED, passes=2)
    regulator, _ = cost_to_go(linear.A, linear.B, weights, effort)
    np.testing.assert_allclose(expected.cost, regulator, rtol=1e-9)


@pytest.mark.parametrize("noise_weight", [0.0, 1.0])
def test_a_part_ignores_what_it_cannot_see(noise_weight):
    linear, weights, effort, widths, effects = problem(5)
    expected = forecast(linear, weights, effort, widths, effects, noise_weight, DECOUPLED)
    K = gains(linear, effort, expected, DECOUPLED)
    assert (K[:, :2, 4:] == 0).all()
    assert np.linalg.eigvalsh(expected.cost).min() > 0
    assert np.linalg.eigvalsh(expected.moment).min() > -1e-12
