"""What holds rigorously, whatever the solver said.

A sum-of-squares constraint claims f = c + C d >= 0 on its domain, f being the polynomial through the values at the
nodes. With Gram matrices Q_k and the polynomial e = f - sum_k g_k p_k'Q_k p_k that they leave,

    f(z) >= lambda K - sqrt(K') |e|,      lambda = least eigenvalue of the Q_k,  K = sum_k g_k |p_k|^2,

because the sum K is constant on the domain, and because the orthonormal functions of degree 2d add up in square to at
most a constant K' (`aerotube.sos.domain`); |e| is the Euclidean norm of e's coefficients. The residual is first folded
into the Gram matrices by the change of least norm. All terms are widened by bounds of the rounding of their own
evaluation (N. J. Higham, "Accuracy and Stability of Numerical Algorithms", chapters 3 and 4), of underflow, and of what
nodes, bases and weights differ by from what they stand for (`aerotube.sos.accuracy`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from aerotube.sos.accuracy import TINY, UNIT, accuracy
from aerotube.sos.basis import Polynomial, Sampling, sampling
from aerotube.sos.domain import Array, Domain

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from aerotube.sos.solution import Solution


_LARGE = 1 << 18  # entries


@dataclass(frozen=True, eq=False)
class Certificate:
    """Rigorous margins of every constraint at the decisions of a solution.

    Attributes
    ----------
    solution : Solution
    margins : dict of (...)
        A lower bound of each constraint's value: of f over the part of the domain where the user's weights are not
        negative (all of it without such weights), of the least eigenvalue, of the bound less the norm, of the least
        slack. Not negative: the constraint is certified. -inf where the decision or a Gram matrix is not finite.
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
        """Objective, as rounded, of a decision certified to satisfy every constraint (...); inf where none is known."""
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
    """Certify the decisions of a solution, optimal or not; nothing where a number is not finite."""
    margins: dict[str, Array] = {}
    least: dict[str, Array] = {}
    grams: dict[str, tuple[Array, ...]] = {}
    data = solution.data
    sound = np.all(np.isfinite(solution.values), axis=-1)
    d = np.where(sound[..., None], solution.values, 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        for names in _alike(solution):
            depth = len(data.batch)
            some = {
                key: _stacked([data.constraints[name][key] for name in names], depth + last)
                for key, last in (("c", 1), ("C", 2))
            }
            each = zip(*(solution.grams[name] for name in names), strict=True)
            given = tuple(_stacked(grams_of_block, depth + 2) for grams_of_block in each)
            found = _certify_sos(solution.structure.sampling(names[0]), some, d, given)
            for place, name in enumerate(names):
                margins[name], least[name] = found[0][place], found[1][place]
                grams[name] = tuple(gram[place] for gram in found[2])
        for c in data.structure.constraints:
            if c.kind != "sos":
                margins[c.name] = _direct_margin(c.kind, data.constraints[c.name], d)
    # in the order of the program; a bound that overflowed on its way is none
    margins = {
        c.name: np.where(sound & np.isfinite(margins[c.name]), margins[c.name], -np.inf)
        for c in data.structure.constraints
    }
    return Certificate(solution, margins, least, grams)


def _alike(solution: Solution) -> list[list[str]]:
    """Names of the sum-of-squares constraints, together where nodes, bases and the shapes of the data are the same.

    Small ones are looked at together, in a fraction of the time; there is nothing to gain where arrays are large.
    """
    groups: dict[Any, list[str]] = {}
    for c in solution.structure.constraints:
        if c.kind != "sos":
            continue
        own = solution.structure.sampling(c.name)
        arrays = solution.data.constraints[c.name]
        large = arrays["C"].size > _LARGE
        shapes = arrays["c"].shape, arrays["C"].shape, *(gram.shape for gram in solution.grams[c.name])
        groups.setdefault(c.name if large else (id(own), shapes), []).append(c.name)
    return list(groups.values())


def _stacked(arrays: Sequence[Array], axes: int) -> Array:
    """Arrays of one shape on a new first axis, their batch axes filled up to so many axes each."""
    shape = arrays[0].shape
    return np.stack(arrays).reshape(len(arrays), *(1,) * (axes - len(shape)), *shape)


def _length(x: Array, axes: int | tuple[int, ...] = -1) -> Array:
    """Euclidean norm over axes, whatever the scale: squares of small or large entries neither vanish nor overflow."""
    top = np.max(np.abs(x), axis=axes, keepdims=True, initial=0.0)
    scale = np.where((top > 0.0) & np.isfinite(top), top, 1.0)
    return np.asarray(np.squeeze(scale, axis=axes) * np.linalg.norm(x / scale, axis=axes))


def least_eigenvalue(matrix: Array) -> Array:
    """Least eigenvalue (...) of matrices' symmetric parts, rounding allowed for; -inf where an entry is not finite."""
    matrix = 0.5 * (matrix + np.swapaxes(matrix, -1, -2))
    size = _length(matrix, (-2, -1))
    sound = np.isfinite(size)
    value = np.linalg.eigvalsh(np.where(sound[..., None, None], matrix, 0.0))[..., 0]
    slip = 4.0 * UNIT * matrix.shape[-1] * size + (size > 0.0) * (TINY * matrix.shape[-1])
    return np.asarray(np.where(sound, value - slip, -np.inf))


def _any(x: Array, last: int = 1) -> NDArray[np.bool_]:
    """Whether a number other than zero is in the last axes: where all are zero nothing is rounded."""
    return np.asarray(np.any(x != 0.0, axis=tuple(range(-last, 0))))


def _direct_margin(kind: str, arrays: Mapping[str, Array], d: Array) -> Array:
    """Lower bound of a constraint's value by evaluating it, rounding and underflow allowed for."""
    m = d.shape[-1]
    if kind in ("lmi", "logdet"):
        value = arrays["F0"] + np.einsum("...i,...ijk->...jk", d, arrays["F"])
        size = np.abs(arrays["F0"]) + np.einsum("...i,...ijk->...jk", np.abs(d), np.abs(arrays["F"]))
        order = value.shape[-1]
        slip = UNIT * (m + 4 * order + 4) * _length(size, (-2, -1))
        slip = slip + _any(arrays["F"], last=3) * (TINY * (m + 2) * order)
        return np.asarray(least_eigenvalue(value) - slip)
    value = np.einsum("...ri,...i->...r", arrays["A"], d)
    size = np.einsum("...ri,...i->...r", np.abs(arrays["A"]), np.abs(d)) + np.abs(arrays["b"])
    if kind == "linear":
        slip = UNIT * (m + 4) * size + _any(arrays["A"]) * (TINY * (m + 2))
        return np.asarray(np.min(arrays["b"] - value - slip, axis=-1))
    top = np.einsum("...i,...i->...", arrays["g"], d) + arrays["h"]
    top_size = np.einsum("...i,...i->...", np.abs(arrays["g"]), np.abs(d)) + np.abs(arrays["h"])
    rows = value.shape[-1]
    slip = UNIT * (m + rows + 8) * (_length(size) + top_size)
    slip = slip + (_any(arrays["A"], last=2) | _any(arrays["g"])) * (TINY * (m + 2) * (rows + 1))
    return np.asarray(top - _length(value + arrays["b"]) - slip)


def _certify_sos(
    found: Sampling, arrays: Mapping[str, Array], d: Array, grams: tuple[Array, ...]
) -> tuple[Array, Array, tuple[Array, ...]]:
    """Margin and least eigenvalue (...), and folded Gram matrices."""
    f, slip = _values(arrays, d, np.float64)
    sound = np.all([np.all(np.isfinite(gram), axis=(-2, -1)) for gram in grams], axis=0)
    grams = tuple(np.where(sound[..., None, None], gram, 0.0) for gram in grams)
    folded = _fold(found, f - _gram_values(found, grams, np.float64)[0], grams)
    least = [least_eigenvalue(gram) for gram in folded]
    floor = _floor(found, least)
    margin = _below(floor, _left_over(found, f, slip, folded, np.float64))
    short = np.broadcast_to(sound & (margin < 0.0), margin.shape)
    if np.any(short):
        # The rounding bound may be all that is in the way: evaluate the rest in extended precision.
        few = [np.broadcast_to(gram, (*margin.shape, *gram.shape[-2:]))[short] for gram in folded]
        own = {
            key: np.broadcast_to(array, (*margin.shape, *array.shape[array.ndim - last :]))[short]
            for key, array, last in (("c", arrays["c"], 1), ("C", arrays["C"], 2))
        }
        f, slip = _values(own, np.broadcast_to(d, (*margin.shape, d.shape[-1]))[short], np.longdouble)
        margin = margin.copy()
        margin[short] = np.maximum(
            margin[short], _below(floor[short], _left_over(found, f, slip, tuple(few), np.longdouble))
        )
    return np.where(sound, margin, -np.inf), np.min(least, axis=0), folded


def _below(floor: Array, left: Array) -> Array:
    """The difference, rounded down."""
    return np.asarray(floor - left - 4.0 * UNIT * (np.abs(floor) + left))


def _values(arrays: Mapping[str, Array], d: Array, kind: Any) -> tuple[Any, Array]:
    """Values (..., U) of f at the nodes, and a bound of their rounding."""
    C, c, e = arrays["C"].astype(kind), arrays["c"].astype(kind), d.astype(kind)
    f = np.sum(C * e[..., None, :], axis=-1) + c if kind is np.longdouble else c + np.einsum("...ui,...i->...u", C, e)
    size = np.abs(arrays["c"]) + np.einsum("...ui,...i->...u", np.abs(arrays["C"]), np.abs(d))
    m = d.shape[-1]
    return f, np.asarray(float(np.finfo(kind).eps) * (m + 2) * size + _any(arrays["C"]) * (TINY * (m + 2)))


def _gram_values(found: Sampling, grams: tuple[Array, ...], kind: Any) -> tuple[Any, Array]:
    """Values (..., U) of sum_k g_k p_k'Q_k p_k at the nodes, and a bound of how far they are from the reduced ones."""
    total: Any = 0.0
    slip: Any = 0.0
    fine = kind is np.longdouble
    for block, own, gram in zip(found.blocks, accuracy(found).blocks, grams, strict=True):
        p, g = (own.rows, own.weights) if fine else (block.rows, block.weights)
        total = total + g * np.sum((p @ gram.astype(kind)) * p, axis=-1)
        slip = slip + (own.slip_fine if fine else own.slip) * _length(gram, (-2, -1))[..., None]
        slip = slip + _any(gram, last=2)[..., None] * (TINY * gram.shape[-1] ** 2) * (1.0 + own.length)
    return total, slip


def _left_over(found: Sampling, f: Any, slip: Array, grams: tuple[Array, ...], kind: Any) -> Array:
    """Upper bound (...) on the domain of |f - sum_k g_k p_k'Q_k p_k|."""
    squares, more = _gram_values(found, grams, kind)
    bounds, count = accuracy(found), len(found.nodes)
    e = np.asarray(f - squares, dtype=np.float64)
    size = bounds.inverse * _length(slip + more + UNIT * (count + 6) * np.abs(e))
    size = size + bounds.trust * _length(e @ found.inverse.T) + np.any(e != 0.0, axis=-1) * (TINY * count**2)
    return np.asarray(np.sqrt(bounds.square_sum) * size)


def _fold(found: Sampling, residual: Array, grams: tuple[Array, ...]) -> tuple[Array, ...]:
    """Change the Gram matrices as little as removes the residual (..., U) at the nodes."""
    nu = residual @ normal_inverse(found.domain, found.degree, tuple(b.weight for b in found.blocks if b.weight))
    return tuple(
        gram + (block.rows.T * (nu * block.weights)[..., None, :]) @ block.rows
        for block, gram in zip(found.blocks, grams, strict=True)
    )


@lru_cache(maxsize=32)
def normal_inverse(domain: Domain, degree: int, weights: tuple[Polynomial, ...]) -> Array:
    """Inverse (U, U) of A A', the map from multipliers at the nodes to values of their least-norm Gram matrices."""
    normal: Any = 0.0
    for block in sampling(domain, degree, weights).blocks:
        normal = normal + np.outer(block.weights, block.weights) * (block.rows @ block.rows.T) ** 2
    return np.asarray(np.linalg.inv(normal))


def _floor(found: Sampling, least: list[Array]) -> Array:
    """Lower bound (...) on the domain of sum_k g_k p_k'Q_k p_k."""
    bounds = accuracy(found)
    domain_least = np.min([x for x, block in zip(least, found.blocks, strict=True) if block.weight is None], axis=0)
    total = domain_least * found.product_bound() * (1.0 - bounds.wobble * np.sign(domain_least))
    for x, block, own in zip(least, found.blocks, bounds.blocks, strict=True):
        if block.weight is not None:
            total = total + np.minimum(0.0, x) * own.largest
    return np.asarray(total)
