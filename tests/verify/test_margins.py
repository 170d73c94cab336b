"""Disk margins against loops solved by hand, published examples and brute force."""

import numpy as np
import pytest
from scipy.linalg import expm

from aerotube.compensation import LinearLaw
from aerotube.dynamics import ErrorCoordinates
from aerotube.errors import InputError
from aerotube.verify import gain_margin, linear_part, margins, phase_margin


def held(a, b, dt):
    """Zero-order hold of a continuous loop, exactly."""
    n, m = b.shape
    both = expm(dt * np.block([[a, b], [np.zeros((m, n + m))]]))
    return both[:n, :n], both[:n, n:]


def one(a, b, k, dt=1.0):
    return margins(np.array(a, float)[None], np.array(b, float)[None], np.array(k, float)[None], dt)


SATELLITE = np.array([[0.0, 10.0], [-10.0, 0.0]]), np.eye(2), np.array([[1.0, 10.0], [-10.0, 1.0]])


@pytest.mark.parametrize(("a", "k"), [(0.9, 0.5), (0.5, 0.2), (1.1, 0.4), (-0.4, 0.3)])
def test_first_order_loop_by_hand(a, k):
    """``|S - 1/2| = |z - a - k| / (2 |z - a + k|)`` is largest at z = 1 or z = -1."""
    found = one([[a]], [[1.0]], [[-k]])
    expected = 2.0 / max(abs(z - a - k) / abs(z - a + k) for z in (1.0, -1.0))
    assert found.disk[0, 0] == pytest.approx(expected, rel=1e-6)
    assert found.disk_all[0] == pytest.approx(expected, rel=1e-6)
    assert found.radius[0] == pytest.approx(abs(a - k))


def test_delay_of_a_first_order_loop_by_hand():
    """The gain ``k / |z - a|`` is one where ``cos theta = (1 + a^2 - k^2) / 2a``."""
    a, k, dt = 0.9, 0.5, 0.05
    theta = np.arccos((1 + a * a - k * k) / (2 * a))
    lag = np.angle(np.exp(1j * theta) - a)
    found = one([[a]], [[1.0]], [[-k]], dt)
    assert found.delay[0, 0] == pytest.approx((np.pi - lag) / theta * dt, rel=1e-5)
    assert 0 < found.delay_all[0] <= found.delay[0, 0]


