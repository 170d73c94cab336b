"""The Newton direction: right-hand sides, elimination, and the directions of blocks and cones."""

from __future__ import annotations

import numpy as np

from aerotube.sos.interior import blas, blocks, cones, small
from aerotube.sos.interior.compiled import inner, keep_apart
from aerotube.sos.interior.layout import (
    BACK,
    DD,
    DQ,
    DS,
    DY,
    DZ,
    FIRST,
    INVERSE,
    K2,
    KIND,
    LAST,
    LMI,
    MISFIT,
    NORM,
    OBJECTIVE,
    ORDER,
    RD,
    RESIDUAL,
    RHS,
    ROOT,
    ROWS,
    SCALE,
    SCHUR,
    SCHUR_FACTOR,
    SCRATCH,
    SHORT,
    SOS,
    TALL,
    TARGET,
    U2,
    A,
    D,
    E,
    G,
    M,
    Q,
    S,
    T,
    V,
    W,
    Y,
    block,
    compact,
    decision,
    entries,
    matrix_at,
    part,
    rows_of,
    tall_of,
    turned_of,
    weights_of,
    wide_of,
)  # fmt: skip
from aerotube.sos.interior.schur import divide_system
from aerotube.sos.interior.state import (
    BETA_OMEGA,
    GAP_RESIDUAL,
    HOMOGENEOUS,
    KAPPA,
    MU,
    TAU,
    add_adjoint,
    gather,
    moments,
    numbers,
    scratch,
    values,
)  # fmt: skip

NO, YES = np.arange(2)
REFINE_ABOVE, REFINE_SHARE = 1e-13, 0.03
"""Error of the scaled equations in a direction that is worth another solve: also where, beside the complementarity, it
would eat into the margins that certify the iterate."""


@inner
def block_targets(lay, st, i, center, eta, second):  # type: ignore[no-untyped-def]
    """T of every block: center Z^-1 - Q, less the second-order term sym(dQ E), less an inequality's residual."""
    keep_apart()
    goal = max(center, lay.numbers[lay.con[TARGET, i]] * numbers(lay, st)[BETA_OMEGA])
    for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
        n = lay.blk[ORDER, b]
        room = scratch(lay, st, SCRATCH, n * n)
        target, inverse, current = entries(lay, st, T, b), entries(lay, st, INVERSE, b), entries(lay, st, Q, b)
        for k in range(n * n):
            target[k] = goal * inverse[k] - current[k]
        if lay.con[KIND, i] == LMI:
            room = scratch(lay, st, SCRATCH, 4 * n * n)
            scale, divide = block(lay, st, SCALE, b), block(lay, st, E, b)
            if second == 1:
                blocks.add_second_order(
                    scale, block(lay, st, BACK, b), divide, block(lay, st, DQ, b), block(lay, st, DZ, b),
                    block(lay, st, T, b), room,
                )  # fmt: skip
            if eta != 0.0:
                blocks.add_two_sided(scale, block(lay, st, MISFIT, b), -eta, block(lay, st, T, b), room)
        elif second == 1:
            # Kept in dZ, which is free from here on: a sampled constraint needs its values at the nodes as well.
            correction = entries(lay, st, DZ, b)
            correction[:] = 0.0
            blocks.symmetric_product(block(lay, st, DQ, b), block(lay, st, E, b), -1.0, block(lay, st, DZ, b), room)
            for k in range(n * n):
                target[k] += correction[k]


