"""From flat numbers to flat answers: starting, stopping, choosing the variant, undoing the scaling."""

from __future__ import annotations

import numpy as np

from aerotube.sos.interior import scaling, state
from aerotube.sos.interior.compiled import entry, inner, keep_apart
from aerotube.sos.interior.layout import (
    BEST_D,
    BEST_Q,
    BEST_Y,
    COLUMN,
    FIRST,
    GROUP,
    GROUPS,
    KIND,
    LAST,
    LINEAR,
    LMI,
    MATRICES,
    MATRIX,
    ROW,
    ROWS,
    SURE_D,
    SURE_Q,
    SURE_Y,
    VECTOR,
    D,
    M,
    Q,
    Y,
    entries,
    part,
)  # fmt: skip
from aerotube.sos.interior.measure import ACCEPTED, CERTIFIED, RAY_ACCEPTED, ray
from aerotube.sos.interior.method import advance, complete, ready
from aerotube.sos.interior.schur import reduce_sampled
from aerotube.sos.interior.state import (
    BEST,
    BEST_DUAL,
    BEST_GAP,
    BEST_PRIMAL,
    BETA,
    HOMOGENEOUS,
    INFEASIBLE,
    ITERATIONS,
    NEXT,
    OMEGA,
    OPTIMAL,
    RUNNING,
    STALLED,
    STATUS,
    SURE,
    SURE_DUAL,
    SURE_GAP,
    SURE_PRIMAL,
    SURE_VALUE,
    UNBOUNDED,
    numbers,
    scratch,
)  # fmt: skip
from aerotube.sos.interior.warm import NONE, OTHERS, start_from_kept

NUMBERS = 8
"""Length of the head of an answer: primal and dual residual, gap, status, iterations."""
DIRECT, EMBEDDED = np.arange(2)
WARM_MOST = 30
"""Iterations after which a warm start is given up."""


@entry
def begin(lay, st, flat, warm):  # type: ignore[no-untyped-def]
    """Load a program and set its starting point; True if that is on the way of the program before, as warm asks for."""
    scaling.unpack(lay, st, flat)
    number = numbers(lay, st)
    number[BEST] = number[BEST_PRIMAL] = number[BEST_DUAL] = number[BEST_GAP] = np.inf
    number[SURE] = number[SURE_VALUE] = np.inf
    state.start(lay, st, DIRECT)
    kept = warm and st.ints[NEXT] != NONE
    if kept:
        start_from_kept(lay, st)
    st.ints[NEXT] = OTHERS if kept else NONE
    return kept


@entry
def proceed(lay, st, feasibility, optimality, limit, budget):  # type: ignore[no-untyped-def]
    """Take at most `budget` iterations; True if there is nothing left to do.

    A variant that stalls, or that has not ended after `limit` iterations, gives way to the self-dual embedding.
    """
    advance(lay, st, feasibility, optimality, min(budget, limit - st.ints[ITERATIONS]))
    return settled(lay, st, limit)


@entry
def open_step(lay, st, feasibility, optimality):  # type: ignore[no-untyped-def]
    """First third of an iteration: True if the sampled constraints are to be reduced, with `reduce_one`."""
    return ready(lay, st, feasibility, optimality)


@entry
def reduce_one(lay, st, i, room):  # type: ignore[no-untyped-def]
    """Second third: one sampled constraint, at the same time as others; room is scratch of Layout.at[SPACE] numbers."""
    reduce_sampled(lay, st, i, room)


@entry
def close_step(lay, st, optimality, limit):  # type: ignore[no-untyped-def]
    """Last third, left out where there was nothing to reduce; True if there is nothing left to do, as `proceed`."""
    if st.ints[STATUS] == RUNNING:
        complete(lay, st, optimality)
    return settled(lay, st, limit)


@entry
def astray(lay, st, warm, done):  # type: ignore[no-untyped-def]
    """Whether a warm start has led, or leads, anywhere but to an optimum."""
    return warm and (st.ints[HOMOGENEOUS] == 1 or (done and st.ints[STATUS] != OPTIMAL))


