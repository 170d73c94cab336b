"""Residuals, objectives and rays of an iterate, and what they say."""

from __future__ import annotations

import numpy as np

from aerotube.sos.interior import blas, small
from aerotube.sos.interior.compiled import inner, keep_apart
from aerotube.sos.interior.layout import (
    BEST_D,
    BEST_Q,
    BEST_Y,
    DEGREE,
    FIRST,
    KIND,
    LAST,
    LMI,
    LQ,
    LZ,
    MATRICES,
    MISFIT,
    OBJECTIVE,
    RD,
    RESIDUAL,
    RHS,
    ROWS,
    SOS,
    TALLQ,
    TARGET,
    VECTORS,
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
    part,
    rows_of,
    tall_of,
    weights_of,
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
    TAU,
    UNBOUNDED,
    add_adjoint,
    numbers,
    scratch,
    values,
)  # fmt: skip

RAY_TOLERANCE = 1e-12
RAY_ACCEPTED = 1e-9
"""Error of a ray that is one if it gets no better."""


@inner
def sampled_residual(lay, st, i, residual):  # type: ignore[no-untyped-def]
    """Subtract A(Q) from the values of a sampled constraint; leaves P L_Q for the Schur complement."""
    keep_apart()
    for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
        pq, weights = tall_of(lay, st, TALLQ, b), weights_of(lay, b)
        blas.multiply(rows_of(lay, b), block(lay, st, LQ, b), pq)
        for u in range(pq.shape[0]):
            total = 0.0
            for k in range(pq.shape[1]):
                total += pq[u, k] * pq[u, k]
            residual[u] -= total if weights.shape[0] == 0 else weights[u] * total


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
            largest, away = lmi_excess(residual, compact(lay, st, G, i), tau)
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
def lmi_excess(x, data, tau):  # type: ignore[no-untyped-def]
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
    if merit < number[BEST]:
        number[BEST] = merit
        number[BEST_PRIMAL], number[BEST_DUAL], number[BEST_GAP] = number[PRIMAL], number[DUAL], number[GAP]
        scale = 1.0 / number[TAU]
        keep(scratch(lay, st, D, lay.at[M]), scale, scratch(lay, st, BEST_D, lay.at[M]))
        keep(scratch(lay, st, Q, lay.at[MATRICES]), scale, scratch(lay, st, BEST_Q, lay.at[MATRICES]))
        keep(scratch(lay, st, Y, lay.at[VECTORS]), scale, scratch(lay, st, BEST_Y, lay.at[VECTORS]))
    return OPTIMAL if merit <= 1.0 else RUNNING


@inner
def keep(source, scale, out):  # type: ignore[no-untyped-def]
    """Out = scale * source."""
    for k in range(source.shape[0]):
        out[k] = scale * source[k]
