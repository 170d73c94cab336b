"""Ellipsoids ``{x : x' E x <= rho}``."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def least_volume_around_box(half_widths: Array) -> tuple[Array, Array]:
    """Ellipsoid of least volume that holds a box centred on the origin.

    Parameters
    ----------
    half_widths : ndarray (..., n)
        All positive.

    Returns
    -------
    shape : ndarray (..., n, n)
        ``diag(1 / w^2)``.
    rho : ndarray (...)
        ``n``.
    """
    widths = np.asarray(half_widths, dtype=float)
    n = widths.shape[-1]
    shape = np.zeros((*widths.shape, n))
    shape[..., np.arange(n), np.arange(n)] = widths**-2
    return shape, np.full(widths.shape[:-1], float(n))


def least_size_around_box(shape: Array, half_widths: Array) -> Array:
    """Least ``rho`` for which an ellipsoid of given shape holds a box (Eq. 9 with the shape held).

    A convex function is largest at a vertex, and opposite vertices agree, so half of them are looked at.

    Parameters
    ----------
    shape : ndarray (..., n, n)
        Positive definite.
    half_widths : ndarray (..., n)

    Returns
    -------
    ndarray (...)
    """
    widths = np.asarray(half_widths, dtype=float)
    signs = np.array([(1.0, *s) for s in itertools.product((1.0, -1.0), repeat=widths.shape[-1] - 1)])
    vertices = signs * widths[..., None, :]
    return np.einsum("...vi,...ij,...vj->...v", vertices, shape, vertices).max(-1)


def whitening(shape: Array, rho: Array) -> Array:
    """Map of the unit ball onto an ellipsoid: ``x = T z`` with ``|z| <= 1``.

    Parameters
    ----------
    shape : ndarray (..., n, n)
        Positive definite.
    rho : ndarray (...)

    Returns
    -------
    ndarray (..., n, n)
        Symmetric ``T = sqrt(rho) E^(-1/2)``.
    """
    values, vectors = np.linalg.eigh(shape)
    scale = np.sqrt(np.asarray(rho)[..., None] / values)
    return (vectors * scale[..., None, :]) @ np.swapaxes(vectors, -1, -2)


def root(shape: Array) -> Array:
    """Symmetric square root of a positive semidefinite matrix: ndarray (..., n, n)."""
    values, vectors = np.linalg.eigh(shape)
    return (vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]) @ np.swapaxes(vectors, -1, -2)


def half_widths(shape: Array, rho: Array) -> Array:
    """Half-widths of the smallest box around an ellipsoid: ``sqrt(rho (E^-1)_ii)``.

    Parameters
    ----------
    shape : ndarray (..., n, n)
    rho : ndarray (...)

    Returns
    -------
    ndarray (..., n)
    """
    inverse = np.linalg.inv(shape)
    return np.sqrt(np.asarray(rho)[..., None] * np.diagonal(inverse, axis1=-2, axis2=-1))


def projection(shape: Array, indices: tuple[int, ...]) -> Array:
    """Shape of the projection of an ellipsoid onto some of its axes; ``rho`` stays.

    Parameters
    ----------
    shape : ndarray (..., n, n)
    indices : tuple of int
        The axes kept, k of them.

    Returns
    -------
    ndarray (..., k, k)
    """
    inverse = np.linalg.inv(shape)
    return np.linalg.inv(inverse[..., np.ix_(indices, indices)[0], np.ix_(indices, indices)[1]])


def boundary(shape: Array, rho: Array, points: int = 64) -> Array:
    """Points around the edge of a plane ellipse.

    Parameters
    ----------
    shape : ndarray (..., 2, 2)
    rho : ndarray (...)
    points : int

    Returns
    -------
    ndarray (..., points, 2)
    """
    angle = np.linspace(0.0, 2.0 * np.pi, points)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return circle @ np.swapaxes(whitening(shape, rho), -1, -2)


def section(shape: Array, rho: Array, indices: tuple[int, ...], values: Array) -> tuple[Array, Array, Array]:
    """Cut of an ellipsoid by a plane on which some of its axes are held.

    Parameters
    ----------
    shape : ndarray (..., n, n)
        Positive definite.
    rho : ndarray (...)
    indices : tuple of int
        The axes held, n - k of them.
    values : ndarray (..., n - k)
        What they are held at.

    Returns
    -------
    shape : ndarray (..., k, k)
        Of the ellipsoid ``(x - centre)' shape (x - centre) <= rho`` in the other axes, in their order.
    rho : ndarray (...)
        Negative where the plane misses the ellipsoid.
    centre : ndarray (..., k)
    """
    shape, values = np.asarray(shape, dtype=float), np.asarray(values, dtype=float)
    held = list(indices)
    free = [i for i in range(shape.shape[-1]) if i not in held]
    own, cross = shape[..., free, :][..., free], shape[..., free, :][..., held]
    fixed = shape[..., held, :][..., held]
    centre = -np.linalg.solve(own, cross @ values[..., None])[..., 0]
    left = np.einsum("...i,...ij,...j->...", values, fixed, values) + np.einsum(
        "...i,...ij,...j->...", centre, cross, values
    )
    return own, np.asarray(rho - left), np.asarray(centre)


def support(shape: Array, rho: Array, directions: Array) -> Array:
    """How far an ellipsoid reaches along directions: the largest ``d' x``, which is ``sqrt(rho d' E^-1 d)``.

    Parameters
    ----------
    shape : ndarray (..., n, n)
        Positive definite.
    rho : ndarray (...)
    directions : ndarray (..., n)
        Batch axes of all arguments broadcast.

    Returns
    -------
    ndarray (...)
    """
    directions = np.asarray(directions, dtype=float)
    turned = np.linalg.solve(shape, directions[..., None])[..., 0]
    return np.asarray(np.sqrt(np.asarray(rho) * np.einsum("...i,...i->...", directions, turned)))


def contains(shape: Array, rho: Array, points: Array, tolerance: float = 1e-9) -> NDArray[np.bool_]:
    """Whether points lie in an ellipsoid, up to a share `tolerance` of ``rho``: ndarray (...) of bool.

    Parameters
    ----------
    shape : ndarray (..., n, n)
    rho : ndarray (...)
    points : ndarray (..., n)
        Batch axes of all arguments broadcast.
    tolerance : float
    """
    size = np.einsum("...i,...ij,...j->...", points, shape, points)
    return np.asarray(size <= np.asarray(rho) * (1.0 + tolerance))


def least_size_around_ellipsoid(shape: Array, inner: Array, inner_rho: Array, centre: Array | None = None) -> Array:
    r"""Least ``rho`` for which an ellipsoid of given shape holds another one.

    Parameters
    ----------
    shape : ndarray (..., n, n)
        Positive semidefinite.
    inner : ndarray (..., n, n)
        Shape of the other, positive definite.
    inner_rho : ndarray (...)
    centre : ndarray (..., n), optional
        Of the other; the origin by default.

    Returns
    -------
    ndarray (...)

    Notes
    -----
    By the S-lemma the largest :math:`x'Ex` over the other ellipsoid is, with :math:`x = c + Tz`, :math:`M = T'ET`
    and :math:`g = T'Ec`,

    .. math:: \min_{\lambda \ge \lambda_{\max}(M)} \; \lambda + c'Ec + g'(\lambda I - M)^{-1} g ,

    convex in one variable, found by bisection of its derivative (S. Boyd and L. Vandenberghe, *Convex Optimization*,
    2004, appendix B). What is returned is the value at a feasible lambda: never too small, but for rounding.
    """
    T = whitening(inner, inner_rho)
    values, vectors = np.linalg.eigh(np.swapaxes(T, -1, -2) @ shape @ T)
    top = values[..., -1]
    if centre is None:
        return np.asarray(top)
    along = np.einsum("...ij,...j->...i", shape, centre)
    g2 = np.einsum("...ji,...kj,...k->...i", vectors, T, along) ** 2
    low, high = top, top + np.sqrt(g2.sum(-1))
    for _ in range(60):
        middle = 0.5 * (low + high)
        gap = np.maximum(middle[..., None] - values, np.finfo(float).tiny)
        steep = (g2 / gap**2).sum(-1) > 1.0
        low, high = np.where(steep, middle, low), np.where(steep, high, middle)
    gap = high[..., None] - values
    share = np.divide(g2, gap, out=np.zeros_like(gap), where=gap > 0)
    return np.asarray(high + np.einsum("...i,...i->...", along, centre) + share.sum(-1))


def contains_ellipsoid(
    shape: Array, rho: Array, inner: Array, inner_rho: Array, centre: Array | None = None, tolerance: float = 1e-9
) -> NDArray[np.bool_]:
    """Whether an ellipsoid holds another one, of any centre, by the S-lemma: ndarray (...) of bool.

    See :func:`least_size_around_ellipsoid`; `tolerance` is a share of ``rho``.
    """
    return np.asarray(
        least_size_around_ellipsoid(shape, inner, inner_rho, centre) <= np.asarray(rho) * (1.0 + tolerance)
    )


def sample(shape: Array, rho: Array, count: int, generator: np.random.Generator, on_boundary: bool = False) -> Array:
    """Random points of an ellipsoid.

    Parameters
    ----------
    shape : ndarray (..., n, n)
    rho : ndarray (...)
    count : int
    generator : numpy.random.Generator
    on_boundary : bool
        Points of the boundary: the image of uniform points of the sphere. Uniform inside otherwise.

    Returns
    -------
    ndarray (..., count, n)
    """
    T = whitening(np.asarray(shape, dtype=float), rho)
    z = generator.standard_normal((*T.shape[:-2], count, T.shape[-1]))
    z /= np.linalg.norm(z, axis=-1, keepdims=True)
    if not on_boundary:
        z *= generator.random((*z.shape[:-1], 1)) ** (1.0 / T.shape[-1])
    return np.asarray(z @ np.swapaxes(T, -1, -2))


def log_volume(shape: Array, rho: Array) -> Array:
    """Logarithm of the volume of an ellipsoid: ndarray (...); infinite for one that is flat or unbounded."""
    n = np.asarray(shape).shape[-1]
    ball = 0.5 * n * np.log(np.pi) - math.lgamma(0.5 * n + 1.0)
    return np.asarray(ball + 0.5 * (n * np.log(rho) - np.linalg.slogdet(shape)[1]))


def image(shape: Array, matrix: Array) -> Array:
    """Shape of the image of an ellipsoid under an invertible matrix (..., n, n); ``rho`` stays."""
    inverse = np.linalg.inv(matrix)
    return np.asarray(np.swapaxes(inverse, -1, -2) @ shape @ inverse)


def minkowski_sum(shape: Array, rho: Array, other: Array, other_rho: Array) -> Array:
    r"""Shape, for ``rho`` of one, of an ellipsoid around all sums of a point of one ellipsoid and a point of another.

    Of the family :math:`(1 + 1/\beta) Q_1 + (1 + \beta) Q_2`, with :math:`Q = \rho E^{-1}`, the one of least trace
    (A. B. Kurzhanski and I. Valyi, *Ellipsoidal Calculus for Estimation and Control*, 1997): a choice that depends on
    the units of the axes, so scale them first.

    Parameters
    ----------
    shape, other : ndarray (..., n, n)
    rho, other_rho : ndarray (...)

    Returns
    -------
    ndarray (..., n, n)
    """
    first = np.asarray(rho)[..., None, None] * np.linalg.inv(shape)
    second = np.asarray(other_rho)[..., None, None] * np.linalg.inv(other)
    beta = np.sqrt(np.trace(first, axis1=-2, axis2=-1) / np.trace(second, axis1=-2, axis2=-1))[..., None, None]
    return np.asarray(np.linalg.inv((1.0 + 1.0 / beta) * first + (1.0 + beta) * second))
