"""Residuals, objectives and rays of an iterate, and what they say."""

from __future__ import annotations

import numpy as np

from aerotube.sos.interior import blas, blocks, small
from aerotube.sos.interior.compiled import inner, keep_apart
from aerotube.sos.interior.layout import (
    BEST_D,
    BEST_Q,
    BEST_Y,
    DEGREE,
    FIRST,
    FOLD,
    KIND,
    LAST,
    LINEAR,
    LMI,
    LQ,
    LZ,
    MATRICES,
    MISFIT,
    NORM,
    OBJECTIVE,
    ORDER,
    RD,
    RESIDUAL,
    RHS,
    ROWS,
    SCRATCH,
    SOS,
    SURE_D,
    SURE_Q,
    SURE_Y,
    TARGET,
    VECTORS,
    WIDEQ,
    D,
    G,
    M,
    Q,
    S,
    Y,
    Z,
    block,
    compact,
    decision,
    entries,
    matrix_at,
    part,
    turned_of,
    weights_of,
    wide_of,
)  # fmt: skip
from aerotube.sos.interior.state import (
    BEST,
    BEST_DUAL,
    BEST_GAP,
    BEST_PRIMAL,
    BETA_OMEGA,
    DUAL,
    DUAL_RAY,
    DVALUE,
    EXTRA,
    GAP,
    GAP_RESIDUAL,
    HOMOGENEOUS,
    INFEASIBLE,
    KAPPA,
    MU,
    OPTIMAL,
    PRIMAL,
    PRIMAL_RAY,
    PVALUE,
    RUNNING,
    SURE,
    SURE_DUAL,
    SURE_GAP,
    SURE_PRIMAL,
    SURE_VALUE,
    TAU,
    UNBOUNDED,
    add_adjoint,
    numbers,
    scratch,
    values,
)  # fmt: skip

SURE_BELOW, EXTRA_FEW, EXTRA_MOST = 0.5, 2, 8
ACCEPTED, CERTIFIED = 3.0, 10.0
"""Within the first factor of the tolerances an iterate is as good as an optimum, if it can be certified or nothing
better can be had; within the second, one that can be certified goes before an optimum that cannot."""
UNIT, ROUNDING = 1.1e-16, 5e-16
"""Of one operation, and of values at the nodes, relative to the size of a constraint."""
RAY_TOLERANCE = 1e-12
RAY_ACCEPTED = 1e-9
"""Error of a ray that is one if it gets no better."""


@inner
def sampled_residual(lay, st, i, residual):  # type: ignore[no-untyped-def]
    """Subtract A(Q) from the values of a sampled constraint; leaves (P L_Q)' for the Schur complement."""
    keep_apart()
    for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
        wide = wide_of(lay, st, WIDEQ, b)
        blas.multiply_first_transposed(block(lay, st, LQ, b), turned_of(lay, b), wide)
        blocks.add_products(wide, wide, weights_of(lay, b), -1.0, residual)


@inner
def log_terms(lay, st, i, goal):  # type: ignore[no-untyped-def]
    """A log-determinant term's share of the duality gap: goal (log det Z + log det Q + k - k log goal)."""
    keep_apart()
    b = lay.con[FIRST, i]
    left, right = block(lay, st, LZ, b), block(lay, st, LQ, b)
    total = left.shape[0] * (1.0 - np.log(goal))
    for k in range(left.shape[0]):
        total += 2.0 * (np.log(left[k, k]) + np.log(right[k, k]))
    return goal * total


