"""Scaling the numbers of a program and packing them without the decision variables that a constraint does not hold.

Row scales e (one for each constraint, one for each linear row), column scales D (one for each decision variable) and
two overall scales, beta of the constants and omega of the objective, bring all coefficients near one:

    c -> e beta c,   C -> e C D,   q -> omega D q,   d -> d beta / D,   Q -> e beta Q,   y -> omega y / e.
"""

from __future__ import annotations

import numpy as np

from aerotube.sos.interior.compiled import entry, inner, keep_apart
from aerotube.sos.interior.layout import (
    COLUMN,
    DD,
    EXTENT,
    FLAT,
    GROUP,
    GROUPS,
    KIND,
    LINEAR,
    LMI,
    NORM,
    NUMBER,
    OBJECTIVE,
    RHS,
    ROW,
    ROWS,
    SOS,
    G,
    M,
    V,
    active,
    compact,
    decision,
    matrix_at,
)  # fmt: skip

SWEEPS = 6
NOTHING = 1e-9
"""Constants this small beside the largest are taken for rounding."""
ABSENT = -1e4
"""Stands for the logarithm of nothing: below that of any number."""
BETA, OMEGA = 9, 10
"""Places of the overall scales among the numbers of a state."""


@inner
def _places(kind, rows, m, r):  # type: ignore[no-untyped-def]
    """Where row r of a constraint has its coefficients and its constant."""
    if kind == SOS:
        return rows + r * m, r
    if kind == NORM:
        k = rows - 1
        return (k * m + k, k * m + k + m) if r == 0 else ((r - 1) * m, k * m + r - 1)
    return r * m, rows * m + r


@inner
def _measure(lay, extent, flat):  # type: ignore[no-untyped-def]
    """Largest magnitude of each variable's coefficients in each group of rows."""
    keep_apart()
    m = lay.at[M]
    extent[:] = 0.0
    for i in range(lay.con.shape[1]):
        rows, group, kind = lay.con[ROWS, i], lay.con[GROUP, i], lay.con[KIND, i]
        own = flat[lay.con[FLAT, i] :]
        if kind == LMI:
            square = rows * rows
            for j in range(m + 1):
                first = 0 if j == m else (j + 1) * square
                for k in range(first, first + square):
                    extent[group, j] = max(extent[group, j], abs(own[k]))
            continue
        for r in range(rows):
            line = extent[group + r if kind == LINEAR else group]
            start, constant = _places(kind, rows, m, r)
            for j in range(m):
                line[j] = max(line[j], abs(own[start + j]))
            line[m] = max(line[m], abs(own[constant]))


@inner
def _power(x):  # type: ignore[no-untyped-def]
    """Return the power of two nearest to 1 / x, or 1 for x = 0."""
    return 2.0 ** -np.round(np.log2(x)) if x > 0.0 else 1.0


@inner
def _balance(extent, logs, row, column, total, count):  # type: ignore[no-untyped-def]
    """Choose row and column scales by a few sweeps over the table of magnitudes.

    The sweeps make the mean logarithm of every row and column zero, which minimises the sum of squared logarithms
    (A. R. Curtis and J. K. Reid, "On the automatic scaling of matrices for Gaussian elimination", 1972). logs is
    scratch of the table's shape, total and count of the columns'.
    """
    keep_apart()
    groups, m = extent.shape[0], extent.shape[1] - 1
    for g in range(groups):
        for j in range(m):
            logs[g, j] = np.log2(extent[g, j]) if extent[g, j] > 0.0 else ABSENT
    column[:] = 0.0
    row[:] = 0.0
    for _ in range(SWEEPS):
        total[:] = 0.0
        count[:] = 0.0
        for g in range(groups):
            own, number = 0.0, 0.0
            for j in range(m):
                held = 1.0 if logs[g, j] > ABSENT else 0.0
                own += held * (logs[g, j] + column[j])
                number += held
            row[g] = -own / number if number > 0.0 else 0.0
            for j in range(m):
                held = 1.0 if logs[g, j] > ABSENT else 0.0
                total[j] += held * (logs[g, j] + row[g])
                count[j] += held
        for j in range(m):
            column[j] = -total[j] / count[j] if count[j] > 0.0 else 0.0
    for j in range(m):
        column[j] = 2.0 ** np.round(column[j])
    for g in range(groups):
        top = 0.0
        for j in range(m):
            top = max(top, extent[g, j] * column[j])
        row[g] = _power(top if top > 0.0 else extent[g, m])


