"""What a solve returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from aerotube.sos.domain import Array
from aerotube.sos.program import Data, Structure

if TYPE_CHECKING:
    from aerotube.sos.certificate import Certificate
    from aerotube.sos.explain import Explanation


class Status(IntEnum):
    """How a solve ended."""

    OPTIMAL = 0
    """Optimal to the tolerances."""
    DEADLINE = 1
    """Stopped at the deadline. The values are the best of those reached that can be certified; if there were none, they
    are the nearest to an optimum, and `Certificate.holds` says that nothing is certified."""
    INFEASIBLE = 2
    """The multipliers contradict the constraints, up to rounding: `Solution.explain` says for decisions of what size
    that is proven. Of sum-of-squares constraints it says that they cannot hold as sums of squares."""
    UNBOUNDED = 3
    """The objective has no lower bound: the values are a ray along which it falls."""
    TROUBLE = 4
    """Numerical trouble: neither an optimum nor a certificate was reached."""

    def __str__(self) -> str:
        return {0: "optimal", 1: "stopped at deadline", 2: "infeasible", 3: "unbounded", 4: "numerical trouble"}[
            self.value
        ]


@dataclass(frozen=True, eq=False)
class Solution:
    """Decisions, multipliers and residuals of one program or a batch of programs.

    Attributes
    ----------
    structure : Structure
    data : Data
    values : (..., m)
        The decision vector; ``solution["K"]`` unpacks a variable.
    objective : (...)
        Objective at `values`, log-determinant terms included.
    status : (...) array of Status values
    iterations : (...) integers
    seconds : (...)
        Wall-clock time of each program.
    grams : dict of tuple of (..., N, N)
        Gram matrices of each sum-of-squares constraint, one for each block.
    multipliers : dict of arrays
        Dual variables: (..., U) functionals for sos, (..., k, k) matrices for lmi and logdet, (..., 1 + k) for norm
        (the bound's multiplier first), (..., rows) for linear. For an infeasible program, the contradiction.
    primal_residual, dual_residual, gap : (...)
        Relative violation of the equations, of stationarity, and relative difference of the objectives.
    backend : str
    """

    structure: Structure
    data: Data
    values: Array
    objective: Array
    status: NDArray[np.int64]
    iterations: NDArray[np.int64]
    seconds: Array
    grams: Mapping[str, tuple[Array, ...]]
    multipliers: Mapping[str, Array]
    primal_residual: Array
    dual_residual: Array
    gap: Array
    backend: str

    def __getitem__(self, name: str) -> Array:
        """Unpack a variable: (..., *shape); symmetric matrices are full."""
        return self.structure.variable(name).unpack(self.values)

    @property
    def optimal(self) -> NDArray[np.bool_]:
        """Where the program was solved to its tolerances."""
        return np.asarray(self.status == Status.OPTIMAL)

    def certificate(self) -> Certificate:
        """Bounds that hold rigorously for the polynomials, after residuals and rounding, optimal or not."""
        from aerotube.sos.certificate import certify

        return certify(self)

    def explain(self, position: tuple[int, ...] = ()) -> Explanation:
        """Say why the program at a place of the batch is infeasible, and how far that is proven; ValueError if not."""
        from aerotube.sos.explain import explain

        return explain(self, position)

    def describe(self) -> str:
        """Count the outcomes in one sentence."""
        counts = [(str(s), int(np.sum(self.status == s))) for s in Status]
        total = int(np.size(self.status))
        return f"{total} program{'s' * (total != 1)}: " + ", ".join(f"{n} {s}" for s, n in counts if n) + "."
