"""What a backend hands back for one program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from aerotube.sos.domain import Array
from aerotube.sos.solution import Status


@dataclass(frozen=True)
class Result:
    """Decision, Gram matrices and multipliers of one program, in the program's own units.

    Attributes
    ----------
    values : (m,)
    grams : dict of tuple of (N, N)
    multipliers : dict of arrays, as in `aerotube.sos.Solution`
    status : Status
    iterations : int
    """

    values: Array
    grams: Mapping[str, tuple[Array, ...]]
    multipliers: Mapping[str, Array]
    status: Status
    iterations: int
