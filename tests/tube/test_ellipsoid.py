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


def log_volume(shape, rho):
    return float(ellipsoid.log_volume(shape, rho))


@given(st.integers(0, 10_000), st.integers(1, 5))
def test_support_is_where_the_boundary_reaches(seed, n):
    rng = np.random.default_rng(seed)
    shape, rho = random_shape(rng, n), rng.uniform(0.1, 5.0)
    directions = rng.normal(size=(6, n))
    reach = ellipsoid.support(shape, rho, directions)
    points = ellipsoid.sample(shape, rho, 300, rng)
    assert (points @ directions.T <= reach * (1 + 1e-9)).all()
    # attained at the point whose normal is the direction
    touching = np.linalg.solve(shape, directions.T).T * (rho / reach)[:, None]
    assert ellipsoid.contains(shape, rho, touching).all()
    assert np.einsum("di,di->d", touching, directions) == pytest.approx(reach, rel=1e-9)
    assert ellipsoid.support(shape, rho, np.eye(n)) == pytest.approx(ellipsoid.half_widths(shape, np.array(rho)))


@given(st.integers(0, 10_000), st.integers(2, 5), st.data())
def test_sections_are_what_the_plane_cuts_out(seed, n, data):
    rng = np.random.default_rng(seed)
    k = data.draw(st.integers(1, n - 1))
    held = tuple(rng.permutation(n)[:k].tolist())
    free = [i for i in range(n) if i not in held]
    shape, rho = random_shape(rng, n), rng.uniform(0.1, 5.0)
    values = 0.8 * rng.normal(size=k)
    own, left, centre = ellipsoid.section(shape, rho, held, values)
    x = np.empty((200, n))
    x[:, held], x[:, free] = values, centre + rng.normal(size=(200, n - k))
    inside = np.einsum("ui,ij,uj->u", x, shape, x) - rho
    cut = x[:, free] - centre
    found = np.einsum("ui,ij,uj->u", cut, own, cut) - left
    assert found == pytest.approx(inside, abs=1e-9 * (1 + np.abs(inside).max()))


@given(st.integers(0, 10_000), st.integers(1, 5), st.booleans())
def test_an_ellipsoid_is_held_by_the_least_size_and_no_less(seed, n, centred):
    rng = np.random.default_rng(seed)
    shape, inner, inner_rho = random_shape(rng, n), random_shape(rng, n), rng.uniform(0.1, 5.0)
    centre = None if centred else rng.normal(size=n)
    rho = ellipsoid.least_size_around_ellipsoid(shape, inner, inner_rho, centre)
    middle = np.zeros(n) if centre is None else centre
    boundary = middle + ellipsoid.sample(inner, inner_rho, 200, rng, on_boundary=True)
    values = np.einsum("ui,ij,uj->u", boundary, shape, boundary)
    assert (values <= rho * (1 + 1e-9)).all()
    # climbing from them along the boundary reaches it
    for _ in range(300):
        step = np.linalg.solve(inner, shape @ boundary.T).T
        size = np.einsum("ui,ij,uj->u", step, inner, step)
        boundary = middle + step * np.sqrt(inner_rho / size)[:, None]
    assert np.einsum("ui,ij,uj->u", boundary, shape, boundary).max() == pytest.approx(rho, rel=1e-2)
    assert ellipsoid.contains_ellipsoid(shape, rho, inner, inner_rho, centre)
    assert not ellipsoid.contains_ellipsoid(shape, 0.99 * rho, inner, inner_rho, centre)


def test_samples_are_uniform():
    """Of a uniform ball in n dimensions |z|^n is uniform, and the second moments of x are rho E^-1 / (n + 2)."""
    rng = np.random.default_rng(3)
    shape, rho, n = random_shape(rng, 4), 2.5, 4
    x = ellipsoid.sample(shape, rho, 40_000, rng)
    share = (np.einsum("ui,ij,uj->u", x, shape, x) / rho) ** (n / 2)
    assert np.quantile(share, [0.1, 0.5, 0.9]) == pytest.approx([0.1, 0.5, 0.9], abs=0.02)
    moments = x.T @ x / len(x)
    expected = rho * np.linalg.inv(shape) / (n + 2)
    size = np.sqrt(np.diag(expected))
    assert moments / np.outer(size, size) == pytest.approx(expected / np.outer(size, size), abs=0.04)
    edge = ellipsoid.sample(shape, rho, 100, rng, on_boundary=True)
    assert np.einsum("ui,ij,uj->u", edge, shape, edge) == pytest.approx(rho)


def test_volumes_are_known():
    assert np.exp(log_volume(np.eye(3), 1.0)) == pytest.approx(4 / 3 * np.pi)
    assert np.exp(log_volume(np.diag([1 / 4.0, 1 / 9.0]), 1.0)) == pytest.approx(6 * np.pi)
    rng = np.random.default_rng(4)
    shape, turn = random_shape(rng, 4), rng.normal(size=(4, 4))
    grown = log_volume(ellipsoid.image(shape, turn), 2.0) - log_volume(shape, 2.0)
    assert grown == pytest.approx(np.log(abs(np.linalg.det(turn))))


@given(st.integers(0, 10_000), st.integers(1, 4))
def test_sums_lie_in_the_minkowski_sum(seed, n):
    rng = np.random.default_rng(seed)
    first, second, (a, b) = random_shape(rng, n), random_shape(rng, n), rng.uniform(0.1, 5.0, 2)
    total = ellipsoid.minkowski_sum(first, a, second, b)
    directions = rng.normal(size=(50, n))
    reach = ellipsoid.support(first, a, directions) + ellipsoid.support(second, b, directions)
    assert (reach <= ellipsoid.support(total, 1.0, directions) * (1 + 1e-9)).all()
    # of the same shape the sum is exact
    same = ellipsoid.minkowski_sum(first, a, first, b)
    both = ellipsoid.support(first, (np.sqrt(a) + np.sqrt(b)) ** 2, directions)
    assert ellipsoid.support(same, 1.0, directions) == pytest.approx(both)
