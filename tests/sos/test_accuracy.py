"""Certificates of Gram matrices and decisions made to deceive them: cancelling weights, high degrees, small numbers."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aerotube import sos
from aerotube.sos.accuracy import accuracy
from aerotube.sos.basis import on_domain, sampling
from tests.sos import handmade
from tests.sos.programs import tube_data


@pytest.mark.parametrize("size", [1.0, 1e6, 1e10, 1e15])
def test_weights_that_cancel_on_the_sphere_are_taken_as_they_are_there(size):
    # On the sphere the weight is x, whatever its size: an honest certificate for the data without cancellation...
    weight = sos.Polynomial([[2, 0, 0], [0, 2, 0], [0, 0, 2], [0, 0, 0], [1, 0, 0]], [size, size, size, -size, 1.0])
    found = sampling(sos.Sphere(3), 4, (weight,))
    order, other = (len(block.basis) for block in found.blocks)
    first = np.zeros((other, other))
    first[0, 0] = 1.0
    grams = [1e-9 * np.eye(order), first + 1e-8 * np.eye(other)]
    squares = 1.0 + 1e-8 * np.sum(found.blocks[1].rows ** 2, axis=1)
    honest = found.nodes[:, 0] * squares + 1e-9 * order
    certificate = handmade.polynomial(sos.Sphere(3), 4, honest, grams, [weight]).certificate()
    assert certificate.holds
    # ... and none for values of the weight that rounding has spoilt.
    spoilt = weight(found.nodes) * squares + 1e-9 * order
    certificate = handmade.polynomial(sos.Sphere(3), 4, spoilt, grams, [weight]).certificate()
    angles = np.linspace(0.0, 2.0 * np.pi, 5000)
    edge = np.stack([np.zeros(5000), np.cos(angles), np.sin(angles)], axis=1)
    inside = sos.Sphere(3).sample(100000, seed=3)
    inside = np.concatenate([inside[inside[:, 0] >= 0.0], edge])
    assert (found.basis(inside) @ (found.inverse @ spoilt)).min() >= certificate.margins["f"]


@settings(deadline=None, max_examples=50)
@given(st.lists(st.integers(-9, 9), min_size=35, max_size=35), st.integers(0, 10**6))
def test_a_reduced_polynomial_is_the_same_function_on_the_sphere(numbers, seed):
    domain = sos.Product(sos.Sphere(3), sos.Interval())
    exponents = sos.Ball(4).exponents(3)
    polynomial = sos.Polynomial(exponents, np.array(numbers[: len(exponents)], dtype=float))
    reduced = on_domain(polynomial, domain)
    assert reduced.exponents[:, 2].max() <= 1
    points = domain.sample(20, seed=seed)
    np.testing.assert_allclose(reduced(points), polynomial(points), rtol=0.0, atol=1e-12)


def interpolant(nodes, values, z):
    total = Fraction(0)
    for i, x in enumerate(nodes):
        part = values[i]
        for j, y in enumerate(nodes):
            if j != i:
                part *= (z - y) / (x - y)
        total += part
    return total


@pytest.mark.parametrize(("degree", "least"), [(12, 1e-14), (16, 1e-13), (20, 3e-13)])
def test_margins_at_high_degree_hold_in_exact_arithmetic(degree, least):
    found = sampling(sos.Interval(), degree)
    nodes = [Fraction(float(x)) for x in found.nodes[:, 0]]
    shift = least / found.product_bound()
    for point in (-1.0, -0.97, 0.31, 0.999):
        # A square that vanishes at the point, but for its sampling, sampled exactly from the rounded rows.
        z = Fraction(point)
        p = found.blocks[0].basis(np.array([point]))
        v = np.linalg.svd(p[None, :])[2][-1]
        gram = np.outer(v, v) + shift * np.eye(len(v))
        grams = [0.5 * (gram + gram.T), shift * np.eye(len(found.blocks[1].basis))]
        values = []
        for u in range(len(nodes)):
            total = Fraction(0)
            for block, own in zip(found.blocks, grams, strict=True):
                row = [Fraction(x) for x in block.rows[u].tolist()]
                q = [[Fraction(x) for x in line] for line in own.tolist()]
                square = sum(row[i] * q[i][j] * row[j] for i in range(len(row)) for j in range(len(row)))
                total += Fraction(float(block.weights[u])) * square
            values.append(total)
        top = np.array([float(x) for x in values])
        rest = np.array([[float(x - Fraction(y))] for x, y in zip(values, top, strict=True)])
        margin = handmade.polynomial(sos.Interval(), degree, top, grams, C=rest, d=[1.0]).certificate().margins["f"]
        exact = [Fraction(a) + Fraction(b) for a, b in zip(top.tolist(), rest[:, 0].tolist(), strict=True)]
        assert interpolant(nodes, exact, z) >= Fraction(float(margin))


@pytest.mark.parametrize(("domain", "degree"), [(sos.Interval(), 28), (sos.Interval(), 60), (sos.Sphere(2), 32)])
def test_degrees_that_doubles_cannot_represent_are_refused(domain, degree):
    with pytest.raises(ValueError, match="too high for double precision"):
        sampling(domain, degree)


@pytest.mark.parametrize(
    ("domain", "degree"),
    [
        (sos.Interval(), 16),
        (sos.Sphere(3), 6),
        (sos.Ball(2), 8),
        (sos.Product(sos.Sphere(2), sos.Sphere(2)), 4),
        (sos.Product(sos.Sphere(3), sos.Interval()), 4),
    ],
)
def test_errors_of_rows_and_nodes_are_bounded(domain, degree):
    found = sampling(domain, degree)
    bounds = accuracy(found)
    rng = np.random.default_rng(0)
    for block, own in zip(found.blocks, bounds.blocks, strict=True):
        v = rng.standard_normal(len(block.basis))
        v /= np.linalg.norm(v)
        for u in range(0, len(found.nodes), 7):
            z = [Fraction(x) for x in found.nodes[u].tolist()]
            exact = sum(Fraction(a) * Fraction(b) for a, b in zip(v.tolist(), values_at(block.basis, z), strict=True))
            weight = Fraction(1)
            for factor in block.boundary:
                weight *= 1 - sum(x * x for x in z[domain.slices()[factor]])
            rounded = float(block.weights[u]) * float(v @ block.rows[u]) ** 2
            assert abs(float(weight * exact**2 - Fraction(rounded))) <= own.slip[u]
            assert float(weight * exact**2) <= own.length[u]
    points = domain.sample(2000, seed=1)
    assert np.max(np.sum(found.basis(points) ** 2, axis=1)) <= bounds.square_sum
    total = sum(
        block.weight_at(points) * np.sum(block.basis(points) ** 2, axis=1)
        for block in found.blocks
        if block.weight is None
    )
    assert np.max(np.abs(total / found.product_bound() - 1.0)) <= bounds.wobble + 1e-12


def values_at(basis, z):
    table = []
    for powers in basis.exponents.tolist():
        value = Fraction(1)
        for x, k in zip(z, powers, strict=True):
            value *= x**k
        table.append(value)
    return [sum(Fraction(b) * m for b, m in zip(row, table, strict=True)) for row in basis.matrix.tolist()]


@pytest.mark.parametrize(
    "solution",
    [
        handmade.linear([[1e-200]], [0.0], [1e-200]),
        handmade.norm([[1e-170]], [0.0], [0.0], 0.0, [1.0]),
        handmade.norm([[1e-200]], [0.0], [0.0], 0.0, [1e-200]),
        handmade.matrix([[0.0]], [[[-1e-200]]], [1e-200]),
        handmade.polynomial(sos.Sphere(2), 2, np.zeros(5), [np.zeros((3, 3))], C=-1e-200 * np.ones((5, 1)), d=[1e-200]),
    ],
)
def test_violations_that_underflow_are_not_certified(solution):
    assert not solution.certificate().holds


@pytest.mark.parametrize("lower", [False, True])
def test_only_the_symmetric_part_of_a_gram_matrix_counts(lower):
    found = sampling(sos.Sphere(3), 4)
    order = len(found.blocks[0].basis)
    gram = np.eye(order)
    gram[(1, 0) if lower else (0, 1)] = -9.0
    rows = found.blocks[0].rows
    values = np.einsum("ui,ij,uj->u", rows, gram, rows)
    margin = handmade.polynomial(sos.Sphere(3), 4, values, [gram]).certificate().margins["f"]
    points = sos.Sphere(3).sample(20000, seed=1)
    assert (found.basis(points) @ (found.inverse @ values)).min() >= margin


def test_equations_between_zeros_hold():
    assert handmade.linear([[0.0]], [0.0], [1.0]).certificate().holds
    assert handmade.norm([[0.0]], [0.0], [0.0], 0.0, [1.0]).certificate().holds


@pytest.mark.parametrize("scale", [1e-250, 1e-160, 1.0, 1e160, 1e250])
def test_norms_of_any_scale_are_bounded_sharply(scale):
    margin = handmade.norm([[3.0 * scale], [4.0 * scale]], [0.0, 0.0], [0.0], 6.0 * scale, [1.0]).certificate()
    assert margin.margins["length"] == pytest.approx(scale, rel=1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_a_program_with_bad_numbers_certifies_nothing_and_spares_the_batch(tube, bad):
    solution = sos.solve(tube, stacked(tube_data(tube, 0), 3))
    alone = solution.certificate()
    assert alone.holds.all()
    solution.values[0, 2] = bad
    solution.grams["tube/0"][0][1, 0, 0] = bad
    certificate = solution.certificate()
    assert list(certificate.holds) == [False, False, True]
    for name, margin in certificate.margins.items():
        assert margin[2] == alone.margins[name][2]
        assert not np.any(np.isnan(margin))
    if not np.isfinite(bad):
        assert certificate.margins["tube/0"][1] == -np.inf
        assert certificate.margins["law"][0] == -np.inf
        assert certificate.bound[0] == np.inf


def stacked(data, count):
    constraints = {name: [np.stack([a] * count) for a in arrays.values()] for name, arrays in data.constraints.items()}
    return data.structure.data(objective=np.stack([data.objective] * count), constraints=constraints)
