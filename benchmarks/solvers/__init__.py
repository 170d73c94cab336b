"""One module for each solver: ``prepare(program)`` models a program, ``solve(prepared)`` solves it."""

from __future__ import annotations

#: Names in the table, with the module of each.
SOLVERS = {
    "aerotube": "benchmarks.solvers.own",
    "cvxpy+Clarabel": "benchmarks.solvers.cvxpy_clarabel",
    "cvxpy+SCS": "benchmarks.solvers.cvxpy_scs",
    "SumOfSquares.py": "benchmarks.solvers.sumofsquares",
    "pydrake": "benchmarks.solvers.drake",
}
