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
def _cube(variables: int, count: int) -> tuple[Array, Array]:
    """Points and weights of the product Gauss rule for the uniform distribution of unit covariance in a cube."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    grid = np.stack(np.meshgrid(*[np.sqrt(3.0) * nodes] * variables, indexing="ij"), -1).reshape(-1, variables)
    weight = np.stack(np.meshgrid(*[0.5 * weights] * variables, indexing="ij"), -1).reshape(-1, variables).prod(-1)
    return grid, weight


def moments(covariance: Array, degree: int) -> Array:
    """Second moments of the law's monomials, for errors spread evenly over a parallelepiped of given covariance.

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
    n = covariance.shape[-1]
    points, weights = _cube(n, degree + 1)
    spread = np.linalg.cholesky(
        covariance + 1e-14 * np.trace(covariance, axis1=-2, axis2=-1)[..., None, None] * np.eye(n)
    )
    table = values(points @ np.swapaxes(spread, -1, -2), exponents(n, degree))
    return np.asarray(np.swapaxes(table * weights[:, None], -1, -2) @ table)


def _root(covariance: Array) -> Array:
    n = covariance.shape[-1]
    least = 1e-14 * np.trace(covariance, axis1=-2, axis2=-1)[..., None, None] * np.eye(n)
    return np.linalg.cholesky(covariance + least)


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