@inner
def settled(lay, st, limit):  # type: ignore[no-untyped-def]
    """Whether there is nothing left to do; the variants give way to one another here."""
    keep_apart()
    number, status = numbers(lay, st), st.ints[STATUS]
    if status == RUNNING and st.ints[ITERATIONS] < limit:
        return False
    if status in (OPTIMAL, INFEASIBLE, UNBOUNDED):
        return True
    found = ray(lay, st, RAY_ACCEPTED)
    if found != RUNNING:
        st.ints[STATUS] = found
        return True
    if min(number[BEST], number[SURE]) <= ACCEPTED:
        st.ints[STATUS] = OPTIMAL
        return True
    if st.ints[HOMOGENEOUS] == 1 or has_logdet(lay):
        st.ints[STATUS] = STALLED
        return True
    used = st.ints[ITERATIONS]
    state.start(lay, st, EMBEDDED)
    # The embedding has as many iterations again.
    st.ints[ITERATIONS] = max(0, used - limit)
    return False


@inner
def has_logdet(lay):  # type: ignore[no-untyped-def]
    """Whether the program has log-determinant terms, which the embedding does not have."""
    count = lay.con.shape[1]
    total = 0.0
    for i in range(count):
        total += lay.numbers[lay.numbers.shape[0] - count + i]
    return total > 0.0


@entry
def finish(lay, st, out):  # type: ignore[no-untyped-def]
    """Write the answer in the program's own units: the head, then d, the matrices, and the vectors."""
    m, number = lay.at[M], numbers(lay, st)
    status = st.ints[STATUS]
    out[3], out[4] = status, st.ints[ITERATIONS]
    from_d, from_q, from_y = BEST_D, BEST_Q, BEST_Y
    out[0], out[1], out[2] = number[BEST_PRIMAL], number[BEST_DUAL], number[BEST_GAP]
    if status in (INFEASIBLE, UNBOUNDED):
        from_d, from_q, from_y = D, Q, Y
    elif number[SURE] < (CERTIFIED if status == OPTIMAL else np.inf):
        # What can be certified goes before what is nearer to the optimum and cannot.
        from_d, from_q, from_y = SURE_D, SURE_Q, SURE_Y
        out[0], out[1], out[2] = number[SURE_PRIMAL], number[SURE_DUAL], number[SURE_GAP]
    d = scratch(lay, st, from_d, m)
    column = scratch(lay, st, COLUMN, m)
    row = scratch(lay, st, ROW, lay.at[GROUPS])
    beta, omega = number[BETA], number[OMEGA]
    for j in range(m):
        out[NUMBERS + j] = d[j] * column[j] / beta
    matrices, vectors = NUMBERS + m, NUMBERS + m + lay.at[MATRICES]
    for i in range(lay.con.shape[1]):
        kind, group = lay.con[KIND, i], lay.con[GROUP, i]
        for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
            source = entries(lay, st, from_q, b)
            scale = row[group] / omega if kind == LMI else 1.0 / (row[group] * beta)
            for k in range(source.shape[0]):
                out[matrices + lay.blk[MATRIX, b] + k] = source[k] * scale
        if kind != LMI:
            source = part(lay, st, from_y, i)
            for r in range(lay.con[ROWS, i]):
                own = row[group + r] if kind == LINEAR else row[group]
                out[vectors + lay.con[VECTOR, i] + r] = source[r] * own / omega


@entry
def through(lay, st, flat, warm, feasibility, optimality, limit, out):  # type: ignore[no-untyped-def]
    """Solve a program from the beginning to the end, in one call: calls from the interpreter cost more than they do."""
    warm = begin(lay, st, flat, warm)
    while True:
        most = min(WARM_MOST, limit) if warm else limit
        done = proceed(lay, st, feasibility, optimality, most, most)
        if astray(lay, st, warm, done):
            warm = begin(lay, st, flat, False)
        elif done:
            break
    finish(lay, st, out)
