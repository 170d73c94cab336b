"""The paper's test of whether two means differ, and spreads in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: The paper's level of significance.
LEVEL = 0.05


@dataclass(frozen=True)
class Welch:
    """Outcome of Welch's t-test.

    Attributes
    ----------
    difference : float
        Mean of the first sample less that of the second.
    statistic, degrees : float
        t and its degrees of freedom.
    p : float
        Probability of a difference as large either way if the means are equal; one for samples without spread
        and difference, zero for samples without spread that differ.
    """

    difference: float
    statistic: float
    degrees: float
    p: float

    @property
    def words(self) -> str:
        """The probability in words."""
        return "below 0.001" if self.p < 1e-3 else f"{self.p:.2g}"

    @property
    def significant(self) -> bool:
        """Whether the means differ at the paper's level."""
        return self.p < LEVEL


def welch(first: Sequence[float] | Array, second: Sequence[float] | Array) -> Welch:
    """Welch's t-test of equal means, variances unequal (two-sided).

    Parameters
    ----------
    first, second : sequences of float
        At least two each.

    Returns
    -------
    Welch
    """
    from scipy import stats

    a, b = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    difference = float(a.mean() - b.mean())
    if np.ptp(a) == 0.0 and np.ptp(b) == 0.0:
        return Welch(difference, np.inf * np.sign(difference) if difference else 0.0, np.inf, float(difference == 0.0))
    found = stats.ttest_ind(a, b, equal_var=False)
    return Welch(difference, float(found.statistic), float(found.df), float(found.pvalue))


def paired(first: Sequence[float] | Array, second: Sequence[float] | Array) -> float:
    """Probability, by the paired t-test, of a mean difference as large either way if there is none.

    Parameters
    ----------
    first, second : sequences of float
        Of the same draws, at least two.

    Returns
    -------
    float
        One if there is no difference at all.
    """
    from scipy import stats

    difference = np.asarray(first, dtype=float) - np.asarray(second, dtype=float)
    if np.ptp(difference) == 0.0:
        return float(difference[0] == 0.0)
    return float(stats.ttest_1samp(difference, 0.0).pvalue)


def spread(values: Sequence[float] | Array, digits: int = 3) -> str:
    """Mean and standard deviation in words."""
    array = np.asarray(values, dtype=float)
    mean = f"{array.mean():.{digits}f}"
    return mean if array.size < 2 else f"{mean} ± {array.std(ddof=1):.{digits}f}"