@inner
def measure(lay, st):  # type: ignore[no-untyped-def]
    """Residuals, objectives, complementarity and the quality of the iterate as a ray."""
    keep_apart()
    number, m = numbers(lay, st), lay.at[M]
    tau = number[TAU]
    rhs = decision(lay, st, RHS)
    rhs[:] = 0.0
    worst, ray, inner, logs = 0.0, 0.0, 0.0, 0.0
    for i in range(lay.con.shape[1]):
        kind = lay.con[KIND, i]
        if kind == LMI:
            b = lay.con[FIRST, i]
            residual, multiplier = entries(lay, st, MISFIT, b), entries(lay, st, Q, b)
            values(lay, st, D, tau, i, residual)
            small.add(residual, -1.0, entries(lay, st, Z, b))
            product = small.dot(multiplier, entries(lay, st, Z, b))
            goal = lay.numbers[lay.con[TARGET, i]] * number[BETA_OMEGA]
            if goal > 0.0:
                logs += log_terms(lay, st, i, goal)
                product = abs(product - goal * lay.con[ROWS, i])
            inner += product
        else:
            residual, multiplier = part(lay, st, RESIDUAL, i), part(lay, st, Y, i)
            values(lay, st, D, tau, i, residual)
            if kind == SOS:
                sampled_residual(lay, st, i, residual)
                for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
                    inner += small.dot(entries(lay, st, Q, b), entries(lay, st, Z, b))
            else:
                small.add(residual, -1.0, part(lay, st, S, i))
                inner += small.dot(part(lay, st, S, i), multiplier)
        if kind == LMI:
            largest, away = row_excess(residual, compact(lay, st, G, i), tau)
        else:
            largest, away = vector_excess(residual, compact(lay, st, G, i), tau)
        worst, ray = max(worst, largest), max(ray, away)
        add_adjoint(lay, st, G, i, multiplier, rhs)
    rd, objective, d = decision(lay, st, RD), decision(lay, st, OBJECTIVE), decision(lay, st, D)
    dual, dual_ray, slope = 0.0, 0.0, 0.0
    for j in range(m):
        rd[j] = tau * objective[j] - rhs[j]
        dual = max(dual, abs(rd[j]))
        dual_ray = max(dual_ray, abs(rhs[j]))
        slope += objective[j] * d[j]
    number[GAP_RESIDUAL] = -slope - rhs[m] - number[KAPPA]
    number[PVALUE], number[DVALUE] = slope / tau, -rhs[m] / tau + logs
    number[MU] = (inner + tau * number[KAPPA]) / (lay.at[DEGREE] + st.ints[HOMOGENEOUS])
    number[PRIMAL], number[DUAL] = worst / tau, dual / tau
    number[GAP] = abs(number[PVALUE] - number[DVALUE]) / max(abs(slope / tau), abs(rhs[m] / tau), 1e-3)
    number[DUAL_RAY] = dual_ray / -rhs[m] if rhs[m] < 0.0 else np.inf
    number[PRIMAL_RAY] = ray / -slope if slope < 0.0 else np.inf


@inner
def vector_excess(x, data, tau):  # type: ignore[no-untyped-def]
    """Largest |x|, and largest |x - tau * constant| with the constants in the last column of the data."""
    plain, ray, last = 0.0, 0.0, data.shape[1] - 1
    for r in range(x.shape[0]):
        plain, ray = max(plain, abs(x[r])), max(ray, abs(x[r] - tau * data[r, last]))
    return plain, ray


@inner
def row_excess(x, data, tau):  # type: ignore[no-untyped-def]
    """The same with the constants in the last row of the data."""
    plain, ray, last = 0.0, 0.0, data.shape[0] - 1
    for r in range(x.shape[0]):
        plain, ray = max(plain, abs(x[r])), max(ray, abs(x[r] - tau * data[last, r]))
    return plain, ray


@inner
def ray(lay, st, tolerance):  # type: ignore[no-untyped-def]
    """INFEASIBLE or UNBOUNDED if the iterate is a ray that says so, else RUNNING."""
    number = numbers(lay, st)
    if number[DUAL_RAY] < tolerance:
        return INFEASIBLE
    if number[PRIMAL_RAY] < tolerance:
        return UNBOUNDED
    return RUNNING


