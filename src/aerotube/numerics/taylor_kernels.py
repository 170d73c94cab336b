"""Compiled products, quotients and compositions of truncated multivariate polynomials, row by row of a batch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Layout(NamedTuple):
    """Where the product of two monomials in graded order lands.

    Monomial ``i`` times monomial ``j`` is monomial ``targets[starts[i] + j]``, for all ``j`` that keep the product
    within the order. These are the first ``up_to[order - degrees[i]]``: in graded order the low degrees come first.
    """

    degrees: NDArray[np.int64]  # (size,)
    up_to: NDArray[np.int64]  # (order + 1,): number of monomials of at most that degree
    starts: NDArray[np.int64]  # (size,)
    targets: NDArray[np.uint32]  # unsigned, so that compiled code need not look for negative indices


@njit(cache=True, nogil=True)
def multiply(left: Array, right: Array, layout: Layout, product: Array) -> None:
    """Add the truncated product of each row (batch, size) to `product`."""
    degrees, up_to, starts, targets = layout
    order = up_to.size - 1
    for row in range(left.shape[0]):
        for i in range(left.shape[1]):
            factor = left[row, i]
            if factor != 0.0:
                start = starts[i]
                for j in range(up_to[order - degrees[i]]):
                    product[row, targets[start + j]] += factor * right[row, j]


@njit(cache=True, nogil=True)
def divide(left: Array, right: Array, layout: Layout, quotient: Array) -> None:
    """Write the truncated quotient of each row (batch, size); constant terms of `right` must not be zero.

    Coefficients are found by rising degree: once one is known, its products with `right` are taken off the
    dividend of those above.
    """
    degrees, up_to, starts, targets = layout
    order = up_to.size - 1
    for row in range(left.shape[0]):
        scale = 1.0 / right[row, 0]
        for i in range(left.shape[1]):
            quotient[row, i] = left[row, i]
        for i in range(left.shape[1]):
            factor = quotient[row, i] * scale
            quotient[row, i] = factor
            if factor != 0.0:
                start = starts[i]
                for j in range(1, up_to[order - degrees[i]]):
                    quotient[row, targets[start + j]] -= factor * right[row, j]


@njit(cache=True, nogil=True)
def compose(inner: Array, series: Array, layout: Layout, result: Array) -> None:
    """Write the sum of ``series[:, k] * (inner - inner's constant term)**k`` of each row (batch, size).

    By Horner's rule. Since the inner part has no constant term, what is still to be multiplied by it k times is
    needed only up to degree ``order - k``.
    """
    degrees, up_to, starts, targets = layout
    order = up_to.size - 1
    partial = np.empty(inner.shape[1])
    for row in range(inner.shape[0]):
        result[row, 0] = series[row, order]
        for step in range(1, order + 1):
            known, needed = up_to[step - 1], up_to[step]
            for i in range(known):
                partial[i] = result[row, i]
            result[row, 0] = series[row, order - step]
            for i in range(1, needed):
                result[row, i] = 0.0
            for i in range(known):
                factor = partial[i]
                if factor != 0.0:
                    start = starts[i]
                    for j in range(1, up_to[step - degrees[i]]):
                        result[row, targets[start + j]] += factor * inner[row, j]
