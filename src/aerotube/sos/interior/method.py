"""The interior-point method.

In scaled data the program and its dual are, with the homogenising variables tau and kappa,

    c tau + C d = A(Q)              for each sampled sum of squares, A(Q)_u = sum_k g_k p_k' Q_k p_k
    F0 tau + F(d) = Z               for each matrix inequality
    h tau + G d = s                 for each cone
    q tau = C'y + F*(Q) + G'z       one equation for each decision variable
    0 = q'd + c'y + <F0, Q> + h'z + kappa

Two variants share every line: tau = 1, kappa = 0 and separate steps for the unknowns of the program and of its dual
(faster, and the first choice), and the self-dual embedding with one common step (slower, but it ends in a certificate
where there is no optimum). Eliminating everything but d leaves a system of the order of the decision vector, to which
constraint i adds V_i' V_i: V = R'^-1 C with R'R a sampled constraint's Schur complement, V = W^-1 G for a cone, and
V_j = W F_j W' for a matrix inequality, with the scalings W of Nesterov and Todd. The constants c, F0, h ride along as
one more column.
Source: Mehrotra's predictor-corrector method, as in M. J. Todd, K. C. Toh, R. H. Tutuncu, "On the Nesterov-Todd
direction in semidefinite programming", SIAM J. Optim. 8 (1998), and Y. Ye, M. J. Todd, S. Mizuno (1994).
"""

from __future__ import annotations

import numpy as np

from aerotube.sos.interior.compiled import inner, keep_apart
from aerotube.sos.interior.direction import direction, refine
from aerotube.sos.interior.layout import DEGREE
from aerotube.sos.interior.measure import judge, measure
from aerotube.sos.interior.schur import assemble, reduce_all
from aerotube.sos.interior.state import (
    EXTRA,
    GAP,
    HOMOGENEOUS,
    ITERATIONS,
    KAPPA,
    MU,
    RUNNING,
    STALLED,
    STALLS,
    STATUS,
    STEP,
    TAU,
    factor_blocks,
    numbers,
)  # fmt: skip
from aerotube.sos.interior.step import longest_steps, move, predicted, swap_direction
from aerotube.sos.interior.warm import keep_for_next

REACH = 0.99
AIMS = np.array([0.3, 2.0, 6.0])
"""Gaps to aim at, over what is asked for, from an optimum that cannot be certified."""
REFINE_BELOW = 1e-5
COARSE, FINE, CORRECTORS = np.array([6, 8, 2])
NO, YES = np.arange(2)


@inner
def center(lay, st, primal, dual, optimality):  # type: ignore[no-untyped-def]
    """Share of the complementarity to aim at, from the steps that the predictor could take.

    Not far below what is asked for: there the iterates lose the margins that certify them. From an optimum that cannot
    be certified the way is back, to where margins are wider and the gap is still accepted.
    """
    keep_apart()
    if st.ints[EXTRA] > 0:
        return AIMS[min(st.ints[EXTRA] - 1, 2)] * optimality / numbers(lay, st)[GAP]
    if st.ints[HOMOGENEOUS] == 1:
        sigma = (1.0 - primal) ** 3
    else:
        sigma = (predicted(lay, st, primal, dual) / (numbers(lay, st)[MU] * lay.at[DEGREE])) ** 3
    return min(1.0, max(1e-6, sigma, 0.3 * optimality / numbers(lay, st)[GAP]))


@inner
def iterate(lay, st, optimality):  # type: ignore[no-untyped-def]
    """One predictor-corrector step from a measured and factored iterate; False if it could not be taken.

    Further correctors follow unless they shorten the step: they leave the next iterate better centred, and each costs
    a fraction of a factorisation.
    """
    keep_apart()
    number, homogeneous = numbers(lay, st), st.ints[HOMOGENEOUS] == 1
    tau, kappa, mu = number[TAU], number[KAPPA], number[MU]
    dtau = direction(lay, st, 0.0, 1.0, NO, -tau * kappa)
    dkappa = (-tau * kappa - kappa * dtau) / tau if homogeneous else 0.0
    primal, dual = longest_steps(lay, st, 1.0, dtau, dkappa, COARSE)
    sigma = center(lay, st, primal, dual, optimality)
    eta = 1.0 - sigma if homogeneous else 1.0
    best_primal, best_dual, best_tau, best_kappa = 0.0, 0.0, 0.0, 0.0
    for k in range(CORRECTORS + 1):
        side = sigma * mu - tau * kappa - dtau * dkappa
        dtau = direction(lay, st, sigma * mu, eta, YES, side)
        dkappa = (side - kappa * dtau) / tau if homogeneous else 0.0
        if mu < REFINE_BELOW:
            refine(lay, st, dtau, eta)
        primal, dual = longest_steps(lay, st, 1.0 / REACH, dtau, dkappa, FINE if k == CORRECTORS else COARSE)
        if k > 0 and not min(primal, dual) >= 0.9 * min(best_primal, best_dual):
            swap_direction(lay, st, YES)
            best_primal, best_dual = longest_steps(lay, st, 1.0 / REACH, best_tau, best_kappa, FINE)
            break
        best_primal, best_dual, best_tau, best_kappa = primal, dual, dtau, dkappa
        if k < CORRECTORS:
            swap_direction(lay, st, NO)
    # Short steps are signs of bad centring: they keep further from the boundary.
    reach = REACH - 0.09 * (1.0 - min(1.0, best_primal, best_dual))
    primal, dual = min(1.0, reach * best_primal), min(1.0, reach * best_dual)
    number[STEP] = min(primal, dual)
    st.ints[ITERATIONS] += 1
    st.ints[STALLS] = st.ints[STALLS] + 1 if number[STEP] < 1e-3 else 0
    if st.ints[STALLS] >= 3 or not np.isfinite(primal + dual + best_tau):
        return False
    move(lay, st, primal, dual, best_tau, best_kappa)
    return True


@inner
def ready(lay, st, feasibility, optimality):  # type: ignore[no-untyped-def]
    """Factor, measure and judge the iterate; True if there is a step to be taken."""
    keep_apart()
    if not factor_blocks(lay, st):
        st.ints[STATUS] = STALLED
        return False
    measure(lay, st)
    st.ints[STATUS] = judge(lay, st, feasibility, optimality)
    keep_for_next(lay, st)
    return st.ints[STATUS] == RUNNING


@inner
def complete(lay, st, optimality):  # type: ignore[no-untyped-def]
    """Take the step, once the sampled constraints have been reduced."""
    keep_apart()
    if not assemble(lay, st) or not iterate(lay, st, optimality):
        st.ints[STATUS] = STALLED


@inner
def advance(lay, st, feasibility, optimality, budget):  # type: ignore[no-untyped-def]
    """Iterate at most `budget` times, or until the status is no longer RUNNING; return the status."""
    keep_apart()
    for _ in range(budget):
        if not ready(lay, st, feasibility, optimality):
            break
        reduce_all(lay, st)
        complete(lay, st, optimality)
        if st.ints[STATUS] != RUNNING:
            break
    return st.ints[STATUS]
