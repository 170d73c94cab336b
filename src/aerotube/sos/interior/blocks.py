"""Matrix blocks: Gram matrices of sampled sums of squares, and linear matrix inequalities.

Each block has a matrix `Q` that multiplies and a matrix `Z` that depends linearly on other unknowns,

    sums of squares:  Z = sum_u y_u g(z_u) p_u p_u'   (Q the Gram matrix, y the multiplier),
    inequalities:     Z = F0 + sum_i d_i F_i          (Q the multiplier),

and complementarity Q Z = t I, linearised as  dQ = T - sym(Q dZ Z^-1)  (the direction of Helmberg, Kojima and Monteiro).
Because the constraint matrices of a sampled sum of squares are of rank one, its Schur complement is the entrywise
product (P Q P') o (P Z^-1 P'), summed over blocks with weights g g'.
"""

from __future__ import annotations

import numpy as np

from aerotube.sos.interior import blas, small, tiles
from aerotube.sos.interior.compiled import inner, keep_apart


@inner
def moment_matrix(p, g, y, out, tall):  # type: ignore[no-untyped-def]
    """Out = sum_u y_u g_u p_u p_u'; tall is scratch (U, N)."""
    keep_apart()
    rows, n = p.shape
    plain = g.shape[0] == 0
    for u in range(rows):
        scale = y[u] if plain else y[u] * g[u]
        for j in range(n):
            tall[u, j] = scale * p[u, j]
    blas.multiply_first_transposed(p, tall, out)


@inner
def add_products(left, right, g, factor, out):  # type: ignore[no-untyped-def]
    """out_u += factor * g_u sum_k left_ku right_ku."""
    keep_apart()
    plain = g.shape[0] == 0
    for k in range(left.shape[0]):
        for u in range(out.shape[0]):
            weight = factor if plain else factor * g[u]
            out[u] += weight * left[k, u] * right[k, u]


@inner
def add_values(turned, g, gram, factor, out, wide):  # type: ignore[no-untyped-def]
    """out_u += factor * g_u p_u' gram p_u; turned is P', wide is scratch of its shape."""
    keep_apart()
    blas.multiply(gram, turned, wide)
    add_products(wide, turned, g, factor, out)


@inner
def copy_lower(source, out):  # type: ignore[no-untyped-def]
    """Out = lower triangle of source, zeros above."""
    n = source.shape[0]
    for i in range(n):
        for j in range(i + 1):
            out[i, j] = source[i, j]
        for j in range(i + 1, n):
            out[i, j] = 0.0


@inner
def factor_pair(Q, Z, LQ, LZ, inverse, scratch):  # type: ignore[no-untyped-def]
    """Factors of Q and Z, and the inverse of Z; False if either is not positive definite."""
    keep_apart()
    n = Q.shape[0]
    copy_lower(Q, LQ)
    copy_lower(Z, LZ)
    if not small.try_cholesky(LQ) or not small.try_cholesky(LZ):
        return False
    half = scratch[: n * n].reshape((n, n))
    small.invert_factor(LZ, half)
    blas.multiply_first_transposed(half, half, inverse)
    return True


@inner
def add_schur(turned, g, wide_q, LZ, begin, system, at, row, k2, room):  # type: ignore[no-untyped-def]
    """Add (or, at `begin`, set) a block's Schur complement in the upper tiles of a system.

    The system lies from `at` on in a flat array, its rows `row` numbers apart; wide_q is (P L_Q)'. Also adds to k2 the
    values of g p'Z^-1 p. room is scratch.
    """
    keep_apart()
    n, wide = turned.shape
    inverse = room[: n * n].reshape((n, n))
    wide_z = room[n * n : n * (n + wide)].reshape((n, wide))
    small.invert_factor(LZ, inverse)
    blas.multiply(inverse, turned, wide_z)
    add_products(wide_z, wide_z, g, 1.0, k2)
    if g.shape[0] > 0:
        for k in range(n):
            for u in range(g.shape[0]):
                wide_z[k, u] *= g[u]
    tiles.gram_product(wide_q.reshape(n * wide), 0, room, n * n, wide, n, wide, system, at, row, begin)


