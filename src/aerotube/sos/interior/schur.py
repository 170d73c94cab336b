"""Factoring every constraint's own system and adding up the Schur complement of the decision vector."""

from __future__ import annotations

from aerotube.sos.interior import blas, blocks, cones, small
from aerotube.sos.interior.compiled import inner, keep_apart
from aerotube.sos.interior.layout import (
    FACTOR,
    FACTOR_AT,
    FIRST,
    K2,
    KIND,
    LAST,
    LMI,
    LOCAL,
    LZ,
    NORM,
    ROOT,
    ROWS,
    SCALE,
    SCHUR,
    SCHUR_FACTOR,
    SOS,
    SQUARE,
    SQUARE2,
    TALL,
    TALLQ,
    G,
    M,
    V,
    W,
    active,
    block,
    compact,
    matrix_at,
    part,
    rows_of,
    tall_of,
    weights_of,
)  # fmt: skip


@inner
def factor_of(lay, st, i):  # type: ignore[no-untyped-def]
    """Schur factor (U, U) of a sampled constraint."""
    rows = lay.con[ROWS, i]
    return matrix_at(st.heap, lay.at[FACTOR] + lay.con[FACTOR_AT, i], rows, rows)


@inner
def factor_sampled(lay, st, i):  # type: ignore[no-untyped-def]
    """Factor a sampled constraint's Schur complement, with a diagonal lift as small as succeeds."""
    keep_apart()
    rows, matrix, k2 = lay.con[ROWS, i], factor_of(lay, st, i), part(lay, st, K2, i)
    first = matrix_at(st.heap, lay.at[SQUARE], rows, rows)
    second = matrix_at(st.heap, lay.at[SQUARE2], rows, rows)
    lift = 2e-16
    while lift < 1e-6:
        k2[:] = 0.0
        for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
            blocks.add_schur(
                rows_of(lay, b), weights_of(lay, b), tall_of(lay, st, TALLQ, b), block(lay, st, LZ, b),
                b == lay.con[FIRST, i], first, second, matrix, tall_of(lay, st, TALL, b), k2,
            )  # fmt: skip
        for u in range(rows):
            matrix[u, u] *= 1.0 + lift
        if blas.cholesky(matrix):
            return True
        lift *= 50.0
    return False


@inner
def scale_data(lay, st, i, local):  # type: ignore[no-untyped-def]
    """Fill V of constraint i and the lower triangle of its share V'V of the Schur complement."""
    keep_apart()
    data, scaled = compact(lay, st, G, i), compact(lay, st, V, i)
    rows, kind = lay.con[ROWS, i], lay.con[KIND, i]
    if kind == LMI:
        blocks.scale_inequality(data, block(lay, st, SCALE, lay.con[FIRST, i]), scaled)
        blas.gram_lower(scaled, local, 0.0)
        return
    root = part(lay, st, ROOT, i)
    if kind == SOS:
        small.copy_matrix(data, scaled)
        blas.solve_lower(factor_of(lay, st, i), scaled)
    elif kind == NORM:
        cones.apply_inverse_rows(part(lay, st, W, i), root[0], data, scaled)
    else:
        for r in range(rows):
            inverse = 1.0 / root[r]
            for c in range(data.shape[1]):
                scaled[r, c] = data[r, c] * inverse
    blas.inner_lower(scaled, local)


@inner
def assemble(lay, st):  # type: ignore[no-untyped-def]
    """Add up the Schur complement (m + 1, m + 1), lower triangle, and factor its leading part; False on failure."""
    keep_apart()
    m = lay.at[M]
    schur = matrix_at(st.heap, lay.at[SCHUR], m + 1, m + 1)
    schur[:] = 0.0
    for i in range(lay.con.shape[1]):
        if lay.con[KIND, i] == SOS and not factor_sampled(lay, st, i):
            return False
        columns = active(lay, st, i)
        local = matrix_at(st.heap, lay.at[LOCAL], columns.shape[0], columns.shape[0])
        scale_data(lay, st, i, local)
        for a in range(columns.shape[0]):
            for b in range(a + 1):
                schur[columns[a], columns[b]] += local[a, b]
    return factor_schur(schur, matrix_at(st.heap, lay.at[SCHUR_FACTOR], m, m))


@inner
def factor_schur(schur, factor):  # type: ignore[no-untyped-def]
    """Cholesky factor of the leading part of the Schur complement, lifted as little as succeeds."""
    keep_apart()
    m, top = factor.shape[0], 0.0
    for j in range(m):
        top = max(top, schur[j, j])
    lift = 1e-15
    while lift < 1e-5:
        for j in range(m):
            for k in range(j + 1):
                factor[j, k] = schur[j, k]
            # A variable that no constraint holds has no pivot of its own: it gets the largest.
            own = schur[j, j]
            factor[j, j] += lift * own + (1e-4 * lift * top if own > 0.0 else max(top, 1.0))
        if blas.cholesky(factor):
            return True
        lift *= 50.0
    return False
