"""Sum-of-squares programs as plain data, which every solver's own modelling starts from.

Minimise ``objective @ d`` over d, subject to

* polynomials ``f(z) = (c + C d) @ z^exponents`` being sums of squares on a product of unit spheres and unit balls: with
  the boundary polynomial ``g = 1 - |z_i|^2`` of a ball as a weight with a multiplier of its own, and with ``g`` of a
  sphere as an equality (polynomials are the same if they differ by a multiple of it);
* linear matrix inequalities, linear inequalities, and norm bounds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from aerotube import sos

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
Power = tuple[int, ...]
Factors = tuple[tuple[str, int], ...]


@dataclass(frozen=True, eq=False)
class Sos:
    """``(c + C d) @ z^exponents`` is a sum of squares on a domain.

    Attributes
    ----------
    name : str
    factors : tuple of (kind, dimension)
        ``("sphere", n)`` or ``("ball", n)``, in the order of the coordinates.
    degree : int
        Degree of every weighted square, even.
    exponents : (k, n) integers
    c : (k,)
    C : (k, m)
    """

    name: str
    factors: Factors
    degree: int
    exponents: IntArray
    c: Array
    C: Array

    @property
    def coordinates(self) -> int:
        """Number of coordinates of z."""
        return sum(dimension for _, dimension in self.factors)

    @property
    def boundaries(self) -> list[tuple[str, list[Power]]]:
        """For each factor its kind and the monomials of |z_i|^2."""
        out, start = [], 0
        for kind, dimension in self.factors:
            unit = np.eye(self.coordinates, dtype=int)[start : start + dimension]
            out.append((kind, [tuple(int(p) for p in 2 * row) for row in unit]))
            start += dimension
        return out

    @property
    def domain(self) -> sos.Domain:
        """The domain in the project's own terms."""
        make = {"sphere": sos.Sphere, "ball": sos.Ball}
        return sos.Product(*(make[kind](dimension) for kind, dimension in self.factors))


@dataclass(frozen=True, eq=False)
class Lmi:
    """``F0 + sum_i d_i F_i`` is positive semidefinite; F0 (k, k), F (m, k, k)."""

    name: str
    F0: Array
    F: Array


@dataclass(frozen=True, eq=False)
class Linear:
    """``A d <= b``; A (rows, m), b (rows,)."""

    name: str
    A: Array
    b: Array


@dataclass(frozen=True, eq=False)
class Norm:
    """``|A d + b| <= g @ d + h``; A (k, m), b (k,), g (m,), h a number."""

    name: str
    A: Array
    b: Array
    g: Array
    h: float


@dataclass(frozen=True, eq=False)
class Program:
    """A whole program.

    Attributes
    ----------
    name : str
    objective : (m,)
    constraints : tuple of Sos, Lmi, Linear, Norm
    """

    name: str
    objective: Array
    constraints: tuple[Sos | Lmi | Linear | Norm, ...]

    @property
    def size(self) -> int:
        """Number m of decision variables."""
        return len(self.objective)


def from_data(name: str, structure: sos.Structure, data: sos.Data, position: int) -> Program:
    """Write one program of a batch, whose polynomials are values at nodes, in monomials."""
    objective, arrays = data.one(position)
    out: list[Sos | Lmi | Linear | Norm] = []
    for item in structure.constraints:
        own = arrays[item.name]
        if item.kind == "sos":
            assert item.domain is not None
            exponents = item.domain.exponents(item.degree)
            table = monomials(structure.nodes(item.name), exponents)
            both = np.asarray(np.linalg.solve(table, np.column_stack([own["c"], own["C"]])), dtype=np.float64)
            # What interpolation leaves of coefficients that are zero would only make the peers' programs denser.
            both[np.abs(both) < 1e-12 * np.abs(both).max(axis=0, initial=0.0)] = 0.0
            factors = tuple((factor.kind, factor.dimension) for factor in item.domain.factors)
            out.append(Sos(item.name, factors, item.degree, exponents, both[:, 0], both[:, 1:]))
        elif item.kind == "lmi":
            out.append(Lmi(item.name, own["F0"], own["F"]))
        elif item.kind == "linear":
            out.append(Linear(item.name, own["A"], own["b"]))
        else:
            out.append(Norm(item.name, own["A"], own["b"], own["g"], float(own["h"])))
    return Program(name, objective, tuple(out))


