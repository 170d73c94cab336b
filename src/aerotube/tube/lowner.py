"""The ellipsoid of least volume around points, centred on the origin (Loewner's)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.errors import ComputationError, InputError

Array = NDArray[np.float64]


@lru_cache(maxsize=32)
def _structure(dimension: int, points: int) -> sos.Structure:
    program = sos.Program()
    program.symmetric("E", dimension)
    program.linear("inside", rows=points)
    program.logdet("volume", size=dimension)
    return program.compile()


def least_volume_around_points(points: Array) -> tuple[Array, float]:
    """Ellipsoid of least volume, centred on the origin, that holds points and so their convex hull.

    Parameters
    ----------
    points : ndarray (k, n)

    Returns
    -------
    shape : ndarray (n, n)
    rho : float
        The largest ``x' shape x`` over the points: whatever the solver said, they are inside.

    Raises
    ------
    InputError
        If the points and their opposites do not span the space.
    ComputationError
        If the program is not solved.
    """
    points = np.asarray(points, dtype=float)
    n = points.shape[1]
    unit = np.abs(points).max(axis=0)
    if not np.isfinite(points).all() or not (unit > 0).all() or np.linalg.matrix_rank(points / unit) < n:
        raise InputError(
            f"ellipsoid around points: the {len(points)} points are not finite or lie in a plane through the origin; "
            f"give points that span all {n} dimensions."
        )
    spread = np.linalg.cholesky((points / unit).T @ (points / unit))
    white = np.linalg.solve(spread, (points / unit).T).T
    # opposite points ask for the same
    leading = np.sign(white[np.arange(len(white)), np.abs(white).argmax(axis=1)])
    white = np.unique(np.round(white * leading[:, None], 12), axis=0)
    structure = _structure(n, len(white))
    E = structure.variable("E")
    rows, columns = np.tril_indices(n)
    forms = np.zeros((structure.size, n, n))
    grid = np.indices((n, n))
    forms[E.index, grid[0], grid[1]] = 1.0
    problem = structure.data(
        objective=np.zeros(structure.size),
        constraints={
            "inside": (white[:, rows] * white[:, columns] * np.where(rows == columns, 1.0, 2.0), np.ones(len(white))),
            "volume": (np.zeros((n, n)), forms),
        },
    )
    solution = sos.solve(structure, problem)
    form = np.asarray(solution["E"])
    if not np.isfinite(form).all() or np.linalg.eigvalsh(form)[0] <= 0:
        raise ComputationError(
            f"ellipsoid around points: no ellipsoid around {len(points)} points was found ({solution.describe()})"
        )
    inverse = np.linalg.inv(spread) / unit
    shape = inverse.T @ form @ inverse
    shape = 0.5 * (shape + shape.T)
    return shape, float(np.einsum("vi,ij,vj->v", points, shape, points).max())