@inner
def sampled_side(lay, st, i, center, eta, second):  # type: ignore[no-untyped-def]
    """Find a' of a sampled constraint: L^-1 (A(T) - eta r), with A(Q) written as its value less its residual."""
    keep_apart()
    a, k2, residual = part(lay, st, A, i), part(lay, st, K2, i), part(lay, st, RESIDUAL, i)
    a[:] = 0.0
    if center > 0.0 or second == 1 or eta < 1.0:
        for u in range(a.shape[0]):
            a[u] = center * k2[u] + (1.0 - eta) * residual[u]
        if second == 1:
            for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
                blocks.add_values(
                    turned_of(lay, b), weights_of(lay, b), block(lay, st, DZ, b), 1.0, a, wide_of(lay, st, TALL, b)
                )
        divide_system(lay, st, i, a, YES)
    known = gather(lay, st, i, D, numbers(lay, st)[TAU])
    blas.times_vector(compact(lay, st, V, i), known, a, -1.0, 1.0)


@inner
def cone_side(lay, st, i, center, eta, second):  # type: ignore[no-untyped-def]
    r"""Find a' of a cone: lambda \ (center e - lambda o lambda - second-order term) - eta W^-1 r."""
    keep_apart()
    rows = lay.con[ROWS, i]
    a, residual, root = part(lay, st, A, i), part(lay, st, RESIDUAL, i), part(lay, st, ROOT, i)
    s, y, ds, dy = part(lay, st, S, i), part(lay, st, Y, i), part(lay, st, DS, i), part(lay, st, DY, i)
    if lay.con[KIND, i] != NORM:
        for r in range(rows):
            right = center - s[r] * y[r] - (ds[r] * dy[r] if second == 1 else 0.0)
            a[r] = right / np.sqrt(s[r] * y[r]) - eta * residual[r] / root[r]
        return
    w, room = part(lay, st, W, i), scratch(lay, st, SHORT, 4 * rows)
    lam, first, other, right = room[:rows], room[rows : 2 * rows], room[2 * rows : 3 * rows], room[3 * rows :]
    cones.apply(w, root[0], y, lam, cones.FORWARD)
    cones.product(lam, lam, right)
    for r in range(rows):
        right[r] = -right[r]
    right[0] += center
    if second == 1:
        cones.apply(w, root[0], ds, first, cones.INVERSE)
        cones.apply(w, root[0], dy, other, cones.FORWARD)
        cones.product(first, other, a)
        for r in range(rows):
            right[r] -= a[r]
    cones.divide(lam, right, a)
    cones.apply(w, root[0], residual, other, cones.INVERSE)
    for r in range(rows):
        a[r] -= eta * other[r]


@inner
def eliminate(lay, st, eta, tau_side):  # type: ignore[no-untyped-def]
    """Solve for dd from the right-hand side; return dtau (0 unless homogeneous)."""
    keep_apart()
    m, number = lay.at[M], numbers(lay, st)
    factor = matrix_at(st.heap, lay.at[SCHUR_FACTOR], m, m)
    dd, rhs, rd = decision(lay, st, DD)[:m], decision(lay, st, RHS), decision(lay, st, RD)
    for j in range(m):
        dd[j] = rhs[j] - eta * rd[j]
    blas.solve_lower_vector(factor, dd)
    blas.solve_upper_vector(factor, dd)
    if st.ints[HOMOGENEOUS] == 0:
        return 0.0
    schur, objective, u2 = (
        scratch(lay, st, SCHUR, (m + 1) ** 2),
        decision(lay, st, OBJECTIVE),
        decision(lay, st, U2)[:m],
    )
    last = schur[m * (m + 1) :]
    for j in range(m):
        u2[j] = last[j] + objective[j]
    blas.solve_lower_vector(factor, u2)
    blas.solve_upper_vector(factor, u2)
    above = rhs[m] + tau_side / number[TAU] - eta * number[GAP_RESIDUAL]
    below = last[m] + number[KAPPA] / number[TAU]
    for j in range(m):
        slope = objective[j] - last[j]
        above += slope * dd[j]
        below += slope * u2[j]
    dtau = above / below
    for j in range(m):
        dd[j] -= dtau * u2[j]
    return dtau


