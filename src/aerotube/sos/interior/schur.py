"""Factoring every constraint's own system and adding up the Schur complement of the decision vector."""

from __future__ import annotations

from aerotube.sos.interior import blas, blocks, cones, tiles
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
    ROOM,
    ROOT,
    ROWS,
    SCALE,
    SCHUR,
    SCHUR_FACTOR,
    SHORT,
    SOS,
    SPACE,
    WIDEQ,
    G,
    M,
    V,
    W,
    active,
    block,
    compact,
    failed,
    matrix_at,
    part,
    turned_of,
    weights_of,
    wide_of,
)  # fmt: skip
from aerotube.sos.interior.state import scratch
from aerotube.sos.interior.tiles import padded


@inner
def system_of(lay, st, i):  # type: ignore[no-untyped-def]
    """Schur complement H of a sampled constraint beside its data C (see `tiles.factor`): flat, and a row's length.

    The inverses of the diagonal of its factor follow in the array.
    """
    order = padded(lay.con[ROWS, i])
    row, start = order + padded(active(lay, st, i).shape[0]), lay.at[FACTOR] + lay.con[FACTOR_AT, i]
    return st.heap[start : start + order * (row + 1)], row


@inner
def divide_system(lay, st, i, x, transposed):  # type: ignore[no-untyped-def]
    """Overwrite x by R^-1 x or, transposed, R'^-1 x, R the factor of a sampled constraint's Schur complement."""
    system, row = system_of(lay, st, i)
    order = padded(x.shape[0])
    inverses, whole = system[order * row :], scratch(lay, st, SHORT, order)
    for u in range(order):
        whole[u] = x[u] if u < x.shape[0] else 0.0
    if transposed == 1:
        tiles.divide_by_transpose(system, row, order, inverses, whole)
    else:
        tiles.divide(system, row, order, inverses, whole)
    for u in range(x.shape[0]):
        x[u] = whole[u]


@inner
def share_of(lay, st, i):  # type: ignore[no-untyped-def]
    """Storage of constraint i's share of the Schur complement: sampled constraints have their own, others share one."""
    width, slot, m = active(lay, st, i).shape[0], 0, lay.at[M]
    if lay.con[KIND, i] == SOS:
        for k in range(i + 1):
            slot += 1 if lay.con[KIND, k] == SOS else 0
    return matrix_at(st.heap, lay.at[LOCAL] + slot * (m + 1) ** 2, width, width)


@inner
def reduce_sampled(lay, st, i, room):  # type: ignore[no-untyped-def]
    """Factor a sampled constraint's Schur complement, with a diagonal lift as small as succeeds.

    Fills V and the constraint's share V'V of the decision vector's Schur complement. Touches nothing that belongs to
    another constraint, so that constraints can be dealt with at the same time, each with scratch `room` of its own.
    """
    keep_apart()
    rows, k2 = lay.con[ROWS, i], part(lay, st, K2, i)
    system, row = system_of(lay, st, i)
    order, scaled = padded(rows), compact(lay, st, V, i)
    lift, bad = 2e-16, True
    while bad and lift < 1e-6:
        k2[:] = 0.0
        for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
            blocks.add_schur(
                turned_of(lay, b), weights_of(lay, b), wide_of(lay, st, WIDEQ, b), block(lay, st, LZ, b),
                b == lay.con[FIRST, i], system, 0, row, k2, room,
            )  # fmt: skip
        for u in range(rows):
            system[u * (row + 1)] *= 1.0 + lift
        set_beside(system, row, compact(lay, st, G, i), order)
        bad = not tiles.factor(system, 0, row, order, row, system, order * row)
        lift *= 50.0
    failed(lay, st)[i] = 1 if bad else 0
    if not bad:
        for u in range(rows):
            for a in range(scaled.shape[1]):
                scaled[u, a] = system[u * row + order + a]
        blas.multiply_first_transposed(scaled, scaled, share_of(lay, st, i))


@inner
def set_beside(system, row, data, order):  # type: ignore[no-untyped-def]
    """Write the data to the right of a system of padded order, and fill up what pads it: ones on the diagonal."""
    keep_apart()
    for u in range(order):
        start = u * row + order
        for a in range(row - order):
            system[start + a] = 0.0
        if u < data.shape[0]:
            for a in range(data.shape[1]):
                system[start + a] = data[u, a]
        else:
            system[u * (row + 1)] = 1.0


@inner
def reduce_direct(lay, st, i):  # type: ignore[no-untyped-def]
    """Fill V of a matrix inequality or a cone, and its share V'V of the Schur complement."""
    keep_apart()
    data, scaled, local = compact(lay, st, G, i), compact(lay, st, V, i), share_of(lay, st, i)
    kind = lay.con[KIND, i]
    if kind == LMI:
        blocks.scale_inequality(data, block(lay, st, SCALE, lay.con[FIRST, i]), scaled)
        blas.gram_lower(scaled, local, 0.0)
        return
    root = part(lay, st, ROOT, i)
    if kind == NORM:
        cones.apply_inverse_rows(part(lay, st, W, i), root[0], data, scaled)
    else:
        for r in range(scaled.shape[0]):
            inverse = 1.0 / root[r]
            for c in range(data.shape[1]):
                scaled[r, c] = data[r, c] * inverse
    blas.multiply_first_transposed(scaled, scaled, local)


@inner
def reduce_all(lay, st):  # type: ignore[no-untyped-def]
    """Reduce all sampled constraints, one after the other."""
    keep_apart()
    room = st.heap[lay.at[ROOM] : lay.at[ROOM] + lay.at[SPACE]]
    for i in range(lay.con.shape[1]):
        if lay.con[KIND, i] == SOS:
            reduce_sampled(lay, st, i, room)


@inner
def assemble(lay, st):  # type: ignore[no-untyped-def]
    """Add up the Schur complement (m + 1, m + 1), lower triangle, and factor its leading part; False on failure.

    The sampled constraints have been reduced before.
    """
    keep_apart()
    m = lay.at[M]
    schur = matrix_at(st.heap, lay.at[SCHUR], m + 1, m + 1)
    schur[:] = 0.0
    for i in range(lay.con.shape[1]):
        if lay.con[KIND, i] != SOS:
            reduce_direct(lay, st, i)
        elif failed(lay, st)[i] == 1:
            return False
        columns, local = active(lay, st, i), share_of(lay, st, i)
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
