import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from aerotube.dynamics import ErrorCoordinates
from aerotube.errors import ComputationError, InputError
from aerotube.tube import cost_to_go, riccati, tracking_weights


def plant(rng, beats, n=4, m=2):
    A = np.eye(n) + 0.2 * rng.normal(size=(beats, n, n))
    return A, rng.normal(size=(beats, n, m))


def closed_loop_cost(A, B, Q, R, gain, x, nu):
    """Cost of flying, by simulation; noise counted as the recursion's source says."""
    cost = x @ Q[0] @ x
    for t in range(len(A)):
        u = gain[t] @ x
        x = A[t] @ x + B[t] @ u
        cost += u @ R[t] @ u + x @ Q[t + 1] @ x
    return cost


def test_cost_to_go_is_the_cost_of_flying_its_own_gains():
    rng = np.random.default_rng(0)
    A, B = plant(rng, 7)
    Q = np.broadcast_to(np.eye(4), (8, 4, 4))
    R = np.broadcast_to(0.3 * np.eye(2), (7, 2, 2))
    cost, gain = cost_to_go(A, B, Q, R)
    for x in rng.normal(size=(5, 4)):
        assert closed_loop_cost(A, B, Q, R, gain, x, 0.0) == pytest.approx(x @ cost[0] @ x, rel=1e-10)
        worse = gain + 0.1 * rng.normal(size=gain.shape)
        assert closed_loop_cost(A, B, Q, R, worse, x, 0.0) > x @ cost[0] @ x


def test_recursion_tends_to_the_stationary_solution():
    rng = np.random.default_rng(1)
    A, B = plant(rng, 1)
    A, B = np.repeat(A, 300, 0), np.repeat(B, 300, 0)
    Q, R = np.eye(4), 0.5 * np.eye(2)
    cost, _ = cost_to_go(A, B, np.repeat(Q[None], 301, 0), np.repeat(R[None], 300, 0))
    stationary = solve_discrete_are(A[0], B[0], Q, R)
    np.testing.assert_allclose(cost[0], stationary, rtol=1e-8)
    np.testing.assert_allclose(riccati(A[:1], B[:1], Q[None], R[None])[0], stationary, rtol=1e-12)


def test_riccati_of_many_beats_is_that_of_each():
    """By another method, on plants of the sizes and units that occur, unstable ones too."""
    rng = np.random.default_rng(4)
    A, B = plant(rng, 30)
    A[:10] *= 1.5
    unit = np.array([100.0, 0.01, 0.02, 0.03])
    A, B = A * unit[:, None] / unit, B * unit[:, None] * [1.0, 1e-4]
    Q = np.repeat(np.diag(unit**-2.0)[None], 30, 0)
    R = np.repeat(np.diag([1e-3, 1e-12])[None], 30, 0)
    found = riccati(A, B, Q, R)
    for beat in range(30):
        expected = solve_discrete_are(A[beat], B[beat], Q[beat], R[beat])
        assert found[beat] * np.outer(unit, unit) == pytest.approx(expected * np.outer(unit, unit), rel=1e-6, abs=1e-8)


def test_a_beat_that_cannot_be_stabilised_is_named():
    A = np.stack([np.diag([0.5, 0.5]), np.diag([0.5, 2.0])])
    B = np.repeat(np.array([[1.0], [0.0]])[None], 2, 0)
    weights = np.repeat(np.eye(2)[None], 2, 0)
    with pytest.raises(ComputationError, match="beat 1 has no stabilising solution"):
        riccati(A, B, weights, weights[:, :1, :1])


def test_noise_weight_is_the_price_of_noise_fed_back():
    """With noise of covariance nu S on the measurement, E[cost] grows by tr(K'B'PBK nu S): the gain minimises
    the sum for x with covariance S."""
    rng = np.random.default_rng(2)
    A, B = plant(rng, 1)
    Q, R, nu = np.repeat(np.eye(4)[None], 2, 0), 0.1 * np.eye(2)[None], 1.5
    _, gain = cost_to_go(A, B, Q, R, nu)

    def expected(k):
        closed = A[0] + B[0] @ k
        effort = k.T @ (R[0] + nu * B[0].T @ Q[1] @ B[0]) @ k
        return np.trace(closed.T @ Q[1] @ closed + effort)

    best = expected(gain[0])
    for _ in range(20):
        assert expected(gain[0] + 0.05 * rng.normal(size=(2, 4))) > best


def test_tracking_weights_give_the_square_of_the_metric():
    from tests.dynamics.test_errors import full_state

    nominal = full_state(roll=0.3, pitch=-0.7)
    error = np.array([3.0, *np.radians([0.4, -0.2, 0.5, 0.1, 0.7, -0.3, 0.6])]) * 1e-3
    metric = np.sqrt(((error[0] / 100) ** 2 + (np.degrees(error[1:]) ** 2).sum()) / 8)
    state = ErrorCoordinates("euler").retract(nominal, error)
    for kind in ("euler", "relative"):
        chart = ErrorCoordinates(kind)
        x = chart.difference(state, nominal)
        assert np.sqrt(x @ tracking_weights(nominal, chart) @ x) == pytest.approx(metric, rel=1e-4)


def test_negative_noise_weight_is_refused():
    with pytest.raises(InputError, match="noise weight"):
        cost_to_go(np.eye(2)[None], np.eye(2)[None], np.eye(2)[None].repeat(2, 0), np.eye(2)[None], -1.0)
