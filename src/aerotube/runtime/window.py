"""A window: the laws of some beats in a row, and what stands behind each of them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from aerotube.runtime.law import Laws

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Window:
    """Laws of some beats.

    Attributes
    ----------
    beats : ndarray (b,) of int
        Of the window, and behind them those for which the last law was measured too.
    window : int
        How many of them are the window's own.
    laws : Laws
        Of b beats.
    rungs : ndarray (b, parts) of int
        What stands behind each part of them, see `Rung`; for the beats behind the window, of the last law there.
    size : ndarray (b, parts)
        Certified; NaN where the part flies something that is not certified.
    kinds : ndarray (b, parts) of int
        What stands behind the sizes, an index of `aerotube.compensation.KINDS`; -1 where nothing does.
    metric : tuple of ndarray (b, n, n)
        In which the size of each part is measured.
    lqr : ndarray (b', 4, 8)
        Gains of the regulator from the first beat of the window to the end of the look-ahead.
    kept : ndarray (b,) of bool
        Beats whose law is the last manoeuvre's, checked and found to hold.
    made : ndarray (b, parts)
        Certified sizes where the laws were designed; kept ones may have grown since.
    designed : int
        Programs of a law that were solved.
    seconds : dict of float
        Wall-clock time by what was done.
    messages : tuple of str
    """

    beats: NDArray[np.intp]
    window: int
    laws: Laws
    rungs: NDArray[np.int64]
    size: Array
    kinds: NDArray[np.int64]
    metric: tuple[Array, ...]
    lqr: Array
    kept: NDArray[np.bool_]
    made: Array
    designed: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    messages: tuple[str, ...] = ()
