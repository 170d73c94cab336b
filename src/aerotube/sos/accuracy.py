"""How exact the nodes, bases and weights of a sum-of-squares constraint are, as bounds.

Certificates are about polynomials whose coefficients are numbers of the machine, so the bases differ from the
orthonormal functions that they stand for, their rows from their values, and the nodes from points of the domain:

* with the functions p* that are orthonormal, p = L p* and L L' = B G B' = I + E, B the coefficients and G the exact
  moments of the monomials; so every sum of squares differs from p*'s by at most |E|, relatively;
* the inverse X of the table V of values is trusted as far as |I - X V| allows;
* a node z off the sphere by tau sees g p'Qp differ from the polynomial that it is on the sphere, the square of the
  sphere's last coordinate x_n replaced by 1 - x_1^2 - ...: by tau times the coefficient of x_n^2.

The rounding of what is evaluated is bounded as in N. J. Higham, "Accuracy and Stability of Numerical Algorithms",
chapters 3 and 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import combinations
from math import prod
from typing import Any

import numpy as np

from aerotube.sos.basis import Basis, Block, Polynomial, Sampling, on_domain, too_high
from aerotube.sos.domain import Array, Domain, IntArray

UNIT = float(np.finfo(np.float64).eps)
TINY = float(np.finfo(np.float64).tiny)
_FINE_UNIT = float(np.finfo(np.longdouble).eps)
# All bounds are evaluated in rounded arithmetic themselves.
_UP = 1.000001


@dataclass(frozen=True, eq=False)
class BlockAccuracy:
    """Accuracy of one Gram matrix's part in a constraint.

    Attributes
    ----------
    rows, weights : (U, N), (U,) extended precision
        p and g at the nodes.
    slip : (U,)
        What |g p'Qp|, evaluated at the nodes from the block's own rows, may be wrong by, for Q of Frobenius norm one.
    slip_fine : (U,)
        The same, evaluated in extended precision from the rows here.
    length : (U,)
        Upper bound of |g| |p|^2 at the nodes.
    largest : float
        Upper bound of |g| |p|^2 on the domain.
    """

    rows: Any
    weights: Any
    slip: Array
    slip_fine: Array
    length: Array
    largest: float


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Accuracy of a constraint's nodes and bases.

    Attributes
    ----------
    blocks : tuple of BlockAccuracy
    wobble : float
        Relative bound of what the sum of g |p|^2 over the domain's blocks differs by from a constant.
    square_sum : float
        Upper bound on the domain of the sum of squares of the basis functions of the constraint's degree.
    inverse : float
        Upper bound of the Frobenius norm of the map from values at the nodes to coefficients.
    trust : float
        Coefficients found with the inverse differ from the true ones by this factor at most, in norm.
    """

    blocks: tuple[BlockAccuracy, ...]
    wobble: float
    square_sum: float
    inverse: float
    trust: float


@lru_cache(maxsize=64)
def accuracy(found: Sampling) -> Accuracy:
    """Bound the errors of a sampling.

    Raises
    ------
    ValueError
        If the bases or nodes are too far from what they stand for: the degree is too high for double precision.
    """
    blocks = tuple(_block(found, block) for block in found.blocks)
    wobble = max(_defect(block.basis) for block in found.blocks if block.weight is None)
    own = _defect(found.basis)
    # Extended precision is slow in large products, and only high degrees in few coordinates need it.
    kind: Any = np.longdouble if len(found.nodes) <= 300 else np.float64
    table, error = _values(found.basis, found.nodes, kind)
    rounded = np.asarray(table, dtype=np.float64)
    size, wide = float(np.linalg.norm(found.inverse)), float(np.linalg.norm(rounded))
    count = len(found.nodes)
    inexact = float(np.linalg.norm(error)) + UNIT * wide
    fault = float(np.linalg.norm(found.inverse @ rounded - np.eye(count))) + size * (
        UNIT * (count + 2) * wide + inexact
    )
    fault *= _UP
    if not max(wobble, own, fault) < 0.5:
        raise ValueError(too_high(found.domain, found.degree))
    trust = _UP / (1.0 - fault)
    square_sum = _UP * _functions(found.domain, found.degree) * (1.0 + own)
    return Accuracy(blocks, wobble, square_sum, size * trust, trust)


def _functions(domain: Domain, degree: int) -> int:
    """Sum of squares on the lifted spheres of all orthonormal functions of that degree: their number.

    Those even in every lifted coordinate live on the domain, and the others are functions of lower degree times the
    lifted coordinates they are odd in.
    """
    total = 0
    for count in range(min(len(domain.balls), degree) + 1):
        total += sum(len(domain.exponents(degree - count)) for _ in combinations(domain.balls, count))
    return total


