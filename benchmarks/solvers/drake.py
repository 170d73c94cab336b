"""pydrake's MathematicalProgram with its own choice of solver (Clarabel, where no licensed one is at hand).

Spheres enter as equalities with a free multiplier; monomials of the Gram basis that are others' sums on the sphere are
left out, so that the multiplier is unique.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.solvers import MathematicalProgram, Solve
from pydrake.symbolic import Expression, Monomial, Polynomial, Variables

from benchmarks.neutral import Linear, Lmi, Program, Sos, gram_bases


def _monomial(z: Any, power: Any) -> Any:
    return Monomial({z[i]: int(p) for i, p in enumerate(power) if p})


def _affine(c: float, row: Any, d: Any) -> Any:
    used = np.flatnonzero(row)
    return Expression(float(c)) + (row[used] @ d[used] if used.size else 0.0)


def _sos(prog: Any, c: Sos, d: Any) -> None:
    z = prog.NewIndeterminates(c.coordinates)
    terms = {
        _monomial(z, power): _affine(constant, row, d)
        for power, constant, row in zip(c.exponents, c.c, c.C, strict=True)
    }
    rest = Polynomial(terms)
    for kind, squares in c.boundaries:
        if kind == "sphere":
            boundary = Polynomial({_monomial(z, s): Expression(-1.0) for s in squares} | {Monomial(): Expression(1.0)})
            rest = rest - prog.NewFreePolynomial(Variables(z), c.degree - 2) * boundary
    blocks = gram_bases(c.factors, c.degree)
    for weight, basis in blocks[1:]:
        square, _ = prog.NewSosPolynomial(np.array([_monomial(z, power) for power in basis]))
        for factor in weight:
            square = square * Polynomial({_monomial(z, power): Expression(value) for power, value in factor.items()})
        rest = rest - square
    prog.AddSosConstraint(rest, np.array([_monomial(z, power) for power in blocks[0][1]]))


def prepare(program: Program) -> Any:
    """Model the program."""
    prog = MathematicalProgram()
    d = prog.NewContinuousVariables(program.size)
    for c in program.constraints:
        if isinstance(c, Sos):
            _sos(prog, c, d)
        elif isinstance(c, Lmi):
            used = [i for i in range(program.size) if np.any(c.F[i])]
            prog.AddLinearMatrixInequalityConstraint([c.F0, *c.F[used]], d[used])
        elif isinstance(c, Linear):
            prog.AddLinearConstraint(c.A, np.full(len(c.b), -np.inf), c.b, d)
        else:
            prog.AddLorentzConeConstraint(np.vstack([c.g, c.A]), np.concatenate([[c.h], c.b]), d)
    prog.AddLinearCost(program.objective, 0.0, d)
    return prog


def solve(prog: Any) -> dict[str, Any]:
    """Solve; translation for the solver is part of Drake's call, the time is the solver's own where it tells it."""
    import time

    start = time.perf_counter()
    result = Solve(prog)
    seconds = time.perf_counter() - start
    details = result.get_solver_details()
    own = getattr(details, "solve_time", None)
    return {
        "seconds": seconds if own is None else float(own),
        "objective": float(result.get_optimal_cost()) if result.is_success() else None,
        "certified": None,
        "status": "optimal" if result.is_success() else str(result.get_solution_result()).split(".")[-1],
    }
