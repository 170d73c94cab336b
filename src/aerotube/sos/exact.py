"""Polynomials and matrices in exact rational arithmetic, for the check of certificates.

Polynomials are reduced on the spheres by x_n^2 = 1 - x_1^2 - ..., so that equal functions there have equal
coefficients; matrices are shown to be positive definite by fraction-free elimination of whole numbers.
"""

from __future__ import annotations

from fractions import Fraction
from math import isqrt
from operator import mul

Terms = dict[tuple[int, ...], Fraction]
Factors = list[tuple[str, int]]
Matrix = list[list[Fraction]]


def monomials_on(domain: Factors, degree: int) -> list[tuple[int, ...]]:
    """Exponents of the monomials of degree <= `degree`, the last coordinate of every sphere at most once."""
    rows: list[tuple[int, ...]] = [()]
    for kind, dimension in domain:
        for k in range(dimension):
            cap = min(1, degree) if kind == "sphere" and k == dimension - 1 else degree
            rows = [(*row, p) for row in rows for p in range(min(cap, degree - sum(row)) + 1)]
    return rows


def add(terms: Terms, key: tuple[int, ...], value: Fraction) -> None:
    """Add a term in place."""
    terms[key] = terms.get(key, Fraction(0)) + value


def times(a: Terms, b: Terms) -> Terms:
    """Product of two polynomials."""
    if len(b) == 1 and all(k == 0 for k in next(iter(b))):
        factor = next(iter(b.values()))
        return {key: value * factor for key, value in a.items()}
    result: Terms = {}
    for first, x in a.items():
        for second, y in b.items():
            add(result, tuple(i + j for i, j in zip(first, second, strict=True)), x * y)
    return result


def size(terms: Terms) -> Fraction:
    """Sum of the coefficients' magnitudes: a bound on the domain, where no monomial exceeds one."""
    return sum((abs(x) for x in terms.values()), Fraction(0))


def reduced(terms: Terms, domain: Factors) -> Terms:
    """Rewrite with the last coordinate of every sphere at most to the first power."""
    spheres, at = [], 0
    for kind, dimension in domain:
        if kind == "sphere":
            spheres.append((at, at + dimension - 1))
        at += dimension
    pending = dict(terms)
    result: Terms = {}
    while pending:
        key, value = pending.popitem()
        for start, last in spheres:
            if key[last] >= 2:
                lower = tuple(k - 2 if i == last else k for i, k in enumerate(key))
                add(pending, lower, value)
                for j in range(start, last):
                    add(pending, tuple(k + 2 if i == j else k for i, k in enumerate(lower)), -value)
                break
        else:
            add(result, key, value)
    return result


def congruence(basis: Matrix, gram: Matrix | None) -> Matrix:
    """B' Q B in whole numbers over one denominator (Q = I if None)."""
    n = len(basis)
    b, b_scale = _whole(basis)
    if gram is None:
        q_scale, middle = 1, b
    else:
        q, q_scale = _whole(gram)
        columns = list(zip(*b, strict=True))
        middle = [[sum(map(mul, row, column)) for column in columns] for row in q]
    left, right = list(zip(*b, strict=True)), list(zip(*middle, strict=True))
    scale = b_scale * b_scale * q_scale
    return [[Fraction(sum(map(mul, left[i], right[j])), scale) for j in range(n)] for i in range(n)]


def form(matrix: Matrix, exponents: list[tuple[int, ...]]) -> Terms:
    """The polynomial m' R m in the monomials m."""
    terms: Terms = {}
    for i, first in enumerate(exponents):
        for j, second in enumerate(exponents):
            add(terms, tuple(a + b for a, b in zip(first, second, strict=True)), matrix[i][j])
    return terms


def positive_definite(matrix: Matrix, shift: Fraction) -> bool:
    """Whether matrix - shift I is positive definite: fraction-free (Bareiss) elimination of whole numbers.

    Raises
    ------
    ValueError
        If the matrix is not symmetric.
    """
    return determinant(matrix, shift) > 0


def determinant(matrix: Matrix, shift: Fraction = Fraction(0)) -> Fraction:
    """Determinant of matrix - shift I if that is positive definite, otherwise 0; ValueError if not symmetric."""
    n = len(matrix)
    common = max([x.denominator for row in matrix for x in row] + [shift.denominator])
    a = [[int(x * common) for x in row] for row in matrix]
    for i in range(n):
        a[i][i] -= int(shift * common)
        for j in range(i):
            if a[i][j] != a[j][i]:
                raise ValueError("a matrix of the certificate is not symmetric.")
    before = 1
    for k in range(n):
        pivot = a[k][k]
        if pivot <= 0:
            return Fraction(0)
        for i in range(k + 1, n):
            for j in range(k + 1, i + 1):
                a[i][j] = a[j][i] = (a[i][j] * pivot - a[i][k] * a[k][j]) // before
        before = pivot
    return Fraction(before, common**n)


