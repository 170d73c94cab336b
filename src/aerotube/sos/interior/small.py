"""Dense linear algebra of small matrices, where a library call costs more than the work."""

from __future__ import annotations

import numpy as np

from aerotube.sos.interior import blas
from aerotube.sos.interior.compiled import inner, keep_apart

SMALL = 24


@inner
def try_cholesky(a):  # type: ignore[no-untyped-def]
    """Overwrite the lower triangle of a small matrix by its factor; stop and say False at the first bad pivot."""
    keep_apart()
    n = a.shape[0]
    if n > SMALL:
        return blas.cholesky(a)
    for j in range(n):
        pivot = a[j, j]
        for k in range(j):
            pivot -= a[j, k] * a[j, k]
        if not pivot > 0.0:
            return False
        root = np.sqrt(pivot)
        a[j, j] = root
        inverse = 1.0 / root
        for i in range(j + 1, n):
            total = a[i, j]
            for k in range(j):
                total -= a[i, k] * a[j, k]
            a[i, j] = total * inverse
    return True


@inner
def invert_factor(factor, out):  # type: ignore[no-untyped-def]
    """Out = L^-1 (lower triangle; zeros above) of a lower triangular factor."""
    keep_apart()
    n = factor.shape[0]
    for i in range(n):
        for j in range(n):
            out[i, j] = 0.0
        inverse = 1.0 / factor[i, i]
        for k in range(i):
            value = factor[i, k]
            for j in range(k + 1):
                out[i, j] -= value * out[k, j]
        for j in range(i):
            out[i, j] *= inverse
        out[i, i] = inverse


@inner
def orthogonalise(a, g):  # type: ignore[no-untyped-def]
    """Make the rows of a orthogonal by rotations, applied to the rows of g as well (one-sided Jacobi)."""
    keep_apart()
    n, k = a.shape
    for _ in range(30):
        worst = 0.0
        for p in range(n):
            for q in range(p + 1, n):
                alpha, beta, gamma = 0.0, 0.0, 0.0
                for i in range(k):
                    alpha += a[p, i] * a[p, i]
                    beta += a[q, i] * a[q, i]
                    gamma += a[p, i] * a[q, i]
                size = np.sqrt(alpha * beta)
                if not abs(gamma) > 1e-15 * size:
                    continue
                worst = max(worst, abs(gamma) / size)
                zeta = (beta - alpha) / (2.0 * gamma)
                tangent = (1.0 if zeta >= 0.0 else -1.0) / (abs(zeta) + np.sqrt(1.0 + zeta * zeta))
                cosine = 1.0 / np.sqrt(1.0 + tangent * tangent)
                sine = cosine * tangent
                for i in range(k):
                    left, right = a[p, i], a[q, i]
                    a[p, i], a[q, i] = cosine * left - sine * right, sine * left + cosine * right
                for i in range(g.shape[1]):
                    left, right = g[p, i], g[q, i]
                    g[p, i], g[q, i] = cosine * left - sine * right, sine * left + cosine * right
        # The next sweep would leave the square of that.
        if worst < 1e-8:
            return


@inner
def dot(a, b):  # type: ignore[no-untyped-def]
    """Inner product of two flat arrays."""
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i] * b[i]
    return total


@inner
def add(a, factor, b):  # type: ignore[no-untyped-def]
    """A += factor * b, flat arrays."""
    for i in range(a.shape[0]):
        a[i] += factor * b[i]


@inner
def copy(source, out):  # type: ignore[no-untyped-def]
    """Copy a flat array; a loop, because array assignment compiles to far more code."""
    for i in range(source.shape[0]):
        out[i] = source[i]


@inner
def largest(a):  # type: ignore[no-untyped-def]
    """Largest magnitude of a flat array."""
    top = 0.0
    for i in range(a.shape[0]):
        top = max(top, abs(a[i]))
    return top
