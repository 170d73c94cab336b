"""Compiled arithmetic of Taylor models, row by row of a batch.

A row holds the coefficients of a polynomial, then a bound of the absolute value of its part of each degree over the
domain (its norms), then the remainder. Every operation adds to the remainder what it leaves out of the polynomial and
a bound of its own rounding: a coefficient summed from k products errs by at most ``(k + 1) 2**-53`` times the sum of
their absolute values (N. J. Higham, *Accuracy and Stability of Numerical Algorithms*, 2nd ed., chapter 3), and the
norms of polynomials with those coefficients are at most products of the factors' norms. Sums of what is not negative
are enlarged by `SLACK`, far more than their few hundred roundings amount to.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

SLACK = 1.0 + 2.0**-40
_UNIT = 2.0**-53
_LEAST = 1e-150  # above all that underflow can lose, in squares too


class ModelLayout(NamedTuple):
    """The product's index tables, see `aerotube.numerics.taylor_kernels.Layout`, and the weights of the norms."""

    up_to: NDArray[np.int64]  # (order + 1,)
    lengths: NDArray[np.int64]  # (size,): with how many monomials a monomial's product is kept
    starts: NDArray[np.int64]  # (size,)
    targets: NDArray[np.uint32]
    weights: Array  # (size,): of the squared coefficients in a norm
    classes: NDArray[np.int64]  # (size,): monomials of one class have the same degree in every ball of the domain
    degrees: NDArray[np.int64]  # (classes,)


@njit(cache=True, nogil=True)
def set_norms(row: Array, layout: ModelLayout) -> float:
    """Write the norms of the row's coefficients and return their sum."""
    size, order = layout.weights.size, layout.up_to.size - 1
    squares = np.zeros(layout.degrees.size)
    used = np.zeros(layout.degrees.size, dtype=np.bool_)
    for i in range(size):
        value = row[i]
        if value != 0.0:
            squares[layout.classes[i]] += layout.weights[i] * value * value
            used[layout.classes[i]] = True
    for degree in range(order + 1):
        row[size + degree] = 0.0
    for k in range(squares.size):
        if used[k]:
            row[size + layout.degrees[k]] += np.sqrt(squares[k]) * SLACK + _LEAST
    total = 0.0
    for degree in range(order + 1):
        row[size + degree] *= SLACK
        total += row[size + degree]
    return total * SLACK


@njit(cache=True, nogil=True)
def product_row(left: Array, right: Array, layout: ModelLayout, out: Array) -> None:
    """Write the product of two rows."""
    size, order = layout.weights.size, layout.up_to.size - 1
    for i in range(size):
        out[i] = 0.0
    for i in range(size):
        factor = left[i]
        if factor != 0.0:
            start = layout.starts[i]
            for j in range(layout.lengths[i]):
                out[layout.targets[start + j]] += factor * right[j]
    kept, dropped, total_left, total_right = 0.0, 0.0, 0.0, 0.0
    for i in range(order + 1):
        total_left += left[size + i]
        total_right += right[size + i]
        for j in range(order + 1):
            if i + j <= order:
                kept += left[size + i] * right[size + j]
            else:
                dropped += left[size + i] * right[size + j]
    rest_left, rest_right = left[size + order + 1], right[size + order + 1]
    remainder = rest_left * (total_right + rest_right) + rest_right * total_left + dropped
    remainder += (2.0**order + 1.0) * _UNIT * kept + _LEAST
    set_norms(out, layout)
    out[size + order + 1] = remainder * SLACK


@njit(cache=True, nogil=True)
def multiply_rows(left: Array, right: Array, layout: ModelLayout, out: Array) -> None:
    """Write the product of each row (batch, length)."""
    for row in range(left.shape[0]):
        product_row(left[row], right[row], layout, out[row])


@njit(cache=True, nogil=True)
def add_rows(left: Array, right: Array, sign: float, layout: ModelLayout, out: Array) -> None:
    """Write ``left + sign * right``, the sign 1 or -1, of each row (batch, length)."""
    size, last = layout.weights.size, left.shape[1] - 1
    for row in range(left.shape[0]):
        for i in range(size):
            out[row, i] = left[row, i] + sign * right[row, i]
        total = set_norms(out[row], layout)
        out[row, last] = (left[row, last] + right[row, last] + 2.0 * _UNIT * total + _LEAST) * SLACK


