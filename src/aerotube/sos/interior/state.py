"""The unknowns of the method: where it starts, and the maps of the data applied to them."""

from __future__ import annotations

import numpy as np

from aerotube.sos.interior import blas, blocks, cones
from aerotube.sos.interior.compiled import entry, inner, keep_apart
from aerotube.sos.interior.layout import (
    BACK,
    DEGREE,
    FIRST,
    INVERSE,
    KIND,
    LAST,
    LINEAR,
    LMI,
    LQ,
    LZ,
    MATRICES,
    NORM,
    NUMBER,
    OBJECTIVE,
    ORDER,
    OWNER,
    ROOT,
    ROWS,
    SCALE,
    SCRATCH,
    SHORT,
    SOS,
    TARGET,
    VECTOR,
    VECTORS,
    D,
    E,
    G,
    M,
    Q,
    S,
    W,
    Y,
    Z,
    active,
    block,
    compact,
    decision,
    part,
    rows_of,
    tall_of,
    weights_of,
)  # fmt: skip

AMPLE = 200.0
"""Complementarity to start from, over what the objective could be: from high above the central path is near."""
RUNNING, OPTIMAL, INFEASIBLE, UNBOUNDED, STALLED = -1, 0, 2, 3, 4
# Places among the integers of a state.
STATUS, ITERATIONS, HOMOGENEOUS, STALLS, EXTRA, NEXT = np.arange(6)
# Places among its numbers.
TAU, KAPPA, MU, PRIMAL, DUAL, GAP, PVALUE, DVALUE, STEP, BETA, OMEGA, DUAL_RAY, BEST, BETA_OMEGA = np.arange(14)
GAP_RESIDUAL, PRIMAL_RAY, BEST_PRIMAL, BEST_DUAL, BEST_GAP, SURE = np.arange(14, 20)
SURE_PRIMAL, SURE_DUAL, SURE_GAP, SURE_VALUE = np.arange(20, 24)


@inner
def numbers(lay, st):  # type: ignore[no-untyped-def]
    """Scalars of the state."""
    return st.heap[lay.at[NUMBER] : lay.at[NUMBER] + 24]


@inner
def scratch(lay, st, name, length):  # type: ignore[no-untyped-def]
    """First numbers of a scratch storage."""
    return st.heap[lay.at[name] : lay.at[name] + length]


@entry
def start(lay, st, homogeneous):  # type: ignore[no-untyped-def]
    """Set a starting point: d = 0, every cone at its size, which the scaling made one, and Q Z = mu I.

    mu is large beside what the objective may be: from high above, the central path is near. The multiplier of a
    sampled constraint is a multiple of the mean over the domain, so that Z is one of I.
    """
    st.ints[STATUS], st.ints[ITERATIONS], st.ints[HOMOGENEOUS], st.ints[STALLS] = RUNNING, 0, homogeneous, 0
    number = numbers(lay, st)
    number[BETA_OMEGA] = number[BETA] * number[OMEGA]
    objective, slope = decision(lay, st, OBJECTIVE), 0.0
    for j in range(lay.at[M]):
        slope += abs(objective[j])
    mu = AMPLE * slope / lay.at[DEGREE] if slope > 0.0 else 1.0
    for i in range(lay.con.shape[1]):
        mu = max(mu, lay.numbers[lay.con[TARGET, i]] * number[BETA_OMEGA])
    number[TAU] = 1.0
    number[KAPPA] = mu if homogeneous == 1 else 0.0
    number[STEP] = 1.0
    st.ints[EXTRA] = 0
    decision(lay, st, D)[:] = 0.0
    scratch(lay, st, Q, lay.at[MATRICES])[:] = 0.0
    scratch(lay, st, Z, lay.at[MATRICES])[:] = 0.0
    scratch(lay, st, S, lay.at[VECTORS])[:] = 0.0
    scratch(lay, st, Y, lay.at[VECTORS])[:] = 0.0
    begin = lay.numbers.shape[0] - 2 * lay.con.shape[1] - lay.at[VECTORS]
    for i in range(lay.con.shape[1]):
        kind, own = lay.con[KIND, i], 1.0
        if kind == SOS:
            # The squares of all basis functions add up to their number.
            count = 0
            for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
                count += lay.blk[ORDER, b]
            own /= count
        if kind != LMI:
            s, y = part(lay, st, S, i), part(lay, st, Y, i)
            if kind == SOS:
                for u in range(y.shape[0]):
                    y[u] = mu / own * lay.numbers[begin + lay.con[VECTOR, i] + u]
            elif kind == NORM:
                s[0], y[0] = own, mu / own
            else:
                s[:] = own
                y[:] = mu / own
        for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
            q, z = block(lay, st, Q, b), block(lay, st, Z, b)
            for k in range(lay.blk[ORDER, b]):
                q[k, k], z[k, k] = (mu / own, own) if kind == LMI else (own, mu / own)
    moments(lay, st, Y, Z)


