import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aerotube.tube import ellipsoid


def random_shape(rng, n):
    a = rng.normal(size=(n, n))
    return a @ a.T + 0.1 * np.eye(n)


@given(st.integers(0, 10_000), st.integers(1, 6))
def test_least_size_is_attained_at_a_vertex_of_the_box(seed, n):
    rng = np.random.default_rng(seed)
    shape, widths = random_shape(rng, n), rng.uniform(0.1, 3.0, n)
    rho = ellipsoid.least_size_around_box(shape, widths)
    vertices = widths * np.array(np.meshgrid(*[[-1, 1]] * n)).reshape(n, -1).T
    values = np.einsum("vi,ij,vj->v", vertices, shape, vertices)
    assert rho == pytest.approx(values.max(), rel=1e-12)
    inside = widths * rng.uniform(-1, 1, (200, n))
    assert (np.einsum("vi,ij,vj->v", inside, shape, inside) <= rho * (1 + 1e-12)).all()


@given(st.integers(0, 10_000), st.integers(2, 5))
def test_no_ellipsoid_around_the_box_has_less_volume(seed, n):
    rng = np.random.default_rng(seed)
    widths = rng.uniform(0.1, 3.0, n)
    shape, rho = ellipsoid.least_volume_around_box(widths)
    assert ellipsoid.least_size_around_box(shape, widths) == pytest.approx(rho)

    def log_volume(e, size):
        return 0.5 * (n * np.log(size) - np.linalg.slogdet(e)[1])

    other = np.diag(1 / widths) @ random_shape(rng, n) @ np.diag(1 / widths)
    size = ellipsoid.least_size_around_box(other, widths)
    assert log_volume(other, size) >= log_volume(shape, rho) - 1e-9


@given(st.integers(0, 10_000), st.integers(1, 6))
def test_whitening_maps_the_sphere_onto_the_boundary(seed, n):
    rng = np.random.default_rng(seed)
    shape, rho = random_shape(rng, n), rng.uniform(0.1, 5.0)
    z = rng.normal(size=(50, n))
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    x = z @ ellipsoid.whitening(shape, rho).T
    np.testing.assert_allclose(np.einsum("vi,ij,vj->v", x, shape, x), rho, rtol=1e-9)


def test_root_squares_back():
    shape = random_shape(np.random.default_rng(1), 5)
    np.testing.assert_allclose(ellipsoid.root(shape) @ ellipsoid.root(shape), shape, atol=1e-12)


def test_half_widths_and_projection_agree_with_many_boundary_points():
    rng = np.random.default_rng(2)
    shape, rho = random_shape(rng, 3), 2.0
    z = rng.normal(size=(400_000, 3))
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    x = z @ ellipsoid.whitening(shape, np.array(rho)).T
    np.testing.assert_allclose(np.abs(x).max(0), ellipsoid.half_widths(shape, np.array(rho)), rtol=1e-3)
    plane = ellipsoid.projection(shape, (2, 0))
    values = np.einsum("vi,ij,vj->v", x[:, [2, 0]], plane, x[:, [2, 0]])
    assert values.max() <= rho * (1 + 1e-12)
    assert values.max() == pytest.approx(rho, rel=1e-4)
    edge = ellipsoid.boundary(plane, np.array(rho))
    np.testing.assert_allclose(np.einsum("vi,ij,vj->v", edge, plane, edge), rho, rtol=1e-9)