def test_published_third_order_example():
    """25 / (s^3 + 10 s^2 + 10 s + 10): 0.46, 4.05 dB, 25.8 deg at 1.94 rad/s (Seiler et al.; python-control)."""
    a = np.array([[-10.0, -10.0, -10.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    dt = 1e-4
    found = one(*held(a, np.array([[1.0], [0.0], [0.0]]), dt), [[0.0, 0.0, -25.0]], dt)
    assert found.disk[0, 0] == pytest.approx(0.46, abs=0.005)
    assert 20 * np.log10(gain_margin(found.disk)[1][0, 0]) == pytest.approx(4.05, abs=0.01)
    assert np.degrees(phase_margin(found.disk))[0, 0] == pytest.approx(25.8, abs=0.05)
    assert found.frequency[0, 0] == pytest.approx(1.94, abs=0.03)


def test_spinning_satellite():
    """Each loop alone is 1/s, with all the margin there is; together they have 2 / (a + sqrt(1 + a^2)), by hand."""
    a, b, c = SATELLITE
    dt = 1e-4
    found = one(*held(a, b, dt), -c, dt)
    assert found.disk[0] == pytest.approx([2.0, 2.0], rel=1e-3)
    assert found.disk_all[0] == pytest.approx(2.0 / (10.0 + np.sqrt(101.0)), rel=1e-3)


def test_published_satellite_with_a_controller():
    """0.3754, 3.3 dB, 21.26 deg, at low frequency (python-control's tests, by SLICOT)."""
    a, b, c = SATELLITE
    dt = 1e-4
    found = one(*held(a, b, dt), -np.array([[1.0, -2.0], [0.0, 1.0]]) @ c, dt)
    assert found.disk_all[0] == pytest.approx(0.3754, rel=5e-3)
    assert 20 * np.log10(gain_margin(found.disk_all)[1][0]) == pytest.approx(3.3, abs=0.05)
    assert np.degrees(phase_margin(found.disk_all))[0] == pytest.approx(21.26, abs=0.1)
    assert found.frequency_all[0] < 0.1


def random_loops(count, n=4, m=3, seed=1):
    """Random stable loops, controls in units that differ by a factor of a million."""
    random = np.random.default_rng(seed)
    closed = random.normal(size=(count, n, n))
    closed *= (0.9 / np.abs(np.linalg.eigvals(closed)).max(1))[:, None, None]
    b, k = random.normal(size=(count, n, m)), 0.3 * random.normal(size=(count, m, n))
    units = np.array([1.0, 1e4, 1e-2])
    b, k = b / units, k * units[:, None]
    return closed - b @ k, b, k


def sensitivity(a, b, k, theta):
    z = np.exp(1j * theta)
    return np.linalg.inv(np.eye(k.shape[0]) - k @ np.linalg.solve(z * np.eye(len(a)) - a, b))


def test_margins_against_brute_force():
    """The structured singular value is the largest spectral radius over phases; peaks over a fine grid."""
    a, b, k = random_loops(4)
    found = margins(a, b, k, 1.0)
    grid = np.linspace(0, np.pi, 2001)
    phases = np.exp(2j * np.pi * np.stack(np.meshgrid(*[np.arange(24) / 24] * 2), -1).reshape(-1, 2))
    turns = np.concatenate([np.ones((len(phases), 1)), phases], axis=1)
    for t in range(len(a)):
        S = np.stack([sensitivity(a[t], b[t], k[t], theta) for theta in grid])
        single = np.abs(np.diagonal(S, axis1=1, axis2=2) - 0.5).max(0)
        np.testing.assert_allclose(found.disk[t], 1 / single, rtol=1e-4)
        units = np.abs(k[t]).max(1)
        M = (sensitivity(a[t], b[t], k[t], found.frequency_all[t]) - 0.5 * np.eye(3)) / units[:, None] * units
        radius = np.abs(np.linalg.eigvals(M * turns[:, None, :])).max()
        # the bound of mu is above what the phases reach, and for three factors the two meet
        assert 1 / found.disk_all[t] >= radius * (1 - 1e-9)
        assert 1 / found.disk_all[t] == pytest.approx(radius, rel=0.03)


def test_factors_in_the_disk_do_no_harm_and_one_on_its_edge_does():
    a, b, k = random_loops(6, seed=3)
    found = margins(a, b, k, 1.0)
    random = np.random.default_rng(0)
    for t in range(len(a)):
        delta = found.disk_all[t] * random.uniform(0, 1, (300, 3)) * np.exp(2j * np.pi * random.random((300, 3)))
        factor = (1 + 0.5 * delta) / (1 - 0.5 * delta)
        closed = a[t] + (b[t] * factor[:, None, :]) @ k[t]
        assert np.abs(np.linalg.eigvals(closed)).max() < 1
        for i in range(3):
            point = sensitivity(a[t], b[t], k[t], found.frequency[t, i])[i, i] - 0.5
            # 1 - delta (S - 1/2) = 0 there: a complex factor in this loop alone puts a pole on the circle
            edge = 1 / point
            assert abs(edge) == pytest.approx(found.disk[t, i], rel=1e-4)
            one_factor = np.ones(3, complex)
            one_factor[i] = (1 + 0.5 * edge) / (1 - 0.5 * edge)
            poles = np.linalg.eigvals(a[t] + (b[t] * one_factor) @ k[t])
            assert np.abs(np.abs(poles) - 1).min() < 1e-6


def delayed(a, b, k, beats):
    """The loop with each control so many beats late (a tuple of whole numbers)."""
    n, m = b.shape
    depth = max(beats)
    size = n * (depth + 1)
    big = np.zeros((size, size))
    big[:n, :n] = a
    for i in range(m):
        at = n * beats[i]
        big[:n, at : at + n] += np.outer(b[:, i], k[i])
    big[n:, :-n] = np.eye(n * depth)
    return np.abs(np.linalg.eigvals(big)).max()


def test_whole_beats_of_delay_do_harm_exactly_beyond_the_margin():
    a, b, k = random_loops(24, seed=5)
    k = k * 0.5
    found = margins(a, b, k, 1.0)
    seen = 0
    for t in np.flatnonzero(found.stable):
        for i in range(3):
            for late in range(1, 5):
                stable = delayed(a[t], b[t], k[t], tuple(late * (j == i) for j in range(3))) < 1
                if late < found.delay[t, i]:
                    assert stable
                elif late - 1 < found.delay[t, i]:
                    assert not stable
                    seen += 1
        every = int(min(np.floor(found.delay_all[t] * 0.999), 4))
        if every:
            for late in np.ndindex(*(every + 1,) * 3):
                assert max(late) == 0 or delayed(a[t], b[t], k[t], late) < 1
    assert seen > 5


def test_an_unstable_loop_has_no_margin():
    found = one([[1.5]], [[1.0]], [[-0.1]])
    assert not found.stable[0]
    assert found.disk[0, 0] == found.disk_all[0] == found.delay[0, 0] == found.delay_all[0] == 0.0


def test_a_control_that_is_not_used_has_the_whole_margin():
    found = one([[0.5]], [[1.0, 1.0]], [[-0.2], [0.0]])
    assert found.disk[0, 1] == pytest.approx(2.0)
    assert found.delay[0, 1] == np.inf
    assert found.disk_all[0] == pytest.approx(found.disk[0, 0], rel=1e-6)


def test_units_of_states_and_controls_do_not_matter():
    a, b, k = random_loops(3, seed=7)
    x, u = np.array([1.0, 1e3, 1e-3, 10.0]), np.array([1e-4, 1.0, 1e5])
    other = margins(a * x[:, None] / x, b * x[:, None] / u, k * u[:, None] / x, 1.0)
    found = margins(a, b, k, 1.0)
    np.testing.assert_allclose(other.disk, found.disk, rtol=1e-6)
    np.testing.assert_allclose(other.disk_all, found.disk_all, rtol=1e-2)


def test_gain_and_phase_of_a_disk():
    low, high = gain_margin(np.array([0.0, 2 / 3, 2.0, 5.0]))
    np.testing.assert_allclose(low, [1, 0.5, 0, 0])
    np.testing.assert_allclose(high, [1, 2, np.inf, np.inf])
    np.testing.assert_allclose(phase_margin(np.array([0.0, 2.0])), [0, np.pi / 2])


def test_the_linear_part_of_any_law():
    class Cubic:
        coordinates = ErrorCoordinates()

        def increment(self, beat, error):
            return error @ gains[beat].T + 3.0 * (error @ gains[beat].T) ** 3

    gains = np.random.default_rng(2).normal(size=(2, 4, 8))
    np.testing.assert_allclose(linear_part(Cubic(), 2), gains, rtol=1e-6)
    np.testing.assert_array_equal(linear_part(LinearLaw(gains, ErrorCoordinates()), 2), gains)


def test_what_is_no_loop_is_refused():
    with pytest.raises(InputError, match="do not make a loop"):
        margins(np.zeros((1, 2, 2)), np.zeros((1, 2, 1)), np.zeros((1, 2, 2)), 0.1)
    with pytest.raises(InputError, match="not finite"):
        one([[np.nan]], [[1.0]], [[0.0]])