def root_above(square: Fraction) -> Fraction:
    """Return an upper bound of the square root, equal to it where it is a fraction, otherwise within 2^-64 of it."""
    product = square.numerator * square.denominator
    root = isqrt(product)
    if root * root == product:
        return Fraction(root, square.denominator)
    return Fraction(isqrt(product << 128) + 1, square.denominator << 64)


def interpolated(nodes: Matrix, values: list[Fraction], exponents: list[tuple[int, ...]]) -> tuple[Terms, Fraction]:
    """Polynomial through values at nodes, and a proven bound of the sum of its coefficients' errors.

    An approximate inverse Y of the matrix M of monomials at the nodes serves to refine the coefficients in exact
    arithmetic; with |I - Y M| <= w < 1 in the norm of column sums, a residual r at the nodes stands for coefficients
    that add up to |Y r| / (1 - w) at most.

    Raises
    ------
    ValueError
        If the nodes do not determine the polynomial, as far as can be proven.
    """
    table = [[_monomial(node, powers) for powers in exponents] for node in nodes]
    whole, scale = _whole(table)
    n = len(values)
    inverse = [[round(x * 2.0**80) for x in row] for row in _inverse([[float(x) for x in row] for row in table])]
    one = scale << 80
    columns = list(zip(*whole, strict=True))
    defect = [
        sum(abs((one if i == j else 0) - sum(map(mul, row, column))) for i, row in enumerate(inverse))
        for j, column in enumerate(columns)
    ]
    worst = Fraction(max(defect), one)
    if worst >= Fraction(1, 2):
        raise ValueError("the nodes of a sum-of-squares constraint do not determine its polynomial.")
    largest = max((abs(x) for x in values), default=Fraction(0))
    # 200 bits below the largest value, whatever its scale.
    bits = max(0, 200 + largest.denominator.bit_length() - largest.numerator.bit_length()) if largest else 0
    coefficients, residual = [0] * n, values
    for _ in range(6):
        change = _product(inverse, residual)
        coefficients = [a + round(x * (1 << bits)) for a, x in zip(coefficients, change, strict=True)]
        residual = [
            f - Fraction(sum(map(mul, row, coefficients)), scale << bits) for f, row in zip(values, whole, strict=True)
        ]
    left = sum((abs(x) for x in _product(inverse, residual)), Fraction(0)) / (1 - worst)
    return {key: Fraction(a, 1 << bits) for key, a in zip(exponents, coefficients, strict=True)}, left


def _product(inverse: list[list[int]], residual: list[Fraction]) -> list[Fraction]:
    common = max(x.denominator for x in residual)
    whole = [int(x * common) for x in residual]
    return [Fraction(sum(map(mul, row, whole)), common << 80) for row in inverse]


def _monomial(point: list[Fraction], powers: tuple[int, ...]) -> Fraction:
    value = Fraction(1)
    for x, k in zip(point, powers, strict=True):
        value *= x**k
    return value


def _whole(matrix: Matrix) -> tuple[list[list[int]], int]:
    """Whole numbers and the power of two that they are to be divided by."""
    scale = max(x.denominator for row in matrix for x in row)
    return [[int(x * scale) for x in row] for row in matrix], scale


def _inverse(matrix: list[list[float]]) -> list[list[float]]:
    """Approximate inverse by elimination with partial pivoting; ValueError if a pivot vanishes."""
    n = len(matrix)
    a = [[*row, *(1.0 if i == j else 0.0 for j in range(n))] for i, row in enumerate(matrix)]
    for k in range(n):
        best = max(range(k, n), key=lambda i: abs(a[i][k]))
        a[k], a[best] = a[best], a[k]
        pivot = a[k][k]
        if pivot == 0.0:
            raise ValueError("the nodes of a sum-of-squares constraint do not determine its polynomial.")
        top = a[k] = [x / pivot for x in a[k]]
        for i in range(n):
            factor = a[i][k]
            if i != k and factor != 0.0:
                a[i] = [x - factor * y for x, y in zip(a[i], top, strict=True)]
    return [row[n:] for row in a]
