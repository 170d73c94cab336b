"""SumOfSquares.py: SymPy polynomials, PICOS, and the conic solver that PICOS finds (CVXOPT).

Spheres enter as equalities with a free multiplier, as in the package's own `poly_opt_prob`.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import picos
import sympy as sp
from SumOfSquares import SOSProblem, poly_variable

from benchmarks.neutral import Linear, Lmi, Program, Sos, gram_bases


def _term(z: list[Any], power: Any) -> Any:
    return sp.Mul(*(symbol ** int(p) for symbol, p in zip(z, power, strict=True)))


def _sos(problem: Any, c: Sos, symbols: list[Any]) -> None:
    z = list(sp.symbols(f"z:{c.coordinates}"))
    rest: Any = sp.Add(
        *(
            (constant + sp.Add(*(row[i] * symbols[i] for i in np.flatnonzero(row)))) * _term(z, power)
            for power, constant, row in zip(c.exponents, c.c, c.C, strict=True)
        )
    )
    spheres = [squares for kind, squares in c.boundaries if kind == "sphere"]
    for i, squares in enumerate(spheres):
        free = poly_variable(f"free_{c.name}_{i}", z, c.degree - 2)
        rest -= free * (1 - sp.Add(*(_term(z, square) for square in squares)))
    for i, (weight, basis) in enumerate(gram_bases(c.factors, c.degree)[1:]):
        square = poly_variable(f"square_{c.name}_{i}", z, 2 * int(basis.sum(axis=1).max()))
        problem.add_sos_constraint(square, z)
        for factor in weight:
            square = square * sp.Add(*(value * _term(z, power) for power, value in factor.items()))
        rest -= square
    # Much faster after expansion, says the package's own source.
    problem.add_sos_constraint(sp.expand(rest), z)


def prepare(program: Program) -> Any:
    """Model the program."""
    problem = SOSProblem()
    symbols = list(sp.symbols(f"d:{program.size}"))
    d = [problem.sym_to_var(symbol) for symbol in symbols]

    def combine(matrix: Any) -> Any:
        used = [i for i in range(program.size) if np.any(matrix[i])]
        return picos.sum([picos.Constant(matrix[i]) * d[i] for i in used])

    for c in program.constraints:
        if isinstance(c, Sos):
            _sos(problem, c, symbols)
        elif isinstance(c, Lmi):
            problem.add_constraint(picos.Constant(c.F0) + combine(c.F) >> 0)
        elif isinstance(c, Linear):
            problem.add_constraint(combine(c.A.T) <= picos.Constant(c.b))
        else:
            problem.add_constraint(abs(combine(c.A.T) + picos.Constant(c.b)) <= combine(c.g[:, None]) + c.h)
    used = np.flatnonzero(program.objective)
    problem.set_objective("min", picos.sum([float(program.objective[i]) * d[i] for i in used]))
    return problem


def solve(problem: Any) -> dict[str, Any]:
    """Solve; PICOS translates within its call, and the time is the solver's own."""
    start = time.perf_counter()
    try:
        solution = problem.solve(solver="cvxopt", primals=None)
    except picos.SolutionFailure:
        seconds = time.perf_counter() - start
        return {"seconds": seconds, "objective": None, "certified": None, "status": "numerical trouble"}
    return {
        "seconds": float(solution.searchTime),
        "objective": float(problem.value),
        "certified": None,
        "status": str(solution.claimedStatus),
    }
