"""What holds rigorously, whatever the solver said.

A sum-of-squares constraint claims f = c + C d >= 0 on its domain, f being the polynomial through the values at the
nodes. With Gram matrices Q_k and the polynomial e = f - sum_k g_k p_k'Q_k p_k that they leave,

    f(z) >= lambda K - sqrt(K') |e|,      lambda = least eigenvalue of the Q_k,  K = sum_k g_k |p_k|^2,

because the sum K is constant on the domain, and because the orthonormal functions of degree 2d add up in square to at
most a constant K' (`aerotube.sos.domain`); |e| is the Euclidean norm of e's coefficients. The residual is first folded
into the Gram matrices by the change of least norm. All terms are widened by bounds of the rounding of their own
evaluation (N. J. Higham, "Accuracy and Stability of Numerical Algorithms", chapters 3 and 4).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from aerotube.sos.basis import Block, Polynomial, Sampling, nodes_and_basis, orthonormal_basis, sampling
from aerotube.sos.domain import Array, Domain

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from aerotube.sos.solution import Solution

_UNIT = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Certificate:
    """Rigorous margins of every constraint at the decisions of a solution.

    Attributes
    ----------
    solution : Solution
    margins : dict of (...)
        A lower bound of each constraint's value: of f over the whole domain, of the least eigenvalue, of the bound less
        the norm, of the least slack. Not negative: the constraint is certified.
    least : dict of (...)
        Least eigenvalue of the Gram matrices of each sum-of-squares constraint, rounding allowed for.
    grams : dict of tuple of (..., N, N)
        Gram matrices with the residual folded in.
    kind : str
        ``"polynomial"``: the claim is about the polynomials through the data, not about what they stand for.
    """

    solution: Solution
    margins: Mapping[str, Array]
    least: Mapping[str, Array]
    grams: Mapping[str, tuple[Array, ...]]
    kind: str = "polynomial"

    @property
    def holds(self) -> NDArray[np.bool_]:
        """Whether every constraint is certified, (...)."""
        total = np.ones(self.solution.data.batch, dtype=bool)
        for margin in self.margins.values():
            total &= margin >= 0.0
        return total

    @property
    def bound(self) -> Array:
        """Certified objective (...): reached by a decision that satisfies every constraint; inf where none is known."""
        return np.asarray(np.where(self.holds, self.solution.objective, np.inf))

    def deficit(self, name: str) -> Array:
        """How far below zero a constraint's value may fall, (...); 0 where it is certified."""
        return np.maximum(0.0, -self.margins[name])

    def save(self, path: str | Path, position: tuple[int, ...] = ()) -> None:
        """Write the certificate of one program of the batch, to be checked by `aerotube.sos.check.check_file`.

        Parameters
        ----------
        path : file to write, whole or not at all
        position : place in the batch
        """
        from aerotube.sos.certificate_file import save

        save(self, path, position)


def certify(solution: Solution) -> Certificate:
    """Certify the decisions of a solution, optimal or not."""
    margins: dict[str, Array] = {}
    least: dict[str, Array] = {}
    grams: dict[str, tuple[Array, ...]] = {}
    data = solution.data
    for c in data.structure.constraints:
        arrays = data.constraints[c.name]
        if c.kind == "sos":
            margins[c.name], least[c.name], grams[c.name] = _certify_sos(
                solution.structure.sampling(c.name), arrays, solution.values, solution.grams[c.name]
            )
        else:
            margins[c.name] = np.broadcast_to(_direct_margin(c.kind, arrays, solution.values), data.batch)
    return Certificate(solution, margins, least, grams)