@inner
def subtract_scaled(lay, st, i, dtau, out):  # type: ignore[no-untyped-def]
    """Subtract from out V_i (dd, dtau)."""
    scaled, known = compact(lay, st, V, i), gather(lay, st, i, DD, dtau)
    blas.times_vector(scaled, known, out, -1.0, 1.0)


@inner
def recover_vectors(lay, st, i, dtau, eta):  # type: ignore[no-untyped-def]
    """Directions of constraint i's multiplier and slack from dd and dtau (dZ for a matrix inequality)."""
    keep_apart()
    kind = lay.con[KIND, i]
    if kind == LMI:
        values(lay, st, DD, dtau, i, entries(lay, st, DZ, lay.con[FIRST, i]))
        return
    a, dy, root = part(lay, st, A, i), part(lay, st, DY, i), part(lay, st, ROOT, i)
    subtract_scaled(lay, st, i, dtau, a)
    if kind == SOS:
        small.copy(a, dy)
        divide_system(lay, st, i, dy, NO)
        return
    if kind == NORM:
        cones.apply(part(lay, st, W, i), root[0], a, dy, cones.INVERSE)
    else:
        for r in range(a.shape[0]):
            dy[r] = a[r] / root[r]
    ds, residual = part(lay, st, DS, i), part(lay, st, RESIDUAL, i)
    values(lay, st, DD, dtau, i, ds)
    for r in range(a.shape[0]):
        ds[r] += eta * residual[r]


@inner
def recover(lay, st, dtau, eta):  # type: ignore[no-untyped-def]
    """Directions of all multipliers, slacks and matrices."""
    keep_apart()
    for i in range(lay.con.shape[1]):
        recover_vectors(lay, st, i, dtau, eta)
    moments(lay, st, DY, DZ)
    for i in range(lay.con.shape[1]):
        for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
            n = lay.blk[ORDER, b]
            inverse, dZ, product = block(lay, st, INVERSE, b), block(lay, st, DZ, b), block(lay, st, E, b)
            small.copy(entries(lay, st, T, b), entries(lay, st, DQ, b))
            room = scratch(lay, st, SCRATCH, 4 * n * n)
            if lay.con[KIND, i] == LMI:
                blocks.add_two_sided(block(lay, st, SCALE, b), dZ, -1.0, block(lay, st, DQ, b), room)
                small.add(entries(lay, st, DZ, b), eta, entries(lay, st, MISFIT, b))
            else:
                blas.multiply(dZ, inverse, product)
                blocks.symmetric_product(block(lay, st, Q, b), product, -1.0, block(lay, st, DQ, b), room)


@inner
def direction(lay, st, center, eta, second, tau_side):  # type: ignore[no-untyped-def]
    """Newton direction to complementarity `center` that removes a share `eta` of the residuals; return dtau.

    With `second`, the products of the previous direction correct the complementarity (Mehrotra).
    """
    keep_apart()
    rhs = decision(lay, st, RHS)
    rhs[:] = 0.0
    for i in range(lay.con.shape[1]):
        block_targets(lay, st, i, center, eta, second)
        if lay.con[KIND, i] == LMI:
            add_adjoint(lay, st, G, i, entries(lay, st, T, lay.con[FIRST, i]), rhs)
            continue
        if lay.con[KIND, i] == SOS:
            sampled_side(lay, st, i, center, eta, second)
        else:
            cone_side(lay, st, i, center, eta, second)
        add_adjoint(lay, st, V, i, part(lay, st, A, i), rhs)
    dtau = eliminate(lay, st, eta, tau_side)
    recover(lay, st, dtau, eta)
    return dtau


