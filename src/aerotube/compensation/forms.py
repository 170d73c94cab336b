"""Quadratic forms as a program's data: in packed symmetric variables, and of laws."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aerotube import sos

Array = NDArray[np.float64]


def quadratic_forms(points: Array) -> Array:
    """Values of ``z' X z`` at points (..., n), by the packed lower triangle of X: ndarray (..., n (n + 1) / 2)."""
    rows, columns = np.tril_indices(points.shape[-1])
    return np.asarray(points[..., rows] * points[..., columns] * np.where(rows == columns, 1.0, 2.0))


def inner_product(matrix: Array) -> Array:
    """Coefficients of ``tr(X matrix)`` in the packed lower triangle of X: ndarray (b, n (n + 1) / 2)."""
    rows, columns = np.tril_indices(matrix.shape[-1])
    return np.asarray(matrix[..., rows, columns] * np.where(rows == columns, 1.0, 2.0))


def law_square(compiled: sos.Structure, t: sos.Variable, root: Array, moments: Array) -> tuple[Array, ...]:
    """Data of the norm constraint ``t >= sum over the beats of tr(L K~ M K~' L')``.

    Parameters
    ----------
    compiled : sos.Structure
    t : sos.Variable
        A scalar.
    root : ndarray (b, g, m, m)
        L.
    moments : ndarray (b, g, M, M)
        M, positive semidefinite.

    Returns
    -------
    tuple of ndarray
    """
    # t >= |y|^2 is |(2 y, t - 1)| <= t + 1, with y the entries of L K~ C in every beat, C C' = M
    K = compiled.variable("K")
    batch, steps = root.shape[:2]
    rows = np.zeros((batch, steps * K.size + 1, compiled.size))
    own = 2.0 * np.einsum("bgai,bgjc->bgacij", root, _cholesky(moments))
    rows[:, :-1, K.slice] = own.reshape(batch, -1, K.size)
    rows[:, -1, t.index] = 1.0
    shift, bound = np.zeros(rows.shape[1]), np.zeros(compiled.size)
    shift[-1], bound[t.index] = -1.0, 1.0
    return rows, shift, bound, np.ones(())


def _cholesky(matrix: Array) -> Array:
    """Cholesky factors of positive semidefinite matrices (..., n, n), a rounding error of their size added."""
    size = np.trace(matrix, axis1=-2, axis2=-1)[..., None, None] * np.finfo(float).eps
    return np.linalg.cholesky(matrix + size * np.eye(matrix.shape[-1]))
