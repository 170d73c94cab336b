"""Monomials of a law: their values, their means under noise, and how they change with the coordinates."""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


@lru_cache(maxsize=32)
def exponents(variables: int, degree: int) -> IntArray:
    """Exponents (M, variables) of the monomials of degree 1 to `degree`: by degree, the linear ones in order."""
    rows = [
        np.bincount(combination, minlength=variables)
        for d in range(1, degree + 1)
        for combination in itertools.combinations_with_replacement(range(variables), d)
    ]
    out = np.array(rows, dtype=np.int64).reshape(-1, variables)
    out.flags.writeable = False
    return out


def values(points: Array, powers: IntArray) -> Array:
    """Values (..., M) of monomials, exponents (M, n), at points (..., n)."""
    out = np.ones((*points.shape[:-1], len(powers)))
    for i in np.flatnonzero(powers.any(0)):
        at = points[..., i]
        power = np.ones_like(at)
        for k in range(1, int(powers[:, i].max()) + 1):
            power = power * at
            which = powers[:, i] == k
            out[..., which] *= power[..., None]
    return out


@lru_cache(maxsize=32)
def _second_derivatives(variables: int, degree: int) -> Array:
    """Half the second derivatives of the law's monomials, in monomials of degree 0 on: (n, n, M, 1 + M)."""
    powers = exponents(variables, degree)
    place = {tuple(row): 1 + index for index, row in enumerate(powers.tolist())} | {(0,) * variables: 0}
    out = np.zeros((variables, variables, len(powers), 1 + len(powers)))
    for row, power in enumerate(powers):
        for i, j in itertools.product(range(variables), repeat=2):
            left, factor = power.copy(), 0.5
            for k in (i, j):
                factor *= left[k]
                left[k] -= 1
            if factor:
                out[i, j, row, place[tuple(left)]] += factor
    return out


def under_noise(points: Array, noise: Array, degree: int) -> Array:
    """Means over v of the law's monomials of ``y + v``, for v symmetric about zero.

    Exact up to degree 3, where only the second moments of v enter.

    Parameters
    ----------
    points : ndarray (..., U, n)
        y.
    noise : ndarray (..., n, n)
        Covariance of v.
    degree : int
        At most 3.

    Returns
    -------
    ndarray (..., U, M)
    """
    n = points.shape[-1]
    plain = values(points, exponents(n, degree))
    if degree == 1 or not np.any(noise):
        return plain
    change = np.einsum("...ij,ijmp->...pm", noise, _second_derivatives(n, degree))
    return plain + np.concatenate([np.ones_like(plain[..., :1]), plain], -1) @ change


@lru_cache(maxsize=8)
def _normal(variables: int, degree: int) -> tuple[Array, Array]:
    """Points and weights of a rule for the standard normal distribution.

    Exact to degree ``2 degree + 1``: a product of Gauss rules; in more than four variables and for degree two a rule of
    degree five with the centre, points on the axes, and points on the diagonals, which has few points for the price of
    a negative weight.
    """
    if variables <= 4 or degree > 2:
        nodes, weights = np.polynomial.hermite_e.hermegauss(degree + 1)
        weights = weights / weights.sum()
        grid = np.stack(np.meshgrid(*[nodes] * variables, indexing="ij"), -1).reshape(-1, variables)
        weight = np.stack(np.meshgrid(*[weights] * variables, indexing="ij"), -1).reshape(-1, variables).prod(-1)
        return grid, weight
    # a point's squared coordinates are 2 on the diagonals, whose weights sum to 1/4 so that E x^2 y^2 = 4/4;
    # the axes' points at r, of weight w, then have 2 w r^2 = E x^2 - 2/4 and 2 w r^4 = E x^4 - 4/4 = 2
    diagonals = np.sqrt(2.0) * np.array(list(itertools.product((-1.0, 1.0), repeat=variables)))
    axes = 2.0 * np.concatenate([np.eye(variables), -np.eye(variables)])
    weight = np.concatenate([np.full(len(diagonals), 0.25 / len(diagonals)), np.full(len(axes), 1.0 / 16.0)])
    points = np.concatenate([diagonals, axes, np.zeros((1, variables))])
    return points, np.append(weight, 1.0 - weight.sum())


def cubature(covariance: Array, degree: int) -> tuple[Array, Array]:
    """Points and weights of means over normal errors of given covariance.

    Exact for polynomials to degree ``2 degree + 1``.

    Parameters
    ----------
    covariance : ndarray (..., n, n)
    degree : int

    Returns
    -------
    points : ndarray (..., U, n)
    weights : ndarray (U,)
    """
    points, weights = _normal(covariance.shape[-1], degree)
    scale = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    scale = np.maximum(scale, np.finfo(float).tiny)
    relative = covariance / scale[..., :, None] / scale[..., None, :]
    spread = np.linalg.cholesky(relative + 1e-14 * np.eye(covariance.shape[-1])) * scale[..., :, None]
    return np.asarray(points @ np.swapaxes(spread, -1, -2)), weights


def moments(covariance: Array, degree: int) -> Array:
    """Second moments of the law's monomials, for normal errors of given covariance.

    For degree 1 they are the covariance itself, whatever the distribution.

    Parameters
    ----------
    covariance : ndarray (..., n, n)
    degree : int

    Returns
    -------
    ndarray (..., M, M)
    """
    if degree == 1:
        return covariance
    points, weights = cubature(covariance, degree)
    table = values(points, exponents(covariance.shape[-1], degree))
    return np.asarray(np.swapaxes(table * weights[:, None], -1, -2) @ table)


@lru_cache(maxsize=32)
def _places(variables: int, degree: int) -> list[tuple[slice, IntArray, IntArray]]:
    """For each degree: its rows, the sorted multi-index of each row, and the row of each multi-index."""
    powers = exponents(variables, degree)
    out = []
    for d in range(1, degree + 1):
        own = np.flatnonzero(powers.sum(1) == d)
        place = {tuple(powers[row]): index for index, row in enumerate(own)}
        first = np.array([np.repeat(np.arange(variables), powers[row]) for row in own])
        every = [tuple(np.bincount(i, minlength=variables)) for i in itertools.product(range(variables), repeat=d)]
        out.append((slice(int(own[0]), int(own[-1]) + 1), first, np.array([place[power] for power in every])))
    return out


def substituted(coefficients: Array, transform: Array, degree: int) -> Array:
    """Coefficients in x of polynomials given in ``y = A x``.

    Parameters
    ----------
    coefficients : ndarray (..., m, M)
    transform : ndarray (..., n, n)
        A.
    degree : int

    Returns
    -------
    ndarray (..., m, M)
    """
    n = transform.shape[-1]
    out = np.empty_like(coefficients)
    for d, (rows, first, place) in enumerate(_places(n, degree), start=1):
        lead = coefficients.shape[:-1]
        tensor = np.zeros((*lead, *(n,) * d))
        tensor[(..., *first.T)] = coefficients[..., rows]
        for _ in range(d):  # each turn contracts the first index and puts the new one last
            tensor = np.moveaxis(tensor, len(lead), -1)
            flat = tensor.reshape(*lead, -1, n) @ transform[..., None, :, :]
            tensor = flat.reshape(tensor.shape)
        gathered = np.zeros((*lead, len(first)))
        flat = tensor.reshape(*lead, -1)
        np.add.at(np.moveaxis(gathered, -1, 0), place, np.moveaxis(flat, -1, 0))
        out[..., rows] = gathered
    return out
