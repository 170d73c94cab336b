"""CVXPY with Clarabel, an interior-point method."""

from __future__ import annotations

from functools import partial

import cvxpy as cp

from benchmarks.solvers import cvxpy_model

prepare = partial(cvxpy_model.prepare, solver=cp.CLARABEL)
solve = partial(cvxpy_model.solve, options={"max_threads": 1})