def monomials(points: Array, exponents: IntArray) -> Array:
    """Values (..., k) of monomials (k, n) at points (..., n)."""
    return np.asarray(np.prod(points[..., None, :] ** exponents, axis=-1))


@lru_cache(maxsize=8)
def gram_bases(
    factors: tuple[tuple[str, int], ...], degree: int
) -> tuple[tuple[list[dict[Power, float]], IntArray], ...]:
    """Weights and monomial bases of the squares: for each weight its factors (polynomials) and exponents (N, n).

    Monomials that are others' sums on a sphere are left out.
    """
    probe = Sos("", factors, degree, np.zeros((1, 0), dtype=np.int64), np.zeros(1), np.zeros((1, 0)))
    balls = [squares for kind, squares in probe.boundaries if kind == "ball"]
    one = (0,) * probe.coordinates
    out = []
    for subset in probe.domain.weights(degree):
        order = [i for i, (kind, _) in enumerate(factors) if kind == "ball"]
        weight = [{one: 1.0, **dict.fromkeys(balls[order.index(i)], -1.0)} for i in subset]
        out.append((weight, probe.domain.exponents((degree - 2 * len(subset)) // 2)))
    return tuple(out)


class Quotient:
    """Polynomials modulo ``|z_i|^2 = 1`` of the spheres, in the monomials that are left.

    Parameters
    ----------
    factors : tuple of (kind, dimension)
    degree : int
    """

    def __init__(self, factors: Factors, degree: int) -> None:
        probe = Sos("", factors, degree, np.zeros((1, 0), dtype=np.int64), np.zeros(1), np.zeros((1, 0)))
        self.exponents = probe.domain.exponents(degree)
        self._index = {tuple(int(p) for p in row): i for i, row in enumerate(self.exponents)}
        self._spheres = [squares for kind, squares in probe.boundaries if kind == "sphere"]
        self._known: dict[Power, dict[int, float]] = {}

    def reduce(self, power: Power) -> dict[int, float]:
        """One monomial as coefficients of those that are left."""
        if power in self._known:
            return self._known[power]
        out: dict[int, float] = {}
        for squares in self._spheres:
            last = squares[-1].index(2)
            if power[last] >= 2:
                # z_last^2 = 1 - the other squares
                rest = tuple(p - 2 * (i == last) for i, p in enumerate(power))
                parts = [(1.0, rest)]
                parts += [(-1.0, tuple(p + q for p, q in zip(rest, square, strict=True))) for square in squares[:-1]]
                for sign, part in parts:
                    for i, value in self.reduce(part).items():
                        out[i] = out.get(i, 0.0) + sign * value
                break
        else:
            out[self._index[power]] = 1.0
        self._known[power] = out
        return out

    def matrix(self, exponents: IntArray) -> sparse.csr_matrix:
        """Matrix (left, k) from coefficients of monomials (k, n) to those that are left."""
        entries = [
            (i, j, value)
            for j, power in enumerate(exponents)
            for i, value in self.reduce(tuple(int(p) for p in power)).items()
        ]
        rows, columns, values = zip(*entries, strict=True)
        return sparse.csr_matrix((values, (rows, columns)), shape=(len(self.exponents), len(exponents)))

    def gram(self, weight: list[dict[Power, float]], basis: IntArray) -> sparse.csr_matrix:
        """Matrix (left, N * N) from a Gram matrix, row by row, to the coefficients of its weighted square."""
        factor = {(0,) * basis.shape[1]: 1.0}
        for polynomial in weight:
            product: dict[Power, float] = {}
            for a, x in factor.items():
                for b, y in polynomial.items():
                    power = tuple(p + q for p, q in zip(a, b, strict=True))
                    product[power] = product.get(power, 0.0) + x * y
            factor = product
        size = len(basis)
        rows, columns, values = [], [], []
        for i in range(size):
            for j in range(i + 1):
                column: dict[int, float] = {}
                for power, x in factor.items():
                    whole = tuple(int(p + q + r) for p, q, r in zip(basis[i], basis[j], power, strict=True))
                    for k, y in self.reduce(whole).items():
                        column[k] = column.get(k, 0.0) + x * y
                for place in {i * size + j, j * size + i}:
                    rows += list(column)
                    columns += [place] * len(column)
                    values += list(column.values())
        return sparse.csr_matrix((values, (rows, columns)), shape=(len(self.exponents), size * size))
