"""Second-order cones and linear inequalities, with Nesterov-Todd scaling.

A constraint's value s and multiplier z lie in the cone. The scaling W (symmetric, W z = W^-1 s = lambda) is held as a
vector w and a scalar root: for a linear row W = root = sqrt(s / z); for the second-order cone

    W = root [[w0, w1'], [w1, I + w1 w1' / (1 + w0)]],   w = (s / |s| + J z / |z|) / (2 g),   root = sqrt(|s| / |z|),

with |s|^2 = s0^2 - s1's1, J = diag(1, -I) and w0^2 - w1'w1 = 1.
Source: L. Vandenberghe, "The CVXOPT linear and quadratic cone program solvers" (2010), section 5.
"""

from __future__ import annotations

import numpy as np

from aerotube.sos.interior.compiled import inner, keep_apart

FORWARD, INVERSE = np.arange(2)


@inner
def residue(x):  # type: ignore[no-untyped-def]
    """x0^2 - x1'x1, without avoidable cancellation."""
    total = 0.0
    for i in range(1, x.shape[0]):
        total += x[i] * x[i]
    norm = np.sqrt(total)
    return (x[0] - norm) * (x[0] + norm)


@inner
def scale_norm(s, z, w):  # type: ignore[no-untyped-def]
    """Fill w; return root, or 0 if a point is not inside the cone."""
    keep_apart()
    rs, rz = residue(s), residue(z)
    if not (rs > 0.0 and rz > 0.0 and s[0] > 0.0 and z[0] > 0.0):
        return 0.0
    ns, nz = np.sqrt(rs), np.sqrt(rz)
    inner = 0.0
    for i in range(s.shape[0]):
        inner += (s[i] / ns) * (z[i] / nz)
    double = 2.0 * np.sqrt(0.5 * (1.0 + inner))
    total = 0.0
    for i in range(1, s.shape[0]):
        w[i] = (s[i] / ns - z[i] / nz) / double
        total += w[i] * w[i]
    w[0] = np.sqrt(1.0 + total)
    return np.sqrt(ns / nz)


@inner
def apply(w, root, x, out, inverse):  # type: ignore[no-untyped-def]
    """Out = W x, or W^-1 x."""
    keep_apart()
    sign = -1.0 if inverse == 1 else 1.0
    factor = 1.0 / root if inverse == 1 else root
    inner = 0.0
    for i in range(1, x.shape[0]):
        inner += w[i] * x[i]
    first = x[0]
    extra = sign * first + inner / (1.0 + w[0])
    out[0] = factor * (w[0] * first + sign * inner)
    for i in range(1, x.shape[0]):
        out[i] = factor * (x[i] + extra * w[i])


@inner
def apply_inverse_rows(w, root, matrix, out):  # type: ignore[no-untyped-def]
    """Out = W^-1 matrix, column by column."""
    keep_apart()
    n, k = matrix.shape
    factor = 1.0 / root
    for c in range(k):
        inner = 0.0
        for i in range(1, n):
            inner += w[i] * matrix[i, c]
        first = matrix[0, c]
        extra = -first + inner / (1.0 + w[0])
        out[0, c] = factor * (w[0] * first - inner)
        for i in range(1, n):
            out[i, c] = factor * (matrix[i, c] + extra * w[i])


@inner
def divide(lam, r, out):  # type: ignore[no-untyped-def]
    """Solve lambda o x = r for x, in the algebra of the cone."""
    keep_apart()
    inner = 0.0
    for i in range(1, r.shape[0]):
        inner += lam[i] * r[i]
    first = (lam[0] * r[0] - inner) / residue(lam)
    for i in range(1, r.shape[0]):
        out[i] = (r[i] - first * lam[i]) / lam[0]
    out[0] = first


@inner
def product(a, b, out):  # type: ignore[no-untyped-def]
    """Out = a o b in the algebra of the cone; out is neither a nor b."""
    keep_apart()
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i] * b[i]
    for i in range(1, a.shape[0]):
        out[i] = a[0] * b[i] + b[0] * a[i]
    out[0] = total


@inner
def longest_step(x, change, most):  # type: ignore[no-untyped-def]
    """Longest step up to `most` that keeps x + step * change in the cone."""
    keep_apart()
    n = x.shape[0]
    a, b, c = change[0] * change[0], x[0] * change[0], residue(x)
    for i in range(1, n):
        a -= change[i] * change[i]
        b -= x[i] * change[i]
    step = most
    if change[0] < 0.0:
        step = min(step, -x[0] / change[0])
    # Smallest positive root of a t^2 + 2 b t + c; c > 0.
    inside = b * b - a * c
    if inside >= 0.0 and (a < 0.0 or b < 0.0):
        step = min(step, c / (-b + np.sqrt(inside))) if -b + np.sqrt(inside) > 0.0 else step
    return step
