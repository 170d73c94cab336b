r"""What a tube's bound leaves out of the error map, bounded and shown apart.

An enclosure :math:`|f_i(z) - P_i(z)| \le r_i` of the error map turns a bound of the polynomial's size,
:math:`P^T E_1 P \le \rho`, into one of the map's, by the triangle inequality of the norm
:math:`\|x\| = \sqrt{x^T E_1 x}`: :math:`f^T E_1 f \le (\sqrt\rho + \delta)^2`, where :math:`\delta` bounds all that
the bound of the polynomial did not look at: the remainder, terms in the errors of another part, terms that are not
affine in a parameter, measurement errors and wind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerotube.dynamics.enclosure import ErrorEnclosure
from aerotube.errors import InputError
from aerotube.numerics.taylor import Taylor
from aerotube.numerics.taylor_model import SLACK, ModelSpace

Array = NDArray[np.float64]

_ROOT_TOLERANCE = 1e-9
_CORNERS = 10  # intervals whose corners are all looked at
_UNIT = 2.0**-53


@dataclass(frozen=True)
class Excess:
    r"""By how much, in the norm of a metric, the error map may leave what a bound of its polynomial looked at.

    Attributes
    ----------
    remainder : ndarray (b,)
        Of the Taylor models: truncation, kinks, rounding.
    coupling : ndarray (b,)
        Terms in the errors of other parts, which the part's own polynomial takes as zero.
    parameters : ndarray (b,)
        Terms that are not affine in each parameter, so that its extremes need not be the worst.
    measurement, gusts : ndarray (b,)
        Terms in measurement errors, and terms in the wind and all else.
    coupling_size : ndarray (b,)
        Another bound of the same: what those terms add to the size itself, in which they need not line up with the
        part's own error as a norm must assume. `bound` takes whichever gives less.
    control : ndarray (b,)
        Nonlinearity of the increment's effect, which a program affine in the law leaves out. Zero unless the
        enclosure without the law was given; B is then the one in that polynomial.
    """

    remainder: Array
    coupling: Array
    coupling_size: Array
    parameters: Array
    measurement: Array
    gusts: Array
    control: Array

    @property
    def disturbances(self) -> Array:
        """Terms in measurement errors and wind (b,)."""
        return np.asarray((self.measurement + self.gusts) * SLACK)

    @property
    def total(self) -> Array:
        """Sum of all shares (b,), each as a norm."""
        shares = self.remainder + self.coupling + self.parameters + self.disturbances + self.control
        return np.asarray(shares * SLACK)

    def bound(self, rho: ArrayLike) -> Array:
        """Bound (b,) of the map's size where its polynomial's is at most `rho` (b,)."""
        own = np.sqrt(np.asarray(rho, dtype=float)) + self.parameters
        coupled = np.minimum(own + self.coupling, np.sqrt(own**2 + self.coupling_size))
        size = (coupled + self.remainder + self.disturbances + self.control) ** 2
        return np.asarray(size * (SLACK + 4.0 * _ROOT_TOLERANCE))


def excess(
    enclosure: ErrorEnclosure,
    metric: Array,
    part: str,
    errors: Sequence[int],
    others: Sequence[str] = (),
    parameters: Sequence[str] = (),
    without_law: ErrorEnclosure | None = None,
) -> Excess:
    """What a part's polynomial bound leaves out, share by share, in the norm of its metric.

    Parameters
    ----------
    enclosure : ErrorEnclosure
        With the law.
    metric : ndarray (b, n, n)
        ``E1`` of the part's error components.
    part : str
        The ball of the part's own errors.
    errors : sequence of int, length n
        Its error components.
    others : sequence of str
        Balls of other parts.
    parameters : sequence of str
        Balls of parameters, at whose extremes the polynomial's bound holds. Balls not named anywhere count as
        disturbances.
    without_law : ErrorEnclosure, optional
        Of the same set and order without the law: asks for the share `Excess.control`, for bounds of
        ``r + B K z`` in place of the closed loop.

    Returns
    -------
    Excess
    """
    root, terms, rounding = _in_metric(enclosure.coefficients, metric, errors)
    own, elsewhere = enclosure.degree(part), enclosure.degree(*others)
    known = {part, *others, *parameters}
    unknown = [name for name in enclosure.set.names if name not in known]
    noises = [name for name in unknown if name.startswith("measurement")]
    airs = [name for name in unknown if name not in noises]
    disturbed, blown = enclosure.degree(*unknown), enclosure.degree(*airs)
    bent = np.zeros(enclosure.space.size, dtype=bool)
    for name in parameters:
        bent |= enclosure.degree(name) >= 2
    norm, alone = _VectorNorm(enclosure.space), (elsewhere == 0) & (disturbed == 0)
    control = np.zeros(len(terms))
    if without_law is not None:
        difference = root @ (enclosure.coefficients - without_law.coefficients)[:, list(errors)]
        control = norm(difference, 2.0 * rounding, (own >= 2) & alone & ~bent)
    # the coefficients in the metric are rounded too
    every = norm(np.zeros_like(terms), rounding, np.ones(enclosure.space.size, dtype=bool))
    return Excess(
        remainder=(_box_size(root, enclosure.remainder[:, list(errors)]) + every) * (SLACK + _ROOT_TOLERANCE),
        coupling=norm(terms, rounding, (elsewhere > 0) & (disturbed == 0)),
        coupling_size=_coupling_size(enclosure, terms, rounding, alone, (elsewhere > 0) & (disturbed == 0)),
        parameters=norm(terms, rounding, bent & alone),
        measurement=_disturbance(enclosure, terms, rounding, noises, (disturbed > 0) & (blown == 0)),
        gusts=_disturbance(enclosure, terms, rounding, airs, blown > 0),
        control=control,
    )


def _disturbance(
    enclosure: ErrorEnclosure, terms: Array, rounding: Array, names: Sequence[str], mask: NDArray[np.bool_]
) -> Array:
    """Bound (b,) of the norm of some terms (b, n, size); the linear ones in intervals are largest at a corner."""
    norm = _VectorNorm(enclosure.space)
    columns = np.array(
        [enclosure.set.columns(name).start for name in names if _length(enclosure, name) == 1], dtype=int
    )
    if not 1 < len(columns) <= _CORNERS:
        return norm(terms, rounding, mask)
    first = np.zeros(enclosure.space.size, dtype=bool)
    first[1 + columns] = True
    signs = np.array([(1.0, *s) for s in product((1.0, -1.0), repeat=len(columns) - 1)])
    ends = np.linalg.norm(terms[:, :, 1 + columns] @ signs.T, axis=1).max(axis=1)
    slip = np.linalg.norm(rounding[:, :, 1 + columns].sum(axis=2), axis=1)
    slip += len(columns) * 4.0 * _UNIT * np.abs(terms[:, :, 1 + columns]).sum(axis=(1, 2))
    return np.asarray((ends + slip) * (SLACK + _ROOT_TOLERANCE) + norm(terms, rounding, mask & ~first))


def _length(enclosure: ErrorEnclosure, name: str) -> int:
    columns = enclosure.set.columns(name)
    return columns.stop - columns.start


def _coupling_size(
    enclosure: ErrorEnclosure,
    terms: Array,
    rounding: Array,
    own: NDArray[np.bool_],
    coupled: NDArray[np.bool_],
) -> Array:
    """Bound (b,) of the squared norm of terms (b, n, size), own and coupled, less that of their own ones alone."""
    space, norm = enclosure.space, _VectorNorm(enclosure.space)
    if not coupled.any():
        return np.zeros(len(terms))
    chosen = Taylor(space.taylor, terms * (own | coupled))
    square = (chosen * chosen).coefficients.sum(axis=1, keepdims=True)
    kept = norm(square, np.zeros_like(square), coupled)
    # what the product of polynomials cuts off
    degrees = enclosure.degree(*enclosure.set.names)
    alone, mixed = (
        [norm(terms, rounding, mask & (degrees == k)) for k in range(space.order + 1)] for mask in (own, coupled)
    )
    cut = np.zeros(len(terms))
    for i, j in product(range(space.order + 1), repeat=2):
        if i + j > space.order:
            cut += mixed[i] * (alone[j] + mixed[j]) + alone[i] * mixed[j]
    return np.asarray((kept + cut + _square_rounding(space, terms, rounding)) * SLACK)


def _square_rounding(space: ModelSpace, terms: Array, rounding: Array) -> Array:
    """Bound (b,) of the rounding of the squared norm of polynomials (b, n, size), by products or at points.

    No more than `size` products of coefficients, or of coefficients and monomials, are added up, and their absolute
    values are at most those of the sums of all coefficients.
    """
    largest = np.sqrt(space.layout.weights)
    whole = np.abs(terms * largest).sum(axis=(1, 2))
    return np.asarray(
        (space.size + 64.0) * 2.0 * _UNIT * whole**2 + 2.0 * whole * (rounding * largest).sum(axis=(1, 2))
    )


@dataclass(frozen=True)
class SizeSamples:
    """The size of a part's polynomial at nodes, its terms above a degree left out and bounded.

    Attributes
    ----------
    values : ndarray (b, k, U)
        Of the terms up to the degree, at each extreme of the parameters: exactly a polynomial of that degree.
    left_out : ndarray (b,)
        Bound of the absolute value of the other terms, over the whole ball.
    rounding : ndarray (b,)
        Bound of the rounding of each value, at nodes within the unit ball.
    """

    values: Array
    left_out: Array
    rounding: Array


def size_samples(
    enclosure: ErrorEnclosure,
    metric: Array,
    part: str,
    errors: Sequence[int],
    parameters: Sequence[str],
    nodes: Array,
    degree: int = 4,
) -> SizeSamples:
    r"""Sample the size of a part's polynomial for a sum-of-squares bound that is free of interpolation error.

    With :math:`\hat P = \sum_k \hat P_k` the parts of each degree in the part's own errors, every other ball but the
    parameters' at its centre, the terms :math:`\hat P_i \cdot \hat P_j` of ``i + j <= degree`` are sampled.

    Parameters
    ----------
    enclosure : ErrorEnclosure
    metric : ndarray (b, n, n)
    part : str
        The ball of the part's own errors.
    errors : sequence of int, length n
    parameters : sequence of str
        Balls taken at their extremes.
    nodes : ndarray (U, n)
        Points of the part's ball.
    degree : int

    Returns
    -------
    SizeSamples
    """
    space, own = enclosure.space, enclosure.degree(part)
    _, terms, rounding = _in_metric(enclosure.coefficients, metric, errors)
    kept = enclosure.degree(part, *parameters) == space.taylor.exponents.sum(axis=1)
    norm = _VectorNorm(space)
    sizes = [norm(terms, rounding, kept & (own == k)) for k in range(space.order + 1)]
    left_out = np.zeros(len(terms))
    for i, j in product(range(space.order + 1), repeat=2):
        if i + j > degree:
            left_out += sizes[i] * sizes[j]

    points = np.zeros((2 ** len(parameters), len(nodes), space.taylor.variables))
    points[..., enclosure.set.columns(part)] = nodes
    for row, signs in zip(points, product((-1.0, 1.0), repeat=len(parameters)), strict=True):
        for name, sign in zip(parameters, signs, strict=True):
            row[..., enclosure.set.columns(name)] = sign
    monomials = space.taylor.monomials(points)
    graded = [
        np.einsum("bit,kut->bkui", terms, monomials * (kept & (own == k)), optimize=True)
        for k in range(space.order + 1)
    ]
    values = sum(
        (
            np.einsum("bkui,bkui->bku", graded[i], graded[j])
            for i, j in product(range(space.order + 1), repeat=2)
            if i + j <= degree
        ),
        np.zeros(graded[0].shape[:3]),
    )
    return SizeSamples(values, left_out * SLACK, _square_rounding(space, terms, rounding))


def graded_sizes(enclosure: ErrorEnclosure, metric: Array, errors: Sequence[int]) -> Array:
    """Bounds of the norm, in a metric, of the polynomial's part of each degree.

    Parameters
    ----------
    enclosure : ErrorEnclosure
    metric : ndarray (b, n, n)
        ``E1`` of the error components asked for.
    errors : sequence of int, length n

    Returns
    -------
    ndarray (b, order + 1)
    """
    _, terms, rounding = _in_metric(enclosure.coefficients, metric, errors)
    norm, degrees = _VectorNorm(enclosure.space), enclosure.degree(*enclosure.set.names)
    return np.stack([norm(terms, rounding, degrees == k) for k in range(enclosure.space.order + 1)], axis=1)


def component_norms(enclosure: ErrorEnclosure, errors: Sequence[int], mask: NDArray[np.bool_]) -> Array:
    """Bounds of the absolute value of some terms of components of the polynomial.

    Parameters
    ----------
    enclosure : ErrorEnclosure
    errors : sequence of int, length n
    mask : bool (size,)
        The terms.

    Returns
    -------
    ndarray (b, n)
    """
    norm, terms = _VectorNorm(enclosure.space), enclosure.coefficients[:, list(errors)]
    beats, n, size = terms.shape
    exact = np.zeros((beats * n, 1, size))
    return norm(terms.reshape(beats * n, 1, size), exact, mask).reshape(beats, n)


def _in_metric(coefficients: Array, metric: Array, errors: Sequence[int]) -> tuple[Array, Array, Array]:
    """Root of the metric, the coefficients (b, n, size) times it, and a bound of the rounding of that product."""
    root, chosen = _root(metric), coefficients[:, list(errors)]
    return root, root @ chosen, 16.0 * _UNIT * np.abs(root) @ np.abs(chosen)


class _VectorNorm:
    """Bounds, over the domain, of the Euclidean norm of vectors of polynomials, some of their terms taken.

    The monomials of one degree in each ball, times the roots of their multinomial coefficients, make a vector of
    norm at most one, so that the largest singular value of the coefficients bounds the norm; so does that of the
    coefficients folded about a ball in which they are linear.
    """

    def __init__(self, space: ModelSpace) -> None:
        self.layout = space.layout
        self.exponents = space.taylor.exponents
        starts = np.cumsum((0, *space.balls))
        self.balls = [slice(int(low), int(high)) for low, high in pairwise(starts)]

    def __call__(self, terms: Array, rounding: Array, mask: NDArray[np.bool_]) -> Array:
        """Of coefficients (b, n, size) known up to `rounding` (b, n, size): ndarray (b,)."""
        total, weights = np.zeros(len(terms)), np.sqrt(self.layout.weights)
        for kind in np.unique(self.layout.classes[mask]):
            chosen = np.flatnonzero(mask & (self.layout.classes == kind))
            weighted = terms[:, :, chosen] * weights[chosen]
            least = _spectral(weighted)
            for ball in self.balls:
                if self.exponents[chosen[0], ball].sum() == 1:
                    least = np.minimum(least, _spectral(self._folded(weighted, chosen, ball)))
            total += least + np.linalg.norm(rounding[:, :, chosen], axis=(1, 2))
        return np.asarray(total * (SLACK + _ROOT_TOLERANCE))

    def _folded(self, weighted: Array, chosen: NDArray[np.intp], ball: slice) -> Array:
        """Coefficients (b, n * other monomials, variables of the ball) of monomials linear in the ball."""
        own = self.exponents[chosen, ball].argmax(axis=1)
        rest = self.exponents[chosen].copy()
        rest[:, ball] = 0
        kinds, other = np.unique(rest, axis=0, return_inverse=True)
        folded = np.zeros((*weighted.shape[:2], len(kinds), ball.stop - ball.start))
        folded[:, :, other.reshape(-1), own] = weighted
        return folded.reshape(len(weighted), -1, folded.shape[-1])


def _spectral(matrices: Array) -> Array:
    """Largest singular values of matrices (b, m, n), by the smaller of their Gram matrices, rounding allowed for."""
    if matrices.shape[1] > matrices.shape[2]:
        matrices = np.swapaxes(matrices, 1, 2)
    gram = matrices @ np.swapaxes(matrices, 1, 2)
    trace = np.trace(gram, axis1=1, axis2=2)
    largest = np.linalg.eigvalsh(gram)[:, -1] + 1e-13 * trace
    return np.asarray(np.sqrt(np.maximum(largest, 0.0)))


def _root(metric: Array) -> Array:
    """Upper triangular R, ndarray (b, n, n), with ``x'Ex <= (1 + 2e-9) |R x|^2``.

    Raises
    ------
    InputError
        If a metric is not positive definite, or too close to singular for its root to be told.
    """
    try:
        lower = np.linalg.cholesky(metric)
    except np.linalg.LinAlgError as failure:
        raise InputError("excess of a tube: the metric is not positive definite; give one that is.") from failure
    inverse = np.linalg.inv(lower)
    left = inverse @ metric @ np.swapaxes(inverse, 1, 2) - np.eye(metric.shape[-1])
    slip = 1e-14 * (np.abs(inverse) @ np.abs(metric) @ np.swapaxes(np.abs(inverse), 1, 2))
    if not np.all(np.linalg.norm(left, axis=(1, 2)) + np.linalg.norm(slip, axis=(1, 2)) < _ROOT_TOLERANCE):
        raise InputError("excess of a tube: the metric is too close to singular; scale the errors or regularise it.")
    return np.asarray(np.swapaxes(lower, 1, 2))


def _box_size(root: Array, half_widths: Array) -> Array:
    """Largest norm of ``root @ d`` over a box (b, n), at a vertex since it is convex: ndarray (b,)."""
    n = half_widths.shape[-1]
    signs = np.array([(1.0, *s) for s in product((1.0, -1.0), repeat=n - 1)])
    images = np.einsum("bij,vj,bj->bvi", root, signs, half_widths)
    return np.asarray(np.linalg.norm(images, axis=-1).max(axis=1))
