"""How far to go along a direction, and going there."""

from __future__ import annotations

from aerotube.sos.interior import cones, small, tiles
from aerotube.sos.interior.compiled import inner, keep_apart
from aerotube.sos.interior.layout import (
    DD,
    DQ,
    DS,
    DY,
    DZ,
    FIRST,
    KEPT_DD,
    KEPT_DQ,
    KEPT_DS,
    KEPT_DY,
    KEPT_DZ,
    KIND,
    LAST,
    LINEAR,
    LMI,
    MATRICES,
    NORM,
    ORDER,
    SCRATCH,
    SOS,
    TARGET,
    VECTORS,
    D,
    M,
    Q,
    S,
    Y,
    Z,
    block,
    decision,
    entries,
    part,
)  # fmt: skip
from aerotube.sos.interior.state import BETA_OMEGA, HOMOGENEOUS, KAPPA, TAU, numbers, scratch


@inner
def longest_steps(lay, st, most, dtau, dkappa, halvings):  # type: ignore[no-untyped-def]
    """Steps (program, dual) that stay in the cones, each at most `most`; one common step if homogeneous."""
    keep_apart()
    primal, dual = most, most
    for i in range(lay.con.shape[1]):
        kind = lay.con[KIND, i]
        for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
            order = tiles.padded(lay.blk[ORDER, b])
            trial = scratch(lay, st, SCRATCH, order * (order + 1))
            of_q, of_z = (primal, dual) if kind == SOS else (dual, primal)
            of_q = tiles.longest_step(block(lay, st, Q, b), block(lay, st, DQ, b), of_q, halvings, trial)
            of_z = tiles.longest_step(block(lay, st, Z, b), block(lay, st, DZ, b), of_z, halvings, trial)
            primal, dual = (of_q, of_z) if kind == SOS else (of_z, of_q)
        if kind in (NORM, LINEAR):
            s, y, ds, dy = part(lay, st, S, i), part(lay, st, Y, i), part(lay, st, DS, i), part(lay, st, DY, i)
            if kind == NORM:
                primal = cones.longest_step(s, ds, primal)
                dual = cones.longest_step(y, dy, dual)
            else:
                for r in range(s.shape[0]):
                    if ds[r] < 0.0:
                        primal = min(primal, -s[r] / ds[r])
                    if dy[r] < 0.0:
                        dual = min(dual, -y[r] / dy[r])
    if st.ints[HOMOGENEOUS] == 1:
        number = numbers(lay, st)
        both = min(primal, dual)
        if dtau < 0.0:
            both = min(both, -number[TAU] / dtau)
        if dkappa < 0.0:
            both = min(both, -number[KAPPA] / dkappa)
        return both, both
    return primal, dual


@inner
def predicted(lay, st, primal, dual):  # type: ignore[no-untyped-def]
    """Complementarity <Q, Z> + s'y after the given steps."""
    keep_apart()
    total = 0.0
    for i in range(lay.con.shape[1]):
        kind = lay.con[KIND, i]
        of_q, of_z = (primal, dual) if kind == SOS else (dual, primal)
        for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
            q, z, dq, dz = (
                entries(lay, st, Q, b), entries(lay, st, Z, b), entries(lay, st, DQ, b), entries(lay, st, DZ, b),
            )  # fmt: skip
            inner = 0.0
            for k in range(q.shape[0]):
                inner += (q[k] + of_q * dq[k]) * (z[k] + of_z * dz[k])
            total += abs(inner - lay.blk[ORDER, b] * lay.numbers[lay.con[TARGET, i]] * numbers(lay, st)[BETA_OMEGA])
        if kind in (NORM, LINEAR):
            s, y, ds, dy = part(lay, st, S, i), part(lay, st, Y, i), part(lay, st, DS, i), part(lay, st, DY, i)
            for r in range(s.shape[0]):
                total += (s[r] + primal * ds[r]) * (y[r] + dual * dy[r])
    return total


@inner
def move(lay, st, primal, dual, dtau, dkappa):  # type: ignore[no-untyped-def]
    """Take the step."""
    keep_apart()
    d, dd = decision(lay, st, D), decision(lay, st, DD)
    for j in range(lay.at[M]):
        d[j] += primal * dd[j]
    for i in range(lay.con.shape[1]):
        kind = lay.con[KIND, i]
        of_q, of_z = (primal, dual) if kind == SOS else (dual, primal)
        for b in range(lay.con[FIRST, i], lay.con[LAST, i]):
            small.add(entries(lay, st, Q, b), of_q, entries(lay, st, DQ, b))
            small.add(entries(lay, st, Z, b), of_z, entries(lay, st, DZ, b))
        if kind != LMI:
            small.add(part(lay, st, Y, i), dual, part(lay, st, DY, i))
            if kind != SOS:
                small.add(part(lay, st, S, i), primal, part(lay, st, DS, i))
    number = numbers(lay, st)
    number[TAU] += primal * dtau
    number[KAPPA] += primal * dkappa


@inner
def swap_direction(lay, st, back):  # type: ignore[no-untyped-def]
    """Keep a copy of the direction, or bring the copy back."""
    keep_apart()
    for name, kept, size in (
        (DQ, KEPT_DQ, lay.at[MATRICES]), (DZ, KEPT_DZ, lay.at[MATRICES]), (DY, KEPT_DY, lay.at[VECTORS]),
        (DS, KEPT_DS, lay.at[VECTORS]), (DD, KEPT_DD, lay.at[M]),
    ):  # fmt: skip
        source, out = (kept, name) if back == 1 else (name, kept)
        small.copy(scratch(lay, st, source, size), scratch(lay, st, out, size))
