"""Ellipsoids ``{x : x' E x <= rho}``."""

from __future__ import annotations

import itertools

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
