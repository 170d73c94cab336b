"""What tubes are made of beyond their polynomials, over the beats."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from aerotube.report.style import legend, new_figure, tidy

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Colour, hatch and words of each share.
SHARE_STYLES = {
    "remainder": ("#999999", "", "Taylor or interpolation remainder"),
    "parameters": ("#009E73", "..", "parameters inside their ranges"),
    "coupling": ("#0072B2", "", "the other half's errors"),
    "measurement": ("#E69F00", "//", "measurement errors"),
    "gusts": ("#CC79A7", "\\\\", "gusts"),
}


def shares_figure(dataset: xr.Dataset) -> Figure | None:
    """Draw the shares of every part's tubes over time, a column for each law; None if nothing beyond was bounded."""
    if "size_share" not in dataset or not np.isfinite(dataset["size_share"].values).any():
        return None
    present = {name for name in SHARE_STYLES if (np.nan_to_num(dataset["size_share"].sel(share=name)) != 0.0).any()}
    laws, parts = ([str(name) for name in dataset[axis].values] for axis in ("law", "part"))
    figure = new_figure(15, 0.9 + 3.0 * len(parts), "What tubes hold beyond the polynomials of their programs")
    bottom = 0.9 / (0.9 + 3.0 * len(parts))
    margins = {"left": 0.05, "right": 0.99, "bottom": bottom, "top": 1.0 - 0.75 * bottom}
    grid = figure.add_gridspec(len(parts), len(laws), hspace=0.42, wspace=0.14, **margins)
    for row, part in enumerate(parts):
        for column, law in enumerate(laws):
            axes = figure.add_subplot(grid[row, column])
            _draw(axes, dataset.sel(law=law, part=part), present)
            axes.set_title(f"{law.replace('_', '-')} law, {part}", fontsize=10, loc="left")
            tidy(axes, "added to the polynomial's ρ (%)")
    legend(figure, columns=6)
    return figure


def _draw(axes: Axes, tubes: xr.Dataset, present: set[str]) -> None:
    edges, polynomial = tubes["time"].values, tubes["size_polynomial"].values
    floor = np.zeros(len(polynomial))
    for name, (colour, hatch, words) in SHARE_STYLES.items():
        if name not in present:
            continue
        share = 100.0 * tubes["size_share"].sel(share=name).values / polynomial
        top = floor + np.nan_to_num(share)
        axes.fill_between(
            edges, _held(floor), _held(top), step="post", facecolor=colour, hatch=hatch, edgecolor="white",
            linewidth=0, label=words,
        )  # fmt: skip
        floor = top
    control = 100.0 * tubes["size_control"].values / polynomial
    axes.step(
        edges, _held(control), where="post", color="#D55E00", linewidth=1.4, linestyle=(0, (5, 2)),
        label="control's nonlinearity (within the polynomial)",
    )  # fmt: skip
    axes.set_ylim(bottom=min(0.0, float(floor.min())))


def _held(values: np.ndarray) -> np.ndarray:
    """Values of beats up to the end of the last."""
    return np.append(values, values[-1])
