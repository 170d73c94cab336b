"""Orthonormal bases on a domain and the nodes at which polynomials are sampled."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from aerotube.sos.domain import Array, Domain, IntArray


@dataclass(frozen=True, eq=False)
class Polynomial:
    """A fixed polynomial, in monomials.

    Attributes
    ----------
    exponents : (k, n) integers
    coefficients : (k,)
    """

    exponents: IntArray
    coefficients: Array

    def __post_init__(self) -> None:
        exponents = np.array(self.exponents, dtype=np.int64, ndmin=2)
        coefficients = np.array(self.coefficients, dtype=np.float64, ndmin=1)
        if coefficients.shape != (exponents.shape[0],) or np.any(exponents < 0):
            raise ValueError(
                "a polynomial needs one coefficient for each row of non-negative exponents; "
                f"got exponents {exponents.shape} and coefficients {coefficients.shape}."
            )
        if not np.all(np.isfinite(coefficients)):
            raise ValueError("a coefficient of a polynomial is not finite; give finite numbers.")
        exponents.flags.writeable = coefficients.flags.writeable = False
        object.__setattr__(self, "exponents", exponents)
        object.__setattr__(self, "coefficients", coefficients)

    @property
    def degree(self) -> int:
        """Highest total degree of a monomial with a non-zero coefficient."""
        used = self.exponents[self.coefficients != 0.0]
        return int(used.sum(axis=1).max(initial=0))

    def __call__(self, points: Array) -> Array:
        """Values (...,) at points (..., n)."""
        return np.asarray(monomials(points, self.exponents) @ self.coefficients)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Polynomial) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def _key(self) -> tuple[tuple[int, ...], bytes, bytes]:
        return self.exponents.shape, self.exponents.tobytes(), self.coefficients.tobytes()


def on_domain(polynomial: Polynomial, domain: Domain) -> Polynomial:
    """Return the same function on a domain, with the last coordinate of every sphere at most to the first power.

    Coefficients that cancel on the spheres are gone, because they are added up exactly and rounded once.
    """
    lasts = [
        (columns, columns.stop - 1)
        for factor, columns in zip(domain.factors, domain.slices(), strict=True)
        if factor.kind == "sphere"
    ]
    pending = [
        (tuple(powers), Fraction(value))
        for powers, value in zip(polynomial.exponents.tolist(), polynomial.coefficients.tolist(), strict=True)
    ]
    terms: dict[tuple[int, ...], Fraction] = {}
    while pending:
        powers, value = pending.pop()
        for columns, last in lasts:
            if powers[last] >= 2:
                lower = [k - 2 if i == last else k for i, k in enumerate(powers)]
                pending.append((tuple(lower), value))
                for j in range(columns.start, last):
                    pending.append((tuple(k + 2 * (i == j) for i, k in enumerate(lower)), -value))
                break
        else:
            terms[powers] = terms.get(powers, Fraction(0)) + value
    kept = sorted((powers, float(value)) for powers, value in terms.items() if value)
    if not kept:
        return Polynomial(np.zeros((1, domain.dimension), dtype=np.int64), np.zeros(1))
    return Polynomial(np.array([powers for powers, _ in kept]), np.array([value for _, value in kept]))


def monomials(points: ArrayLike, exponents: IntArray) -> Array:
    """Values (..., k) of the monomials `exponents` (k, n) at points (..., n)."""
    points = np.asarray(points, dtype=np.float64)
    highest = int(exponents.max(initial=0))
    powers = np.ones((highest + 1, *points.shape))
    for k in range(1, highest + 1):
        powers[k] = powers[k - 1] * points
    result = np.ones((*points.shape[:-1], exponents.shape[0]))
    for i in range(exponents.shape[1]):
        result *= (
            powers[exponents[:, i], ..., i].T
            if points.ndim == 1
            else np.moveaxis(powers[exponents[:, i], ..., i], 0, -1)
        )
    return result


@dataclass(frozen=True, eq=False)
class Basis:
    """Polynomials of total degree <= `degree`, orthonormal on a domain with a weight.

    Attributes
    ----------
    domain : Domain
    degree : int
    weight : tuple of int
        Balls of the domain whose boundary polynomials multiply the measure.
    exponents : (N, n)
    matrix : (N, N)
        Lower triangular: basis function i is ``sum_j matrix[i, j] x^exponents[j]``.
    """

    domain: Domain
    degree: int
    weight: tuple[int, ...]
    exponents: IntArray
    matrix: Array

    def __len__(self) -> int:
        return self.exponents.shape[0]

    def __call__(self, points: ArrayLike) -> Array:
        """Values (..., N) at points (..., n)."""
        return monomials(points, self.exponents) @ self.matrix.T


def too_high(domain: Domain, degree: int) -> str:
    """One sentence for a degree that double precision cannot represent."""
    return f"the degree {degree} on {domain} is too high for double precision; lower it, or split the domain."


@lru_cache(maxsize=256)
def orthonormal_basis(domain: Domain, degree: int, weight: tuple[int, ...] = ()) -> Basis:
    """Make the basis of the polynomials of degree <= `degree` by Cholesky factorisation of their exact moments."""
    exponents = domain.exponents(degree)
    gram = domain.moments(exponents[:, None, :] + exponents[None, :, :], weight)
    try:
        matrix = np.linalg.inv(np.linalg.cholesky(gram))
        # A second pass removes the rounding that the conditioning of the monomials let in.
        matrix = np.linalg.inv(np.linalg.cholesky(matrix @ gram @ matrix.T)) @ matrix
    except np.linalg.LinAlgError:
        raise ValueError(too_high(domain, degree)) from None
    matrix = np.tril(matrix)
    matrix.flags.writeable = exponents.flags.writeable = False
    return Basis(domain, degree, weight, exponents, matrix)


@dataclass(frozen=True, eq=False)
class Block:
    """One Gram matrix of a sum-of-squares constraint: g(z) p(z)' Q p(z).

    Attributes
    ----------
    basis : Basis
        p, of N functions.
    boundary : tuple of int
        Balls whose boundary polynomials are factors of g.
    weight : Polynomial or None
        Further factor of g, given by the user.
    rows : (U, N)
        p at the nodes.
    weights : (U,)
        g at the nodes.
    """

    basis: Basis
    boundary: tuple[int, ...]
    weight: Polynomial | None
    rows: Array
    weights: Array

    def weight_at(self, points: Array) -> Array:
        """Values (...,) of g at points (..., n)."""
        value = np.ones(points.shape[:-1])
        for factor in self.boundary:
            value = value * self.basis.domain.boundary(factor, points)
        return value if self.weight is None else value * on_domain(self.weight, self.basis.domain)(points)


@dataclass(frozen=True, eq=False)
class Sampling:
    """Nodes of a domain and degree, with the Gram bases sampled there.

    Attributes
    ----------
    domain : Domain
    degree : int
        Degree 2d of the polynomials that the nodes determine.
    nodes : (U, n)
    basis : Basis
        Orthonormal basis of degree 2d, U functions.
    inverse : (U, U)
        From values at the nodes to coefficients in `basis`.
    mean : (U,)
        Weights of the cubature at the nodes: ``mean @ f(nodes)`` is the mean of f, exact to degree 2d.
    interior : (U,)
        A functional whose moment matrices are all positive definite (`mean`, unless the user's weights cut the domain).
    blocks : tuple of Block
    """

    domain: Domain
    degree: int
    nodes: Array
    basis: Basis
    inverse: Array
    mean: Array
    interior: Array
    blocks: tuple[Block, ...]

    def product_bound(self) -> float:
        """Return the constant value on the domain of the sum over the domain's blocks of g |p|^2."""
        return float(sum(len(block.basis) for block in self.blocks if block.weight is None))


def fekete_points(values: Array) -> IntArray:
    """Choose points at which functions are best told apart: approximate Fekete points, as rising indices.

    Parameters
    ----------
    values : (S, U)
        Of U functions at S points of a dense sample.

    Returns
    -------
    (U,)

    Notes
    -----
    Sommariva and Vianello, "Computing approximate Fekete points by QR factorizations of Vandermonde matrices",
    Computers & Mathematics with Applications 57 (2009). On a sphere all columns of the matrix to be factored have the
    same norm, and rounding, which depends on the machine, would choose the first pivots: a preference for earlier
    points, far above rounding and far below what matters, chooses them instead.
    """
    from scipy.linalg import qr

    preference = 1.0 - 1e-6 * np.arange(len(values)) / len(values)
    pivots = qr((values * preference[:, None]).T, mode="r", pivoting=True)[1]
    return np.sort(pivots[: values.shape[1]])


@lru_cache(maxsize=64)
def nodes_and_basis(domain: Domain, degree: int) -> tuple[Array, Basis, Array]:
    """Approximate Fekete points by pivoted QR factorisation of a fixed dense sample.

    Parameters
    ----------
    domain : Domain
    degree : int
        Degree 2d of the polynomials to determine.

    Returns
    -------
    nodes : (U, n)
    basis : Basis of degree 2d
    inverse : (U, U), from values at the nodes to coefficients

    """
    basis = orthonormal_basis(domain, degree)
    count = len(basis)
    sample = domain.sample(max(4 * count, 400) if count <= 1000 else 2 * count)
    nodes = np.ascontiguousarray(sample[fekete_points(basis(sample))])
    inverse = np.asarray(np.linalg.inv(basis(nodes)), dtype=np.float64)
    nodes.flags.writeable = inverse.flags.writeable = False
    return nodes, basis, inverse


@lru_cache(maxsize=64)
def sampling(domain: Domain, degree: int, weights: tuple[Polynomial, ...] = ()) -> Sampling:
    """Make nodes and Gram bases for one sum-of-squares constraint (cached).

    Parameters
    ----------
    domain : Domain
    degree : int
        Even degree 2d of the constraint.
    weights : tuple of Polynomial
        Further polynomials g_j >= 0 that describe the set inside the domain.

    Raises
    ------
    ValueError
        If the degree is odd, negative, or too high for double precision, or a weight is of a higher degree, of another
        dimension, or nowhere positive.
    """
    if degree < 0 or degree % 2:
        raise ValueError(f"the degree of a sum-of-squares constraint must be even and not negative, got {degree}.")
    nodes, basis, inverse = nodes_and_basis(domain, degree)
    # The first basis function is the constant 1, so the mean of f is its first coefficient.
    mean = inverse[0].copy()
    blocks = [_block(domain, degree, subset, None, nodes) for subset in domain.weights(degree)]
    interior = mean
    if weights:
        for j, weight in enumerate(weights):
            if weight.exponents.shape[1] != domain.dimension:
                raise ValueError(
                    f"weight {j} has {weight.exponents.shape[1]} coordinates and its domain {domain.dimension}."
                )
            if weight.degree > degree:
                raise ValueError(
                    f"weight {j} is of degree {weight.degree}, above the constraint's {degree}; raise the degree."
                )
            blocks.append(_block(domain, degree, (), weight, nodes))
        sample = domain.sample(max(20000, 40 * len(basis)), seed=1)
        inside = np.all([on_domain(weight, domain)(sample) > 0.0 for weight in weights], axis=0)
        # of balls, hardly a point of a sample is deep inside, where a small set may be
        while np.sum(inside) < len(basis) and len(domain.balls) == len(domain.factors) and np.max(sample) > 1e-2:
            sample = 0.7 * sample
            inside = np.all([weight(sample) > 0.0 for weight in weights], axis=0)
        if not np.any(inside):
            raise ValueError(f"no point of {domain} was found where all weights are positive; check their signs.")
        # Coefficients of a mean over points of the set, as a functional on values at the nodes.
        interior = basis(sample[inside]).mean(axis=0) @ inverse
    found = Sampling(domain, degree, nodes, basis, inverse, mean, np.asarray(interior), tuple(blocks))
    from aerotube.sos.accuracy import accuracy

    accuracy(found)
    return found


def _block(domain: Domain, degree: int, boundary: tuple[int, ...], weight: Polynomial | None, nodes: Array) -> Block:
    used = 2 * len(boundary) + (0 if weight is None else weight.degree)
    basis = orthonormal_basis(domain, (degree - used) // 2, boundary)
    rows = np.ascontiguousarray(basis(nodes))
    block = Block(basis, boundary, weight, rows, np.empty(0))
    values = np.ascontiguousarray(block.weight_at(nodes))
    rows.flags.writeable = values.flags.writeable = False
    return Block(basis, boundary, weight, rows, values)