@inner
def judge(lay, st, feasibility, optimality):  # type: ignore[no-untyped-def]
    """Status after `measure`; keeps the best iterate seen."""
    keep_apart()
    number = numbers(lay, st)
    found = ray(lay, st, RAY_TOLERANCE)
    if found != RUNNING:
        return found
    merit = max(number[PRIMAL] / feasibility, number[DUAL] / feasibility, number[GAP] / optimality)
    scale = 1.0 / number[TAU]
    if merit < number[BEST]:
        number[BEST] = merit
        number[BEST_PRIMAL], number[BEST_DUAL], number[BEST_GAP] = number[PRIMAL], number[DUAL], number[GAP]
        keep(scratch(lay, st, D, lay.at[M]), scale, scratch(lay, st, BEST_D, lay.at[M]))
        keep(scratch(lay, st, Q, lay.at[MATRICES]), scale, scratch(lay, st, BEST_Q, lay.at[MATRICES]))
        keep(scratch(lay, st, Y, lay.at[VECTORS]), scale, scratch(lay, st, BEST_Y, lay.at[VECTORS]))
    sure = used_up(lay, st) < SURE_BELOW
    if sure and (merit <= 1.0 or number[PVALUE] < number[SURE_VALUE]):
        number[SURE], number[SURE_VALUE] = merit, number[PVALUE]
        number[SURE_PRIMAL], number[SURE_DUAL], number[SURE_GAP] = number[PRIMAL], number[DUAL], number[GAP]
        keep(scratch(lay, st, D, lay.at[M]), scale, scratch(lay, st, SURE_D, lay.at[M]))
        keep(scratch(lay, st, Q, lay.at[MATRICES]), scale, scratch(lay, st, SURE_Q, lay.at[MATRICES]))
        keep(scratch(lay, st, Y, lay.at[VECTORS]), scale, scratch(lay, st, SURE_Y, lay.at[VECTORS]))
    if merit > 1.0 and (st.ints[EXTRA] == 0 or merit > CERTIFIED):
        return RUNNING
    # An optimum that cannot be certified, nor one that is nearly as good, is given a few more steps.
    st.ints[EXTRA] += 1
    most = EXTRA_FEW if number[SURE] <= CERTIFIED else EXTRA_MOST
    return OPTIMAL if sure or number[SURE] <= ACCEPTED or st.ints[EXTRA] > most else RUNNING


@inner
def used_up(lay, st):  # type: ignore[no-untyped-def]
    """Share of the iterate's margins that its residuals use up; below one, the iterate can be certified.

    A residual is folded into the Gram matrices by a change of least norm, which must not exceed their least eigenvalue.
    """
    keep_apart()
    worst, tau = 0.0, numbers(lay, st)[TAU]
    for i in range(lay.con.shape[1]):
        kind = lay.con[KIND, i]
        for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
            n = lay.blk[ORDER, b]
            half = matrix_at(st.heap, lay.at[SCRATCH], n, n)
            small.invert_factor(block(lay, st, LZ if kind == LMI else LQ, b), half)
            inverse = scratch(lay, st, SCRATCH, n * n)
            if kind == LMI:
                misfit = entries(lay, st, MISFIT, b)
                change = np.sqrt(small.dot(misfit, misfit))
            else:
                residual = part(lay, st, RESIDUAL, i)
                change = np.sqrt(small.dot(residual, residual)) + ROUNDING * tau * np.sqrt(residual.shape[0])
                change *= lay.numbers[lay.con[FOLD, i]]
            worst = max(worst, change * small.dot(inverse, inverse))
        if kind == NORM:
            residual, s = part(lay, st, RESIDUAL, i), part(lay, st, S, i)
            change = abs(residual[0]) + np.sqrt(small.dot(residual[1:], residual[1:]))
            # The two sides are of the size of the first, each rounded as often as there are terms.
            change += 2.0 * UNIT * (lay.at[M] + s.shape[0] + 8) * s[0]
            worst = max(worst, change / (s[0] - np.sqrt(small.dot(s[1:], s[1:]))))
        elif kind == LINEAR:
            residual, s = part(lay, st, RESIDUAL, i), part(lay, st, S, i)
            for r in range(s.shape[0]):
                worst = max(worst, -residual[r] / s[r])
        if not worst < SURE_BELOW:
            return np.inf
    return worst


@inner
def keep(source, scale, out):  # type: ignore[no-untyped-def]
    """Out = scale * source."""
    for k in range(source.shape[0]):
        out[k] = scale * source[k]
