"""Comparisons that hold throughout a domain, nowhere, or here and there."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Truths = NDArray[np.bool_]


class Truth:
    """Whether a comparison of models holds: throughout the domain, nowhere, or here and there.

    Attributes
    ----------
    certain, possible, central : array of bool (...)
        It holds at all points; it is not known to fail at all points; it holds for the polynomials at the centre.
    """

    __slots__ = ("central", "certain", "possible")

    def __init__(self, certain: Truths, possible: Truths, central: Truths) -> None:
        self.certain, self.possible, self.central = certain, possible, central

    def __invert__(self) -> Truth:
        return Truth(~self.possible, ~self.certain, ~self.central)

    def __and__(self, other: Any) -> Truth:
        right = truth_of(other)
        return Truth(self.certain & right.certain, self.possible & right.possible, self.central & right.central)

    def __or__(self, other: Any) -> Truth:
        right = truth_of(other)
        return Truth(self.certain | right.certain, self.possible | right.possible, self.central | right.central)

    __rand__, __ror__ = __and__, __or__

    def __bool__(self) -> bool:
        if self.certain.all():
            return True
        if self.possible.any():
            raise ValueError("a comparison of Taylor models is not decided; branch with `select`")
        return False


def truth_of(condition: Any) -> Truth:
    """The condition itself, or a plain boolean (...), which is known everywhere."""
    if isinstance(condition, Truth):
        return condition
    known = np.asarray(condition, dtype=np.bool_)
    return Truth(known, known, known)