def _direct_margin(kind: str, arrays: Mapping[str, Array], d: Array) -> Array:
    """Lower bound of a constraint's value by evaluating it, rounding allowed for."""
    m = d.shape[-1]
    if kind in ("lmi", "logdet"):
        value = arrays["F0"] + np.einsum("...i,...ijk->...jk", d, arrays["F"])
        size = np.abs(arrays["F0"]) + np.einsum("...i,...ijk->...jk", np.abs(d), np.abs(arrays["F"]))
        order = value.shape[-1]
        slip = _UNIT * (m + 4 * order + 2) * np.linalg.norm(size, axis=(-2, -1))
        return np.asarray(np.linalg.eigvalsh(0.5 * (value + np.swapaxes(value, -1, -2)))[..., 0] - slip)
    value = np.einsum("...ri,...i->...r", arrays["A"], d)
    size = np.einsum("...ri,...i->...r", np.abs(arrays["A"]), np.abs(d)) + np.abs(arrays["b"])
    if kind == "linear":
        return np.asarray(np.min(arrays["b"] - value - _UNIT * (m + 2) * size, axis=-1))
    top = np.einsum("...i,...i->...", arrays["g"], d) + arrays["h"]
    top_size = np.einsum("...i,...i->...", np.abs(arrays["g"]), np.abs(d)) + np.abs(arrays["h"])
    slip = _UNIT * (m + value.shape[-1] + 4) * (np.linalg.norm(size, axis=-1) + top_size)
    return np.asarray(top - np.linalg.norm(value + arrays["b"], axis=-1) - slip)


def _certify_sos(
    found: Sampling, arrays: Mapping[str, Array], d: Array, grams: tuple[Array, ...]
) -> tuple[Array, Array, tuple[Array, ...]]:
    """Margin and least eigenvalue (...), and folded Gram matrices."""
    f, slip = _values(arrays, d, np.float64)
    folded = _fold(found, f - _gram_values(found, grams, np.float64)[0], grams)
    least = _least_eigenvalues(folded)
    floor = _floor(found, folded, least)
    margin = floor - _left_over(found, f, slip, folded, np.float64)
    short = margin < 0.0
    if np.any(short):
        # The rounding bound may be all that is in the way: evaluate the rest in extended precision.
        f, slip = _values(arrays, d, np.longdouble)
        margin = np.maximum(margin, floor - _left_over(found, f, slip, folded, np.longdouble))
    return margin, np.min(least, axis=0), folded


def _values(arrays: Mapping[str, Array], d: Array, kind: Any) -> tuple[Any, Array]:
    """Values (..., U) of f at the nodes, and a bound of their rounding."""
    C, c, e = arrays["C"].astype(kind), arrays["c"].astype(kind), d.astype(kind)
    f = np.sum(C * e[..., None, :], axis=-1) + c if kind is np.longdouble else c + np.einsum("...ui,...i->...u", C, e)
    size = np.abs(arrays["c"]) + np.einsum("...ui,...i->...u", np.abs(arrays["C"]), np.abs(d))
    return f, np.asarray(float(np.finfo(kind).eps) * (d.shape[-1] + 2) * size)


def _gram_values(found: Sampling, grams: tuple[Array, ...], kind: Any) -> tuple[Any, Array]:
    """Values (..., U) of sum_k g_k p_k'Q_k p_k at the nodes, and a bound of their rounding."""
    total: Any = 0.0
    slip: Any = 0.0
    for block, gram in zip(found.blocks, grams, strict=True):
        p, order = block.rows.astype(kind), block.rows.shape[1]
        total = total + block.weights * np.sum((p @ gram.astype(kind)) * p, axis=-1)
        length = np.abs(block.weights) * np.sum(block.rows**2, axis=1)
        norm = np.linalg.norm(gram, axis=(-2, -1))[..., None]
        slip = slip + float(np.finfo(kind).eps) * (2 * order + 4) * length * norm
    return total, slip


def _left_over(found: Sampling, f: Any, slip: Array, grams: tuple[Array, ...], kind: Any) -> Array:
    """Upper bound (...) on the domain of |f - sum_k g_k p_k'Q_k p_k|."""
    squares, more = _gram_values(found, grams, kind)
    e = np.abs(np.asarray(f - squares, dtype=np.float64))
    coefficients = np.asarray(f - squares, dtype=np.float64) @ found.inverse.T
    size = float(np.linalg.norm(found.inverse, 2)) * np.linalg.norm(
        slip + more + 4 * _UNIT * len(found.nodes) * e, axis=-1
    )
    return np.asarray(np.sqrt(_square_sum(found.domain, found.degree)) * (np.linalg.norm(coefficients, axis=-1) + size))


