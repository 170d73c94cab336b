"""CVXPY with SCS, a splitting method; asked for 1e-6, since its default of 1e-4 is far from what the others reach."""

from __future__ import annotations

from functools import partial

import cvxpy as cp

from benchmarks.solvers import cvxpy_model

prepare = partial(cvxpy_model.prepare, solver=cp.SCS)
solve = partial(cvxpy_model.solve, options={"eps_abs": 1e-6, "eps_rel": 1e-6, "max_iters": 10**6})
