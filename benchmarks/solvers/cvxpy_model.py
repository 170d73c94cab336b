"""A program modelled in CVXPY: Gram matrices whose coefficients are matched in the quotient by the spheres."""

from __future__ import annotations

import time
import warnings
from functools import lru_cache
from typing import Any

import cvxpy as cp
import numpy as np
from scipy import sparse

from benchmarks.neutral import Linear, Lmi, Program, Quotient, Sos, gram_bases


@lru_cache(maxsize=8)
def _matching(factors: tuple[tuple[str, int], ...], degree: int) -> tuple[Quotient, list[tuple[int, Any]]]:
    quotient = Quotient(factors, degree)
    return quotient, [(len(basis), quotient.gram(weight, basis)) for weight, basis in gram_bases(factors, degree)]


def _sos(c: Sos, d: Any) -> list[Any]:
    quotient, blocks = _matching(c.factors, c.degree)
    left = quotient.matrix(c.exponents)
    squares = 0
    for size, matrix in blocks:
        gram = cp.Variable((size, size), PSD=True)
        squares = squares + matrix @ cp.vec(gram, order="C")
    return [squares == left @ c.c + (left @ sparse.csr_matrix(c.C)) @ d]


def _constraint(c: Any, d: Any) -> list[Any]:
    if isinstance(c, Sos):
        return _sos(c, d)
    if isinstance(c, Lmi):
        order = len(c.F0)
        linear = sparse.csr_matrix(c.F.reshape(len(c.F), -1).T)
        return [cp.reshape(linear @ d + c.F0.ravel(), (order, order), order="C") >> 0]
    if isinstance(c, Linear):
        return [c.A @ d <= c.b]
    return [cp.SOC(c.g @ d + c.h, c.A @ d + c.b)]


def prepare(program: Program, solver: str) -> Any:
    """Model the program and translate it for the solver, up to the call of the solver."""
    d = cp.Variable(program.size)
    constraints = [made for c in program.constraints for made in _constraint(c, d)]
    problem = cp.Problem(cp.Minimize(program.objective @ d), constraints)
    return problem, *problem.get_problem_data(solver, solver_opts={})


def solve(prepared: Any, options: dict[str, Any]) -> dict[str, Any]:
    """Call the solver on the translated program; only the call is timed."""
    problem, data, chain, inverse = prepared
    start = time.perf_counter()
    answer = chain.solve_via_data(problem, data, warm_start=False, verbose=False, solver_opts=dict(options))
    seconds = time.perf_counter() - start
    with warnings.catch_warnings():
        # An inaccurate answer is reported by its status.
        warnings.simplefilter("ignore")
        try:
            problem.unpack_results(answer, chain, inverse)
        except cp.SolverError:
            return {"seconds": seconds, "objective": None, "certified": None, "status": "numerical trouble"}
    value = problem.value
    return {
        "seconds": seconds,
        "objective": float(value) if value is not None and np.isfinite(value) else None,
        "certified": None,
        "status": str(problem.status).replace("_", " "),
    }