def _monomials(points: Any, exponents: IntArray, kind: Any) -> Any:
    """Values (U, k) of monomials, in the arithmetic asked for."""
    points = np.asarray(points, dtype=kind)
    result = np.ones((len(points), len(exponents)), dtype=kind)
    for i in range(exponents.shape[1]):
        powers = [np.ones(len(points), dtype=kind)]
        for _ in range(int(exponents[:, i].max(initial=0))):
            powers.append(powers[-1] * points[:, i])
        result *= np.stack(powers, axis=1)[:, exponents[:, i]]
    return result


def _values(basis: Basis, points: Array, kind: Any, columns: Any = slice(None)) -> tuple[Any, Array]:
    """Values (U, N) of basis functions at points, or of their part in some monomials, and bounds of their errors."""
    exponents, matrix = basis.exponents[columns], basis.matrix[:, columns]
    table = _monomials(points, exponents, kind)
    count = int(exponents.sum(axis=1).max(initial=0)) + exponents.shape[1] + len(exponents) + 4
    rounding = float(np.finfo(kind).eps) * count * (np.abs(table).astype(np.float64) @ np.abs(matrix).T)
    return table @ matrix.T.astype(kind), np.asarray(_UP * rounding)


def _lasts(domain: Domain) -> list[tuple[slice, int]]:
    """Columns of every sphere, and the last of them."""
    return [
        (columns, columns.stop - 1)
        for factor, columns in zip(domain.factors, domain.slices(), strict=True)
        if factor.kind == "sphere"
    ]


def _weight(found: Sampling, block: Block) -> tuple[Any, Array, Array, float]:
    """Weight g at the nodes in extended precision, its error (U,), and bounds of its coefficients' sums (U,) and ()."""
    nodes = found.nodes.astype(np.longdouble)
    value = np.ones(len(nodes), dtype=np.longdouble)
    for factor in block.boundary:
        part = nodes[:, found.domain.slices()[factor]]
        value = value * (1 - np.sum(part * part, axis=1))
    # Every factor 1 - |x|^2 is a difference of numbers of the order one.
    count = found.domain.dimension + 4 + 2 * len(block.boundary)
    error = np.full(len(nodes), _FINE_UNIT * count * 4.0 ** len(block.boundary) * bool(block.boundary))
    if block.weight is None:
        return value, error, np.ones(len(nodes)), 1.0
    weight: Polynomial = on_domain(block.weight, found.domain)
    flat = found.nodes.copy()
    for _, last in _lasts(found.domain):
        flat[:, last] = 1.0
    sizes = np.abs(_monomials(flat, weight.exponents, np.float64)) @ np.abs(weight.coefficients)
    table = _monomials(nodes, weight.exponents, np.longdouble)
    count = weight.degree + found.domain.dimension + len(weight.coefficients) + 4
    # The reduced coefficients are rounded, too.
    error = (_FINE_UNIT * count + UNIT) * _UP * (np.abs(table).astype(np.float64) @ np.abs(weight.coefficients))
    total = float(np.sum(np.abs(weight.coefficients)))
    return table @ weight.coefficients.astype(np.longdouble), error, _UP * sizes, _UP * total


def _block(found: Sampling, block: Block) -> BlockAccuracy:
    nodes, basis, order = found.nodes, block.basis, len(block.basis)
    rows, row_error = _values(basis, nodes, np.longdouble)
    weights, weight_error, weight_sizes, weight_total = _weight(found, block)
    lengths = np.linalg.norm(np.asarray(rows, dtype=np.float64), axis=1) * _UP
    error = np.linalg.norm(row_error, axis=1)
    size = np.abs(np.asarray(weights, dtype=np.float64)) * _UP
    drift = _drift(found, block, lengths + error, weight_sizes)

    def slip(unit: float, row: Array, weight: Array) -> Array:
        length = lengths + row
        total = (size + weight) * (2.0 * length * row + row**2) + weight * length**2 + drift
        total += unit * (2 * order + 6) * (size + weight) * length**2
        return np.asarray(_UP * total + TINY * (order + 2) ** 2 * (1.0 + size) * (1.0 + length) ** 2)

    return BlockAccuracy(
        rows=rows,
        weights=weights,
        slip=slip(
            UNIT,
            error + np.linalg.norm(np.asarray(block.rows - rows, dtype=np.float64), axis=1) * _UP,
            weight_error + np.abs(np.asarray(block.weights - weights, dtype=np.float64)) * _UP,
        ),
        slip_fine=slip(_FINE_UNIT, error, weight_error),
        length=np.asarray((size + weight_error) * (lengths + error) ** 2 * _UP),
        largest=_UP * weight_total * _functions(basis.domain, basis.degree) * (1.0 + _defect(basis))
        if block.weight is not None
        else float(order),
    )