@njit(cache=True, nogil=True)
def scale_rows(rows: Array, factors: Array, layout: ModelLayout, out: Array) -> None:
    """Write each row (batch, length) times a number (batch,)."""
    size, order = layout.weights.size, layout.up_to.size - 1
    for row in range(rows.shape[0]):
        factor = factors[row]
        for i in range(size):
            out[row, i] = rows[row, i] * factor
        total = set_norms(out[row], layout)
        rest = rows[row, size + order + 1] * abs(factor)
        out[row, size + order + 1] = (rest + 2.0 * _UNIT * total + _LEAST) * SLACK


@njit(cache=True, nogil=True)
def shift_rows(rows: Array, numbers: Array, extra: Array, size: int, out: Array) -> None:
    """Write each row (batch, length) plus a number (batch,) known up to `extra` (batch,)."""
    last = rows.shape[1] - 1
    for row in range(rows.shape[0]):
        for i in range(rows.shape[1]):
            out[row, i] = rows[row, i]
        constant = rows[row, 0] + numbers[row]
        out[row, 0] = constant
        out[row, size] = abs(constant)
        out[row, last] = (rows[row, last] + extra[row] + 2.0 * _UNIT * abs(constant) + _LEAST) * SLACK


@njit(cache=True, nogil=True)
def compose_rows(inner: Array, series: Array, extra: Array, layout: ModelLayout, out: Array) -> None:
    """Write the sum of ``series[:, k] * (inner - inner's constant term)**k``, plus `extra`, of each row.

    By Horner's rule; series (batch, order + 1), extra (batch,).
    """
    size, order = layout.weights.size, layout.up_to.size - 1
    last = size + order + 1
    step, partial = np.empty(inner.shape[1]), np.empty(inner.shape[1])
    for row in range(inner.shape[0]):
        for i in range(last + 1):
            step[i] = inner[row, i]
        step[0] = 0.0
        step[size] = 0.0
        for i in range(last + 1):
            out[row, i] = step[i] * series[row, order]
        total = set_norms(out[row], layout)
        out[row, last] = (step[last] * abs(series[row, order]) + 2.0 * _UNIT * total + _LEAST) * SLACK
        for k in range(order - 1, -1, -1):
            if k < order - 1:
                for i in range(last + 1):
                    partial[i] = out[row, i]
                product_row(partial, step, layout, out[row])
            constant = out[row, 0] + series[row, k]
            out[row, 0] = constant
            out[row, size] = abs(constant)
            out[row, last] = (out[row, last] + 2.0 * _UNIT * abs(constant) + _LEAST) * SLACK
        out[row, last] = (out[row, last] + extra[row]) * SLACK


@njit(cache=True, nogil=True)
def combine_rows(terms: Array, series: Array, extra: Array, layout: ModelLayout, out: Array) -> None:
    """Write the combinations of rows, ``sum over t of series[b, o, t] * terms[t, b]``, plus `extra` (batch, outputs).

    terms (terms, batch, length), series (batch, outputs, terms), out (outputs, batch, length).
    """
    size, order = layout.weights.size, layout.up_to.size - 1
    last, count = size + order + 1, terms.shape[0]
    totals = np.zeros(count)
    for row in range(terms.shape[1]):
        for t in range(count):
            totals[t] = 0.0
            for i in range(size, last):
                totals[t] += terms[t, row, i]
        for output in range(series.shape[1]):
            target = out[output, row]
            for i in range(size):
                target[i] = 0.0
            remainder, absolute = extra[row, output], 0.0
            for t in range(count):
                factor = series[row, output, t]
                if factor != 0.0:
                    for i in range(size):
                        target[i] += factor * terms[t, row, i]
                    remainder += abs(factor) * terms[t, row, last]
                    absolute += abs(factor) * totals[t]
            set_norms(target, layout)
            target[last] = (remainder + (count + 2.0) * _UNIT * absolute + _LEAST) * SLACK
