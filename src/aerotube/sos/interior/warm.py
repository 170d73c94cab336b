"""Starting a program from where a neighbour's solution was on its way.

An iterate from the end of a solve is of little use: it lies at the boundary of the cones. Kept is the first one whose
gap is below `KEEP_BELOW`, in the program's own units, and it is moved inwards before the next program starts from it.
Source: E. A. Yildirim, S. J. Wright, "Warm-start strategies in interior-point methods for linear programming", SIAM J.
Optim. 12 (2002).
"""

from __future__ import annotations

import numpy as np

from aerotube.sos.interior.compiled import inner, keep_apart
from aerotube.sos.interior.layout import (
    COLUMN,
    FIRST,
    GROUP,
    GROUPS,
    KIND,
    LAST,
    LINEAR,
    LMI,
    NEXT_D,
    NEXT_Q,
    NEXT_S,
    NEXT_Y,
    NEXT_Z,
    NORM,
    ORDER,
    ROW,
    SOS,
    VECTOR,
    VECTORS,
    D,
    M,
    Q,
    S,
    Y,
    Z,
    entries,
    part,
)  # fmt: skip
from aerotube.sos.interior.state import (
    BETA,
    GAP,
    HOMOGENEOUS,
    ITERATIONS,
    NEXT,
    OMEGA,
    moments,
    numbers,
    scratch,
)  # fmt: skip

KEEP_BELOW = 0.1
"""Gap of the iterate that is kept."""
INWARDS = 0.01
"""How far it is moved towards the centre of each cone, beside its own size."""
NONE, MINE, OTHERS = np.arange(3)
"""What is kept: nothing, an iterate of this solve, one of the solve before."""


@inner
def keep_for_next(lay, st):  # type: ignore[no-untyped-def]
    """Keep the iterate for the next program, if it is the first that is near enough."""
    keep_apart()
    number = numbers(lay, st)
    if st.ints[NEXT] == MINE or st.ints[HOMOGENEOUS] == 1 or st.ints[ITERATIONS] == 0 or not number[GAP] < KEEP_BELOW:
        return
    st.ints[NEXT] = MINE
    beta, omega = number[BETA], number[OMEGA]
    column, row = scratch(lay, st, COLUMN, lay.at[M]), scratch(lay, st, ROW, lay.at[GROUPS])
    d, out = scratch(lay, st, D, lay.at[M]), scratch(lay, st, NEXT_D, lay.at[M])
    for j in range(lay.at[M]):
        out[j] = d[j] * column[j] / beta
    for i in range(lay.con.shape[1]):
        kind, group = lay.con[KIND, i], lay.con[GROUP, i]
        size = row[group]
        for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
            q, own_q = entries(lay, st, Q, b), entries(lay, st, NEXT_Q, b)
            z, own_z = entries(lay, st, Z, b), entries(lay, st, NEXT_Z, b)
            of_q = size / omega if kind == LMI else 1.0 / (size * beta)
            for k in range(q.shape[0]):
                own_q[k], own_z[k] = of_q * q[k], z[k] / (size * beta)
        if kind != LMI:
            y, own_y = part(lay, st, Y, i), part(lay, st, NEXT_Y, i)
            s, own_s = part(lay, st, S, i), part(lay, st, NEXT_S, i)
            for r in range(y.shape[0]):
                size = row[group + r] if kind == LINEAR else row[group]
                own_y[r], own_s[r] = y[r] * size / omega, s[r] / (size * beta)


@inner
def start_from_kept(lay, st):  # type: ignore[no-untyped-def]
    """Put the kept iterate, moved inwards, in the place of the usual starting point (which has been set)."""
    keep_apart()
    number = numbers(lay, st)
    beta, omega = number[BETA], number[OMEGA]
    column, row = scratch(lay, st, COLUMN, lay.at[M]), scratch(lay, st, ROW, lay.at[GROUPS])
    d, kept = scratch(lay, st, D, lay.at[M]), scratch(lay, st, NEXT_D, lay.at[M])
    for j in range(lay.at[M]):
        d[j] = kept[j] / column[j] * beta
    middle = lay.numbers.shape[0] - 2 * lay.con.shape[1] - lay.at[VECTORS]
    for i in range(lay.con.shape[1]):
        kind, group = lay.con[KIND, i], lay.con[GROUP, i]
        size = row[group]
        for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
            n = lay.blk[ORDER, b]
            of_q = omega / size if kind == LMI else size * beta
            set_inside(entries(lay, st, NEXT_Q, b), of_q, n, entries(lay, st, Q, b))
            if kind == LMI:
                set_inside(entries(lay, st, NEXT_Z, b), size * beta, n, entries(lay, st, Z, b))
        if kind == LMI:
            continue
        y, own_y = part(lay, st, Y, i), part(lay, st, NEXT_Y, i)
        s, own_s = part(lay, st, S, i), part(lay, st, NEXT_S, i)
        total, whole = 0.0, 0.0
        for r in range(y.shape[0]):
            size = row[group + r] if kind == LINEAR else row[group]
            y[r], s[r] = own_y[r] * omega / size, own_s[r] * size * beta
            if kind == SOS:
                total += y[r]
                whole += lay.numbers[middle + lay.con[VECTOR, i] + r]
        if kind == SOS:
            share = INWARDS * total / whole
            for r in range(y.shape[0]):
                y[r] += share * lay.numbers[middle + lay.con[VECTOR, i] + r]
        elif kind == NORM:
            y[0] *= 1.0 + INWARDS
            s[0] *= 1.0 + INWARDS
        else:
            move_rows_inwards(y)
            move_rows_inwards(s)
    moments(lay, st, Y, Z)


@inner
def set_inside(kept, scale, n, out):  # type: ignore[no-untyped-def]
    """Out = scale * (kept + INWARDS * mean of its diagonal * I), flat (n^2,)."""
    total = 0.0
    for k in range(n):
        total += kept[k * (n + 1)]
    for k in range(n * n):
        out[k] = scale * kept[k]
    for k in range(n):
        out[k * (n + 1)] += scale * INWARDS * total / n


@inner
def move_rows_inwards(x):  # type: ignore[no-untyped-def]
    """Add a share of their mean to positive numbers."""
    total = 0.0
    for r in range(x.shape[0]):
        total += x[r]
    for r in range(x.shape[0]):
        x[r] += INWARDS * total / x.shape[0]