def _drift(found: Sampling, block: Block, lengths: Array, weight_sizes: Array) -> Array:
    """Bound (U,) of what g p'Qp at the nodes differs by from its reduction on the spheres, for |Q| = 1."""
    total, together = np.zeros(len(found.nodes)), np.zeros(len(found.nodes))
    flat = found.nodes.copy()
    for columns, last in _lasts(found.domain):
        part = found.nodes[:, columns].astype(np.longdouble)
        off = np.abs(np.asarray(np.sum(part * part, axis=1) - 1, dtype=np.float64))
        off = _UP * off + 2.0 * _FINE_UNIT * (part.shape[1] + 2)
        own = found.nodes.copy()
        own[:, last] = flat[:, last] = 1.0
        chosen = np.flatnonzero(block.basis.exponents[:, last] == 1)
        if len(chosen):
            slope, error = _values(block.basis, own, np.longdouble, chosen)
            steep = np.linalg.norm(np.asarray(slope, dtype=np.float64), axis=1) * _UP + np.linalg.norm(error, axis=1)
        else:
            steep = np.zeros(len(found.nodes))
        highest = steep**2
        if block.weight is not None:
            highest = highest + 2.0 * steep * (lengths + 1.01 * steep)
        total += off * weight_sizes * highest
        together += off
    if len(_lasts(found.domain)) > 1:
        everything = np.abs(_monomials(flat, block.basis.exponents, np.float64)) @ np.abs(block.basis.matrix).T
        total += 4.0 * together**2 * weight_sizes * np.sum(everything**2, axis=1)
    return np.asarray(_UP * total)


@lru_cache(maxsize=256)
def _defect(basis: Basis) -> float:
    """Upper bound of |B G B' - I|: how far the basis is from orthonormal."""
    gram = basis.domain.moments(basis.exponents[:, None, :] + basis.exponents[None, :, :], basis.weight)
    count = len(basis)
    size = np.abs(basis.matrix) @ np.abs(gram) @ np.abs(basis.matrix).T
    found = float(np.linalg.norm(basis.matrix @ gram @ basis.matrix.T - np.eye(count)))
    # A moment is a quotient of two products of fewer numbers than its degree and its factors.
    found += UNIT * (2 * count + 4 * basis.degree + 4 * len(basis.domain.factors) + 8) * float(np.linalg.norm(size))
    found *= _UP
    if found < 1e-3 or count > 150:
        return found
    return _UP * _exact_defect(basis)


def _exact_defect(basis: Basis) -> float:
    count = len(basis)
    moments: dict[tuple[int, ...], Fraction] = {}

    def moment(powers: tuple[int, ...]) -> Fraction:
        if powers not in moments:
            moments[powers] = _moment(basis.domain, powers, basis.weight)
        return moments[powers]

    rows = [[Fraction(x) for x in row] for row in basis.matrix.tolist()]
    exponents = basis.exponents.tolist()
    gram = [[moment(tuple(a + b for a, b in zip(first, second, strict=True))) for second in exponents]
            for first in exponents]  # fmt: skip
    common = np.lcm.reduce(np.array([x.denominator for row in gram for x in row], dtype=object))
    scale = max(x.denominator for row in rows for x in row)
    b = np.array([[int(x * scale) for x in row] for row in rows], dtype=object)
    g = np.array([[int(x * common) for x in row] for row in gram], dtype=object)
    one = scale * scale * int(common)
    fault = [[float(Fraction(int(x), one)) for x in row] for row in b @ g @ b.T - one * np.eye(count, dtype=object)]
    return float(np.linalg.norm(fault))


def _moment(domain: Domain, powers: Sequence[int], weight: tuple[int, ...]) -> Fraction:
    """Mean of a monomial times a weight, as `Domain.moments`, exactly."""
    result = Fraction(1)
    for i, (factor, columns) in enumerate(zip(domain.factors, domain.slices(), strict=True)):
        own = list(powers[columns])
        if factor.kind == "ball":
            own.append(2 if i in weight else 0)
        if any(k % 2 for k in own):
            return Fraction(0)
        above = prod(prod(range(k - 1, 0, -2)) for k in own)
        result *= Fraction(above, prod(range(len(own), len(own) + sum(own) - 1, 2)))
    return result
