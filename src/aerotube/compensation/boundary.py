r"""Whether the boundary of the initial ellipsoid is enough for the size of a tube.

A function without an interior maximum is largest on the sphere; a size :math:`S(z) = x^{+T} E_1 x^+` has none where
it is subharmonic,

.. math:: \tfrac12\Delta S = \mathrm{tr}(J^T E_1 J) + x^{+T} E_1\,\Delta_z x^+ \ge 0

(J the Jacobian in z), on the whole ball. Checked here for the polynomial through the values of S at the nodes of the
ball: its Laplacian is a polynomial again, bounded from below degree by degree, the constant and the quadratic part
exactly and the others by their norms (see `aerotube.numerics.taylor_model`).
"""

from __future__ import annotations

from functools import lru_cache
from math import factorial

import numpy as np
from numpy.typing import NDArray

from aerotube import sos

Array = NDArray[np.float64]


@lru_cache(maxsize=16)
def nodes(dimension: int, degree: int) -> Array:
    """Points (U, n) of the unit ball at which a polynomial of a degree is known by its values."""
    program = sos.Program()
    program.scalar("rho")
    program.sos("size", sos.Ball(dimension), degree=degree)
    return np.asarray(program.compile().nodes("size"))


@lru_cache(maxsize=16)
def _laplacian(dimension: int, degree: int) -> tuple[Array, NDArray[np.int64]]:
    """From values at the nodes to coefficients of the Laplacian (count, U), and its exponents (count, n)."""
    exponents = sos.Ball(dimension).exponents(degree)
    values = np.prod(nodes(dimension, degree)[:, None, :] ** exponents, axis=2)
    lower = sos.Ball(dimension).exponents(max(degree - 2, 0))
    where = {tuple(row): i for i, row in enumerate(lower.tolist())}
    second = np.zeros((len(lower), len(exponents)))
    for column, row in enumerate(exponents.tolist()):
        for i, power in enumerate(row):
            if power >= 2:
                target = tuple(p - 2 * (j == i) for j, p in enumerate(row))
                second[where[target], column] += power * (power - 1)
    return second @ np.linalg.inv(values), lower


def least_laplacian(values: Array, dimension: int, degree: int) -> Array:
    """Lower bounds of the Laplacian over the unit ball of polynomials known at the nodes.

    Parameters
    ----------
    values : ndarray (..., U)
        At :func:`nodes`.
    dimension, degree : int

    Returns
    -------
    ndarray (...)
        A margin for rounding, a billionth of the largest value, is taken off.
    """
    values = np.asarray(values, dtype=float)
    matrix, exponents = _laplacian(dimension, degree)
    coefficients = values @ matrix.T
    degrees = exponents.sum(axis=1)
    least = coefficients[..., 0] - 1e-9 * np.abs(values).max(axis=-1) * np.abs(matrix).sum(axis=1).max()
    for kind in range(1, int(degrees.max(initial=0)) + 1):
        chosen = np.flatnonzero(degrees == kind)
        if kind == 2:
            form = np.zeros((*values.shape[:-1], dimension, dimension))
            for column in chosen:
                i, j = np.repeat(np.arange(dimension), exponents[column])
                form[..., i, j] += 0.5 * coefficients[..., column]
                form[..., j, i] += 0.5 * coefficients[..., column]
            least = least + np.minimum(np.linalg.eigvalsh(form)[..., 0], 0.0)
        else:
            ways = np.array([factorial(kind) / np.prod([factorial(p) for p in row]) for row in exponents[chosen]])
            least = least - np.sqrt(np.sum(coefficients[..., chosen] ** 2 / ways, axis=-1))
    return np.asarray(least)