@inner
def moments(lay, st, y, out):  # type: ignore[no-untyped-def]
    """Moment matrices, in storage `out`, of the functionals in storage `y`."""
    keep_apart()
    for i in range(lay.con.shape[1]):
        if lay.con[KIND, i] == SOS:
            functional = part(lay, st, y, i)
            for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
                blocks.moment_matrix(
                    rows_of(lay, b), weights_of(lay, b), functional, block(lay, st, out, b), tall_of(lay, st, b)
                )


@inner
def gather(lay, st, i, d, tau):  # type: ignore[no-untyped-def]
    """Entries of decision storage `d` that constraint i holds, and tau, in scratch."""
    keep_apart()
    columns, source = active(lay, st, i), decision(lay, st, d)
    width = columns.shape[0]
    short = scratch(lay, st, SHORT, width)
    for a in range(width - 1):
        short[a] = source[columns[a]]
    short[width - 1] = tau
    return short


@inner
def values(lay, st, d, tau, i, out):  # type: ignore[no-untyped-def]
    """Out = value of constraint i at decision storage `d` and tau."""
    keep_apart()
    short, data = gather(lay, st, i, d, tau), compact(lay, st, G, i)
    if lay.con[KIND, i] == LMI:
        blas.transposed_times_vector(data, short, out, 1.0, 0.0)
    else:
        blas.times_vector(data, short, out, 1.0, 0.0)


@inner
def add_adjoint(lay, st, name, i, x, out):  # type: ignore[no-untyped-def]
    """Out += adjoint of constraint i's data, in storage `name` (G or V), applied to x; out (m + 1,)."""
    keep_apart()
    columns, data = active(lay, st, i), compact(lay, st, name, i)
    short = scratch(lay, st, SHORT, columns.shape[0])
    if lay.con[KIND, i] == LMI:
        blas.times_vector(data, x, short, 1.0, 0.0)
    else:
        blas.transposed_times_vector(data, x, short, 1.0, 0.0)
    for a in range(columns.shape[0]):
        out[columns[a]] += short[a]


@inner
def factor_blocks(lay, st):  # type: ignore[no-untyped-def]
    """Factor every block and the scaling of every cone; False if a point has left its cone."""
    keep_apart()
    for b in range(lay.blk.shape[1]):
        n = lay.blk[ORDER, b]
        if not blocks.factor_pair(
            block(lay, st, Q, b), block(lay, st, Z, b), block(lay, st, LQ, b), block(lay, st, LZ, b),
            block(lay, st, INVERSE, b), scratch(lay, st, SCRATCH, n * n),
        ):  # fmt: skip
            return False
        if lay.con[KIND, lay.blk[OWNER, b]] == LMI:
            blocks.scale_pair(
                block(lay, st, LQ, b), block(lay, st, LZ, b), block(lay, st, SCALE, b), block(lay, st, BACK, b),
                block(lay, st, E, b), scratch(lay, st, SCRATCH, n * n),
            )  # fmt: skip
    for i in range(lay.con.shape[1]):
        kind = lay.con[KIND, i]
        if kind in (NORM, LINEAR):
            s, y, root = part(lay, st, S, i), part(lay, st, Y, i), part(lay, st, ROOT, i)
            if kind == NORM:
                root[0] = cones.scale_norm(s, y, part(lay, st, W, i))
                if not root[0] > 0.0:
                    return False
            else:
                for r in range(lay.con[ROWS, i]):
                    if not (s[r] > 0.0 and y[r] > 0.0):
                        return False
                    root[r] = np.sqrt(s[r] / y[r])
    return True