@inner
def _settle(extent, row, column):  # type: ignore[no-untyped-def]
    """Bring every constraint to its own size and every decision to its reach, both near one.

    A constraint is as large as its constants. A decision reaches no further than the constants of the constraints that
    hold it let it, one by one; a constraint without constants is as large as its decisions can make it.
    """
    keep_apart()
    groups, m = extent.shape[0], extent.shape[1] - 1
    top = 0.0
    for g in range(groups):
        top = max(top, extent[g, m] * row[g])
    least = NOTHING * top if top > 0.0 else 1.0
    for j in range(m):
        reach = np.inf
        for g in range(groups):
            size, own = extent[g, m] * row[g], extent[g, j] * row[g] * column[j]
            if own > 0.0 and size > least:
                reach = min(reach, size / own)
        if reach < np.inf:
            column[j] /= _power(max(reach, least))
        elif top > 0.0:
            column[j] /= _power(top)
    for g in range(groups):
        size = extent[g, m] * row[g]
        if not size > least:
            size = 0.0
            for j in range(m):
                size = max(size, extent[g, j] * row[g] * column[j])
        if size > 0.0:
            row[g] *= _power(size)


@entry
def unpack(lay, st, flat):  # type: ignore[no-untyped-def]
    """Scale the numbers of one program and pack them.

    Matrices as rows of G (width, entries), the constants last; everything else as columns.
    """
    m = lay.at[M]
    objective, column = decision(lay, st, OBJECTIVE), decision(lay, st, COLUMN)
    extent = matrix_at(st.heap, lay.at[EXTENT], lay.at[GROUPS], m + 1)
    row = st.heap[lay.at[ROW] : lay.at[ROW] + lay.at[GROUPS]]
    number = st.heap[lay.at[NUMBER] : lay.at[NUMBER] + 24]
    _measure(lay, extent, flat)
    # V is as large as the table at least, and not in use yet; nor are the decision storages of the directions.
    logs = matrix_at(st.heap, lay.at[V], lay.at[GROUPS], m + 1)
    _balance(extent, logs, row, column, decision(lay, st, DD), decision(lay, st, RHS))
    _settle(extent, row, column)
    slope = 0.0
    for j in range(m):
        slope = max(slope, abs(flat[j]) * column[j])
    number[BETA], number[OMEGA] = 1.0, _power(slope)
    column[m] = number[BETA]
    for j in range(m):
        objective[j] = flat[j] * column[j] * number[OMEGA]
    for i in range(lay.con.shape[1]):
        rows, group, kind = lay.con[ROWS, i], lay.con[GROUP, i], lay.con[KIND, i]
        st.ints[8 + i] = m + 1
        columns = active(lay, st, i)
        width = 0
        for j in range(m):
            used = False
            for g in range(rows if kind == LINEAR else 1):
                used = used or extent[group + g, j] > 0.0
            if used:
                columns[width] = j
                width += 1
        columns[width] = m
        st.ints[8 + i] = width + 1
        _pack(
            kind, rows, m, flat[lay.con[FLAT, i] :], columns[: width + 1], column, row[group:], compact(lay, st, G, i)
        )


@inner
def _pack(kind, rows, m, flat, columns, column, row, out):  # type: ignore[no-untyped-def]
    keep_apart()
    width = columns.shape[0] - 1
    if kind == LMI:
        for a in range(width + 1):
            j = columns[a]
            first = 0 if j == m else (j + 1) * rows * rows
            for r in range(rows):
                for c in range(rows):
                    # Symmetrised: only the symmetric part enters the inequality.
                    both = flat[first + r * rows + c] + flat[first + c * rows + r]
                    out[a, r * rows + c] = 0.5 * both * column[j] * row[0]
        return
    # With the sign of `value >= 0`: linear constraints are given as A d <= b.
    sign = -1.0 if kind == LINEAR else 1.0
    for r in range(rows):
        own = row[r] if kind == LINEAR else row[0]
        start, constant = _places(kind, rows, m, r)
        for a in range(width):
            out[r, a] = sign * flat[start + columns[a]] * column[columns[a]] * own
        out[r, width] = flat[constant] * column[m] * own