@inner
def leftover(lay, st, dtau, eta):  # type: ignore[no-untyped-def]
    """Put what rounding left of the sampled constraints' equations into `a`; return the largest."""
    worst = 0.0
    for i in range(lay.con.shape[1]):
        if lay.con[KIND, i] == LMI:
            continue
        rest, residual = part(lay, st, A, i), part(lay, st, RESIDUAL, i)
        rest[:] = 0.0
        if lay.con[KIND, i] != SOS:
            continue
        values(lay, st, DD, dtau, i, rest)
        for u in range(rest.shape[0]):
            rest[u] = -rest[u] - eta * residual[u]
        for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
            dQ, wide = block(lay, st, DQ, b), wide_of(lay, st, TALL, b)
            blocks.add_values(turned_of(lay, b), weights_of(lay, b), dQ, 1.0, rest, wide)
        worst = max(worst, small.largest(rest))
    return worst


@inner
def refine(lay, st, dtau, eta):  # type: ignore[no-untyped-def]
    """Remove what rounding left of the sampled constraints' equations in the direction, by one more solve."""
    keep_apart()
    if leftover(lay, st, dtau, eta) < max(1e-16, min(REFINE_ABOVE, REFINE_SHARE * numbers(lay, st)[MU])):
        return
    m = lay.at[M]
    factor = matrix_at(st.heap, lay.at[SCHUR_FACTOR], m, m)
    dd, kept, rhs = decision(lay, st, DD), decision(lay, st, U2), decision(lay, st, RHS)
    rhs[:] = 0.0
    for i in range(lay.con.shape[1]):
        if lay.con[KIND, i] == SOS:
            divide_system(lay, st, i, part(lay, st, A, i), YES)
            add_adjoint(lay, st, V, i, part(lay, st, A, i), rhs)
    small.copy(dd, kept)
    small.copy(rhs, dd)
    blas.solve_lower_vector(factor, dd[:m])
    blas.solve_upper_vector(factor, dd[:m])
    for i in range(lay.con.shape[1]):
        refine_part(lay, st, i)
    small.add(dd, 1.0, kept)


@inner
def refine_part(lay, st, i):  # type: ignore[no-untyped-def]
    """Add the correction that `dd` and `a` hold to constraint i's part of the direction."""
    keep_apart()
    kind, zero = lay.con[KIND, i], 0.0
    if kind == LMI:
        values(lay, st, DD, zero, i, entries(lay, st, T, lay.con[FIRST, i]))
    else:
        a, dy, root = part(lay, st, A, i), part(lay, st, DY, i), part(lay, st, ROOT, i)
        subtract_scaled(lay, st, i, zero, a)
        if kind == SOS:
            divide_system(lay, st, i, a, NO)
            small.add(dy, 1.0, a)
        else:
            change = scratch(lay, st, SCRATCH, a.shape[0])
            if kind == NORM:
                cones.apply(part(lay, st, W, i), root[0], a, change, cones.INVERSE)
            else:
                for r in range(a.shape[0]):
                    change[r] = a[r] / root[r]
            small.add(dy, 1.0, change)
            values(lay, st, DD, zero, i, change)
            small.add(part(lay, st, DS, i), 1.0, change)
    for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
        n = lay.blk[ORDER, b]
        target, room = block(lay, st, T, b), scratch(lay, st, SCRATCH, n * n)
        product = matrix_at(st.heap, lay.at[SCRATCH] + n * n, n, n)
        if kind == SOS:
            functional = part(lay, st, A, i)
            blocks.moment_matrix(rows_of(lay, b), weights_of(lay, b), functional, target, tall_of(lay, st, b))
            blas.multiply(target, block(lay, st, INVERSE, b), product)
            blocks.symmetric_product(block(lay, st, Q, b), product, -1.0, block(lay, st, DQ, b), room)
            start = lay.at[SCRATCH] + n * n
            small.add(entries(lay, st, E, b), 1.0, st.heap[start : start + n * n])
        else:
            space = scratch(lay, st, SCRATCH, 4 * n * n)
            blocks.add_two_sided(block(lay, st, SCALE, b), target, -1.0, block(lay, st, DQ, b), space)
        small.add(entries(lay, st, DZ, b), 1.0, entries(lay, st, T, b))
