"""Ellipsoids around sums of ellipsoids."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def sum_around(covers: Array) -> Array:
    """Cover of an ellipsoid around the sum of ellipsoids ``{x : x' P^-1 x <= 1}``, some of them flat.

    For positive weights w that add up to one, ``P = sum of P_i / w_i`` holds all sums of their points (Cauchy and
    Schwarz on the support functions); the weights are those that are best where the sum itself is taken for the unit
    of length (A. B. Kurzhanski, I. Valyi, "Ellipsoidal Calculus for Estimation and Control", 1997).

    Parameters
    ----------
    covers : ndarray (k, ..., n, n)
        P of each; their sum is positive definite.

    Returns
    -------
    ndarray (..., n, n)
    """
    covers = np.asarray(covers, dtype=float)
    unit = np.linalg.inv(covers.sum(axis=0))
    weights = np.sqrt(np.maximum(np.einsum("...ij,k...ji->k...", unit, covers), 0.0))
    weights = np.maximum(weights / weights.sum(axis=0), 1e-9)
    weights /= weights.sum(axis=0)
    total = np.sum(covers / weights[..., None, None], axis=0)
    return np.asarray(0.5 * (total + np.swapaxes(total, -1, -2)))
