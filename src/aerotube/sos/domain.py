"""Domains of sum-of-squares constraints: spheres, balls, intervals and their products.

Every domain here is the shadow of a product of spheres: the unit ball of R^n is what is left of the sphere of
R^(n+1) when its last coordinate t (t^2 = 1 - |x|^2) is forgotten, and an interval is a ball of dimension one. Sums of
squares on the lifted spheres, sorted by their parity in every t, are exactly the weighted sums of squares on the
domain, with one weight for each product of the boundary polynomials 1 - |x_i|^2. The rotations of the spheres act
transitively, so in bases orthonormal in the spheres' measure the weighted squares of all basis functions add up to a
constant: the property that makes certificates sharp (see `aerotube.sos.certificate`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Factor:
    """One factor of a domain.

    Attributes
    ----------
    kind : str
        ``"sphere"`` for {x : |x| = 1}, ``"ball"`` for {x : |x| <= 1}.
    dimension : int
        Number of coordinates of x.
    """

    kind: str
    dimension: int


@dataclass(frozen=True)
class Domain:
    """A product of unit spheres and unit balls, in the order of its coordinates.

    Attributes
    ----------
    factors : tuple of Factor
    """

    factors: tuple[Factor, ...]

    @property
    def dimension(self) -> int:
        """Number of coordinates of a point."""
        return sum(factor.dimension for factor in self.factors)

    @property
    def balls(self) -> tuple[int, ...]:
        """Positions of the factors that are balls (or intervals)."""
        return tuple(i for i, factor in enumerate(self.factors) if factor.kind == "ball")

    def slices(self) -> tuple[slice, ...]:
        """Columns of a point array that belong to each factor."""
        stops = np.cumsum([0] + [factor.dimension for factor in self.factors])
        return tuple(slice(int(a), int(b)) for a, b in pairwise(stops))

    def weights(self, degree: int) -> Iterator[tuple[int, ...]]:
        """Sets of balls whose boundary polynomials are multiplied into one weight, of degree at most `degree`."""
        for count in range(min(len(self.balls), degree // 2) + 1):
            yield from combinations(self.balls, count)

    def boundary(self, factor: int, points: Array) -> Array:
        """Values (...,) of 1 - |x_i|^2 for one factor, at points (..., n)."""
        part = points[..., self.slices()[factor]]
        return np.asarray(1.0 - np.sum(part * part, axis=-1))

    def exponents(self, degree: int) -> IntArray:
        """Exponents (count, n) of monomials that span the polynomials of total degree <= `degree` on the domain.

        On a sphere the last coordinate occurs at most to the first power: higher powers are other polynomials there.
        """
        caps: list[int] = []
        for factor in self.factors:
            caps += [degree] * factor.dimension
            if factor.kind == "sphere":
                caps[-1] = min(1, degree)
        rows: list[tuple[int, ...]] = []

        def extend(prefix: tuple[int, ...], left: int) -> None:
            if len(prefix) == len(caps):
                rows.append(prefix)
                return
            for power in range(min(left, caps[len(prefix)]) + 1):
                extend((*prefix, power), left - power)

        extend((), degree)
        rows.sort(key=lambda row: (sum(row), tuple(-power for power in row)))
        return np.array(rows, dtype=np.int64).reshape(len(rows), len(caps))

    def moments(self, exponents: IntArray, weight: tuple[int, ...] = ()) -> Array:
        """Exact means of monomials times a weight, in the measure of the lifted spheres.

        Parameters
        ----------
        exponents : (..., n)
        weight : balls whose boundary polynomial multiplies the monomial

        Returns
        -------
        (...,) array. On the sphere of R^n the mean of x^a is 0 if some a_i is odd and otherwise
        prod (a_i - 1)!! / (n (n + 2) ... (n + |a| - 2)).
        """
        result = np.ones(exponents.shape[:-1])
        for i, (factor, columns) in enumerate(zip(self.factors, self.slices(), strict=True)):
            powers = exponents[..., columns]
            if factor.kind == "ball":
                last = np.full((*powers.shape[:-1], 1), 2 if i in weight else 0)
                powers = np.concatenate([powers, last], axis=-1)
            result = result * _sphere_moments(powers)
        return result

    def sample(self, count: int, seed: int = 0) -> Array:
        """`count` points (count, n) drawn from the measure of the lifted spheres, the same for the same seed."""
        generator = np.random.default_rng(seed)
        parts = []
        for factor in self.factors:
            lifted = factor.dimension + (factor.kind == "ball")
            normal = generator.standard_normal((count, lifted))
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            parts.append(normal[:, : factor.dimension])
        return np.concatenate(parts, axis=1)

    def contains(self, points: Array, tolerance: float = 1e-9) -> NDArray[np.bool_]:
        """Whether points (..., n) lie in the domain, up to `tolerance` in |x|^2."""
        inside = np.ones(points.shape[:-1], dtype=bool)
        for i, factor in enumerate(self.factors):
            value = self.boundary(i, points)
            inside &= value >= -tolerance
            if factor.kind == "sphere":
                inside &= value <= tolerance
        return inside

    def __str__(self) -> str:
        """Return the domain as one would write it, such as ``Sphere(4) x Ball(1)``."""
        return " x ".join(f"{factor.kind.capitalize()}({factor.dimension})" for factor in self.factors)


def _sphere_moments(powers: IntArray) -> Array:
    dimension = powers.shape[-1]
    total = powers.sum(axis=-1)
    highest = int(total.max(initial=0))
    odd_factorial = np.ones(highest + 2)
    rising = np.ones(highest + 2)
    for k in range(2, highest + 1, 2):
        odd_factorial[k] = odd_factorial[k - 2] * (k - 1)
        rising[k] = rising[k - 2] * (dimension + k - 2)
    even = np.all(powers % 2 == 0, axis=-1)
    value = np.prod(odd_factorial[np.where(even[..., None], powers, 0)], axis=-1)
    return np.asarray(np.where(even, value / rising[np.where(even, total, 0)], 0.0))


def _checked(kind: str, dimension: int, least: int) -> Domain:
    if dimension < least:
        raise ValueError(
            f"a {kind} needs a dimension of at least {least}, got {dimension}; give the number of its coordinates."
        )
    return Domain((Factor(kind, int(dimension)),))


def Sphere(dimension: int) -> Domain:
    """The unit sphere {z in R^n : |z| = 1}; polynomials on it live modulo |z|^2 - 1.

    Parameters
    ----------
    dimension : int
        n >= 2, the number of coordinates.

    Raises
    ------
    ValueError
        If `dimension` is less than 2.
    """
    return _checked("sphere", dimension, 2)


def Ball(dimension: int) -> Domain:
    """The unit ball {z in R^n : |z| <= 1}, with the weight 1 - |z|^2.

    Parameters
    ----------
    dimension : int
        n >= 1, the number of coordinates.

    Raises
    ------
    ValueError
        If `dimension` is less than 1.
    """
    return _checked("ball", dimension, 1)


def Interval() -> Domain:
    """The interval [-1, 1], with the weight 1 - s^2: a parameter with its multiplier."""
    return Ball(1)


def Product(*domains: Domain) -> Domain:
    """The product of domains, coordinates side by side in the order given.

    Parameters
    ----------
    domains : one or more of `Sphere`, `Ball`, `Interval`, `Product`

    Raises
    ------
    ValueError
        If no domain is given.
    """
    if not domains:
        raise ValueError("a product needs at least one domain; give for instance Product(Sphere(4), Interval()).")
    return Domain(tuple(factor for domain in domains for factor in domain.factors))