@inner
def symmetric_product(a, b, factor, out, scratch):  # type: ignore[no-untyped-def]
    """Out += factor * sym(a b)."""
    keep_apart()
    n = a.shape[0]
    c = scratch[: n * n].reshape((n, n))
    blas.multiply(a, b, c)
    half = 0.5 * factor
    for i in range(n):
        for j in range(i):
            value = half * (c[i, j] + c[j, i])
            out[i, j] += value
            out[j, i] += value
        out[i, i] += factor * c[i, i]


@inner
def scale_pair(LQ, LZ, scale, back, divide, scratch):  # type: ignore[no-untyped-def]
    """Scaling of Nesterov and Todd: scale Z scale' = back Q back' = diag(lambda), back = scale'^-1.

    Fills divide with 1 / (lambda_i + lambda_j).
    """
    keep_apart()
    n = LQ.shape[0]
    product = scratch[: n * n].reshape((n, n))
    blas.multiply_first_transposed(LQ, LZ, product)
    for i in range(n):
        for j in range(n):
            scale[i, j] = LQ[j, i]
    small.orthogonalise(product, scale)
    blas.multiply_second_transposed(product, LZ, back)
    for i in range(n):
        square = 0.0
        for j in range(n):
            square += product[i, j] * product[i, j]
        # lambda_i, its root and the root of its cube
        own = np.sqrt(square)
        root = np.sqrt(own)
        divide[i, i] = own
        for j in range(n):
            scale[i, j] /= root
            back[i, j] /= own * root
    for i in range(n):
        for j in range(i):
            divide[i, j] = divide[j, i] = 1.0 / (divide[i, i] + divide[j, j])
    for i in range(n):
        divide[i, i] = 0.5 / divide[i, i]


@inner
def transform(scale, x, out, scratch):  # type: ignore[no-untyped-def]
    """Out = scale x scale', x symmetric."""
    keep_apart()
    n = x.shape[0]
    product = scratch[: n * n].reshape((n, n))
    blas.multiply(scale, x, product)
    blas.multiply_second_transposed(product, scale, out)


@inner
def add_transformed(scale, x, factor, out, scratch):  # type: ignore[no-untyped-def]
    """Out += factor scale' x scale, x symmetric."""
    keep_apart()
    n = x.shape[0]
    product, result = scratch[: n * n].reshape((n, n)), scratch[n * n : 2 * n * n].reshape((n, n))
    blas.multiply(x, scale, product)
    blas.multiply_first_transposed(scale, product, result)
    for i in range(n):
        for j in range(n):
            out[i, j] += factor * 0.5 * (result[i, j] + result[j, i])


@inner
def add_second_order(scale, back, divide, dQ, dZ, out, scratch):  # type: ignore[no-untyped-def]
    """Subtract from out the second-order term of the scaled complementarity."""
    keep_apart()
    n = dQ.shape[0]
    left, right = scratch[: n * n].reshape((n, n)), scratch[n * n : 2 * n * n].reshape((n, n))
    rest = scratch[2 * n * n :]
    transform(back, dQ, left, rest)
    transform(scale, dZ, right, rest)
    both = rest[: n * n].reshape((n, n))
    blas.multiply(left, right, both)
    for i in range(n):
        for j in range(i + 1):
            left[i, j] = left[j, i] = (both[i, j] + both[j, i]) * divide[i, j]
    add_transformed(scale, left, -1.0, out, scratch[n * n :])


@inner
def add_two_sided(scale, x, factor, out, scratch):  # type: ignore[no-untyped-def]
    """Out += factor W x W, W = scale' scale."""
    keep_apart()
    n = x.shape[0]
    middle = scratch[: n * n].reshape((n, n))
    transform(scale, x, middle, scratch[n * n :])
    add_transformed(scale, middle, factor, out, scratch[n * n :])


@inner
def scale_inequality(G, scale, V):  # type: ignore[no-untyped-def]
    """Row i of V (width, k^2) is scale F_i scale', so that V V' is the inequality's Schur complement.

    The matrices F_i are mostly zeros, so the product is made entry by entry.
    """
    keep_apart()
    k = scale.shape[0]
    for a in range(G.shape[0]):
        row = V[a].reshape((k, k))
        F = G[a].reshape((k, k))
        row[:] = 0.0
        for r in range(k):
            for c in range(k):
                value = F[r, c]
                if value != 0.0:
                    for i in range(k):
                        left = value * scale[i, r]
                        for j in range(k):
                            row[i, j] += left * scale[j, c]
