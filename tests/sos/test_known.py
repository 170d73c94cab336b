"""Problems with known answers, and a share of the soak of nasty programs."""

import numpy as np
import pytest

from aerotube import sos
from tests.sos import soak
from tests.sos.programs import maximum_data, maximum_program


def motzkin(z):
    x, y, w = z.T
    return x**4 * y**2 + x**2 * y**4 + w**6 - 3 * x**2 * y**2 * w**2


def robinson(z):
    x, y, w = (z**2).T
    mixed = x**2 * y + x * y**2 + x**2 * w + x * w**2 + y**2 * w + y * w**2
    return x**3 + y**3 + w**3 - mixed + 3 * x * y * w


def choi_lam(z):
    x, y, w = (z**2).T
    return x**2 * y + y**2 * w + w**2 * x - 3 * x * y * w


@pytest.mark.parametrize("form", [motzkin, robinson, choi_lam])
def test_forms_that_are_not_sums_of_squares_are_after_a_multiplier(form):
    # All three are non-negative with zeros, and no sum of squares of their own degree 6. On the sphere a multiplier
    # |z|^2 is a higher degree, and there they are.
    bounds = []
    for degree in (6, 8):
        structure = maximum_program(sos.Sphere(3), degree)
        solution = sos.solve(structure, maximum_data(structure, lambda z: -form(z)))
        assert solution.optimal
        # Raised by its deficit, rho is a rigorous bound of -f, optimal or not.
        bounds.append(-float(solution["rho"] + solution.certificate().deficit("bound")))
    assert bounds[0] < -1e-4
    assert -1e-7 < bounds[1] <= 0.0


def test_the_largest_eigenvalue():
    rng = np.random.default_rng(5)
    matrices = rng.standard_normal((6, 7, 7))
    matrices = matrices + np.swapaxes(matrices, 1, 2)
    structure = maximum_program(sos.Sphere(7), 2)
    solution = sos.solve(structure, maximum_data(structure, lambda z: np.einsum("ui,bij,uj->bu", z, matrices, z)))
    largest = np.linalg.eigvalsh(matrices)[:, -1]
    bound = solution.certificate().bound
    assert np.all(bound >= largest)
    np.testing.assert_allclose(bound, largest, rtol=1e-6)


def test_a_polynomial_on_an_interval_is_bounded_exactly():
    # Every non-negative polynomial on an interval is a weighted sum of squares (Lukacs).
    rng = np.random.default_rng(6)
    structure = maximum_program(sos.Interval(), 8)
    coefficients = rng.standard_normal((5, 9))
    solution = sos.solve(structure, maximum_data(structure, lambda z: coefficients @ (z ** np.arange(9)).T))
    for bound, c in zip(solution.certificate().bound, coefficients, strict=True):
        polynomial = np.polynomial.Polynomial(c)
        roots = polynomial.deriv().roots()
        real = roots[np.abs(roots.imag) < 1e-12].real
        candidates = np.concatenate([[-1.0, 1.0], real[np.abs(real) <= 1]])
        assert bound == pytest.approx(polynomial(candidates).max(), rel=1e-6)


def test_the_least_ellipsoid_around_points_touches_them():
    # John's theorem: the contact points carry a decomposition of the identity, which the multipliers are.
    rng = np.random.default_rng(7)
    points = rng.standard_normal((20, 2)) * [2.0, 0.7]
    program = sos.Program()
    E = program.symmetric("E", 2)
    program.logdet("volume", 2)
    program.linear("inside", 20)
    structure = program.compile()
    F = np.zeros((3, 2, 2))
    A = np.zeros((20, 3))
    for i in range(2):
        for j in range(2):
            F[E[i, j], i, j] = 1.0
            A[:, E[i, j]] += points[:, i] * points[:, j]
    solution = sos.solve(
        structure,
        structure.data(
            objective=np.zeros(3), constraints={"volume": (np.zeros((2, 2)), F), "inside": (A, np.ones(20))}
        ),
    )
    assert solution.optimal
    shape, weights = solution["E"], solution.multipliers["inside"]
    np.testing.assert_allclose(np.einsum("k,ki,kj->ij", weights, points, points), np.linalg.inv(shape), atol=1e-5)
    slack = 1 - np.einsum("ki,ij,kj->k", points, shape, points)
    assert np.all(slack > -1e-9)
    np.testing.assert_allclose(weights * slack, 0.0, atol=1e-5)


@pytest.mark.parametrize("start", range(0, 120, 20))
def test_nasty_programs(start):
    for seed in range(start, start + 20):
        soak.trial(seed)