@lru_cache(maxsize=64)
def _inverse_norm(domain: Domain, degree: int) -> float:
    """Upper bound of the Euclidean norm of the map from values at the nodes to coefficients."""
    return 1.000001 * float(np.linalg.norm(nodes_and_basis(domain, degree)[2], 2))


@lru_cache(maxsize=64)
def _square_sum(domain: Domain, degree: int) -> float:
    """Upper bound on the domain of the sum of squares of the orthonormal functions of that degree.

    It is the number of all such functions on the lifted spheres: those even in every lifted coordinate live on the
    domain, and the others are functions of lower degree times the lifted coordinates they are odd in.
    """
    total = 0
    for count in range(min(len(domain.balls), degree) + 1):
        total += sum(len(domain.exponents(degree - count)) for _ in combinations(domain.balls, count))
    return 1.000001 * total


def _fold(found: Sampling, residual: Array, grams: tuple[Array, ...]) -> tuple[Array, ...]:
    """Change the Gram matrices as little as removes the residual (..., U) at the nodes."""
    nu = residual @ _normal_inverse(found.domain, found.degree, tuple(b.weight for b in found.blocks if b.weight))
    return tuple(
        gram + np.einsum("ui,...u,uj->...ij", block.rows, nu * block.weights, block.rows, optimize=True)
        for block, gram in zip(found.blocks, grams, strict=True)
    )


@lru_cache(maxsize=32)
def _normal_inverse(domain: Domain, degree: int, weights: tuple[Polynomial, ...]) -> Array:
    """Inverse (U, U) of A A', the map from multipliers at the nodes to values of their least-norm Gram matrices."""
    normal: Any = 0.0
    for block in sampling(domain, degree, weights).blocks:
        normal = normal + np.outer(block.weights, block.weights) * (block.rows @ block.rows.T) ** 2
    return np.asarray(np.linalg.inv(normal))


def _least_eigenvalues(grams: tuple[Array, ...]) -> list[Array]:
    least = []
    for gram in grams:
        gram = 0.5 * (gram + np.swapaxes(gram, -1, -2))
        slip = 4.0 * _UNIT * gram.shape[-1] * np.linalg.norm(gram, axis=(-2, -1))
        least.append(np.linalg.eigvalsh(gram)[..., 0] - slip)
    return least


def _floor(found: Sampling, grams: tuple[Array, ...], least: list[Array]) -> Array:
    """Lower bound (...) on the domain of sum_k g_k p_k'Q_k p_k."""
    domain_least = np.min([x for x, block in zip(least, found.blocks, strict=True) if block.weight is None], axis=0)
    sum_of_squares = found.product_bound() * (1.0 - 1e-12 * np.sign(domain_least))
    total = domain_least * sum_of_squares
    for x, block in zip(least, found.blocks, strict=True):
        if block.weight is not None:
            total = total + np.minimum(0.0, x) * _largest(block)
    return np.asarray(total)


def _largest(block: Block) -> float:
    """Upper bound on the domain of |g| |p|^2 for a block with a weight of the user's."""
    weight = 1.0 if block.weight is None else float(np.sum(np.abs(block.weight.coefficients)))
    full = orthonormal_basis(block.basis.domain, block.basis.degree)
    return weight * _square_sum(full.domain, full.degree) * 1.000001


def polynomial_of(found: Sampling, values: Array) -> Array:
    """Coefficients (k,) in the monomials of the sampling's basis of the polynomial through values (U,)."""
    _, basis, inverse = nodes_and_basis(found.domain, found.degree)
    return np.asarray((inverse @ values) @ basis.matrix)
