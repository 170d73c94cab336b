"""What a study comes to: data, a figure, numbers beside the paper's, and a verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Compared:
    """A number of the paper and the same number of ours.

    Attributes
    ----------
    name : str
        Its key in ``studies.json``.
    words : str
    unit : str
    paper : float or None
        None where the paper has no number.
    ours, ours_sd : float or None
        Mean and standard deviation over the seeds, or over what ``words`` says; None where it was not reached.
    verdict : str
        What the two say side by side.
    """

    name: str
    words: str
    unit: str
    paper: float | None
    ours: float | None
    ours_sd: float | None
    verdict: str

    @property
    def ratio(self) -> float | None:
        """Ours over the paper's."""
        return None if self.paper in (None, 0.0) or self.ours is None else self.ours / self.paper


@dataclass(frozen=True)
class Table:
    """A further table of a study's report.

    Attributes
    ----------
    title : str
    head : tuple of str
    rows : tuple of tuple of str
    """

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a study comes to.

    Attributes
    ----------
    dataset : xarray.Dataset
        SI, labelled, units in the attributes.
    figure : matplotlib.figure.Figure
    caption : str
    compared : tuple of Compared
    verdict : str
        One line.
    notes : tuple of str
        How it was done, and why a number is another than the paper's.
    tables : tuple of Table
    """

    dataset: xr.Dataset
    figure: Figure
    caption: str
    compared: tuple[Compared, ...]
    verdict: str
    notes: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()

    def described(self) -> dict[str, Any]:
        """All but data and figure, ready for JSON."""
        return {
            "verdict": self.verdict,
            "caption": self.caption,
            "compared": [asdict(one) | {"ratio": one.ratio} for one in self.compared],
            "notes": list(self.notes),
            "tables": [asdict(table) for table in self.tables],
        }


def compare(
    name: str,
    words: str,
    paper: float | None,
    ours: float | Sequence[float] | Array | None,
    unit: str = "deg",
    verdict: str | None = None,
) -> Compared:
    """Set a number beside the paper's.

    Parameters
    ----------
    name, words, unit
        See :class:`Compared`.
    paper : float or None
    ours : float, sequence of float, or None
        Several give their mean and sample standard deviation; numbers that are not finite count as not reached.
    verdict : str, optional
        By default the ratio in words.

    Returns
    -------
    Compared
    """
    values = np.atleast_1d(np.asarray([] if ours is None else ours, dtype=float))
    reached = values.size > 0 and bool(np.isfinite(values).all())
    mean = float(values.mean()) if reached else None
    sd = float(values.std(ddof=1)) if reached and values.size > 1 else None
    row = Compared(name, words, unit, paper, mean, sd, "")
    if verdict is None:
        verdict = _default_verdict(row)
    return Compared(name, words, unit, paper, mean, sd, verdict)


def _default_verdict(row: Compared) -> str:
    if row.ours is None:
        return "not reached"
    if row.ratio is None:
        return "the paper gives no number"
    if abs(row.ratio - 1.0) < 5e-3:
        return "as the paper's"
    return f"{'smaller' if row.ratio < 1.0 else 'larger'} than the paper's"
