"""Nodes, bases and domains."""

from math import comb

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aerotube import sos
from aerotube.sos.basis import fekete_points, monomials, orthonormal_basis, sampling

DOMAINS = [
    (sos.Sphere(2), 6),
    (sos.Sphere(4), 4),
    (sos.Ball(1), 8),
    (sos.Ball(3), 4),
    (sos.Product(sos.Sphere(3), sos.Interval()), 4),
    (sos.Product(sos.Ball(2), sos.Ball(2)), 4),
]


@pytest.mark.parametrize(
    ("domain", "degree", "nodes", "orders"),
    [
        (sos.Sphere(4), 4, 55, [14]),
        (sos.Sphere(4), 6, 140, [30]),
        (sos.Ball(4), 4, 70, [15, 5]),
        (sos.Sphere(8), 4, 450, [44]),
        (sos.Ball(8), 4, 495, [45, 9]),
    ],
)
def test_counts(domain, degree, nodes, orders):
    found = sampling(domain, degree)
    assert found.nodes.shape == (nodes, domain.dimension)
    assert [len(block.basis) for block in found.blocks] == orders


@pytest.mark.parametrize(("domain", "degree"), DOMAINS)
def test_nodes_lie_in_the_domain_and_are_unisolvent(domain, degree):
    found = sampling(domain, degree)
    assert np.all(domain.contains(found.nodes))
    assert np.linalg.cond(found.inverse) < 200
    assert all(np.linalg.cond(np.sqrt(block.weights)[:, None] * block.rows) < 3 for block in found.blocks)


@pytest.mark.parametrize(("domain", "degree"), DOMAINS)
def test_a_polynomial_is_recovered_from_its_values(domain, degree):
    found = sampling(domain, degree)
    rng = np.random.default_rng(1)
    exponents = rng.integers(0, degree + 1, (40, domain.dimension))
    exponents = exponents[exponents.sum(axis=1) <= degree]
    coefficients = rng.standard_normal(len(exponents))
    points = domain.sample(50, seed=2)
    values = monomials(found.nodes, exponents) @ coefficients
    recovered = found.basis(points) @ (found.inverse @ values)
    np.testing.assert_allclose(recovered, monomials(points, exponents) @ coefficients, atol=1e-11)


@pytest.mark.parametrize(("domain", "degree"), DOMAINS)
def test_cubature_agrees_with_a_large_sample_and_makes_the_bases_orthonormal(domain, degree):
    found = sampling(domain, degree)
    for block in found.blocks:
        gram = block.rows.T @ ((found.mean * block.weights)[:, None] * block.rows)
        np.testing.assert_allclose(gram, np.eye(len(block.basis)), atol=1e-12)
    points = domain.sample(200_000, seed=5)
    function = 1 + points[:, 0] ** 2 + points[:, -1] ** 4
    at_nodes = 1 + found.nodes[:, 0] ** 2 + found.nodes[:, -1] ** 4
    assert abs(found.mean @ at_nodes - function.mean()) < 6 * function.std() / np.sqrt(len(points))


@pytest.mark.parametrize(("domain", "degree"), DOMAINS)
def test_the_weighted_squares_of_the_bases_add_up_to_a_constant(domain, degree):
    found = sampling(domain, degree)
    points = domain.sample(100, seed=3)
    total = sum(block.weight_at(points) * np.sum(block.basis(points) ** 2, axis=1) for block in found.blocks)
    np.testing.assert_allclose(total, found.product_bound(), rtol=1e-12)


@settings(deadline=None, max_examples=30)
@given(st.integers(2, 6), st.integers(0, 5))
def test_dimension_of_the_polynomials_on_a_sphere(n, degree):
    expected = comb(n + degree - 1, n - 1) + (comb(n + degree - 2, n - 1) if degree else 0)
    assert len(orthonormal_basis(sos.Sphere(n), degree)) == expected


def test_moments_are_those_of_the_sphere():
    sphere = sos.Sphere(3)
    exponents = np.array([[0, 0, 0], [2, 0, 0], [4, 0, 0], [2, 2, 0], [1, 2, 0]])
    np.testing.assert_allclose(sphere.moments(exponents), [1, 1 / 3, 1 / 5, 1 / 15, 0])


def test_what_cannot_be_sampled_is_refused():
    with pytest.raises(ValueError, match="even"):
        sampling(sos.Sphere(3), 3)
    with pytest.raises(ValueError, match="at least 2"):
        sos.Sphere(1)
    with pytest.raises(ValueError, match="no point"):
        sampling(sos.Ball(2), 2, (sos.Polynomial([[0, 0], [2, 0]], [-2.0, 1.0]),))


@pytest.mark.parametrize(("domain", "degree"), [(sos.Sphere(4), 4), (sos.Sphere(8), 4), (sos.Ball(4), 4)])
def test_nodes_do_not_depend_on_how_a_machine_rounds(domain, degree):
    basis = orthonormal_basis(domain, degree)
    values = basis(domain.sample(4 * len(basis)))
    chosen = fekete_points(values)
    for seed in range(3):
        noise = np.random.default_rng(seed).uniform(-1, 1, values.shape)
        np.testing.assert_array_equal(fekete_points(values * (1 + 1e-14 * noise)), chosen)
