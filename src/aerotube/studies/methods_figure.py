"""The figure of the comparison of methods: bars over the size of the disturbances."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from aerotube.report.style import new_figure
from aerotube.results import CONDITION_WORDS
from aerotube.studies.flown import COLOURS

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def methods_figure(dataset: xr.Dataset, methods: Mapping[str, str], air: Mapping[str, str]) -> Figure:
    """Draw mean upper errors as bars, one panel for each condition and kind of air.

    Parameters
    ----------
    dataset : xarray.Dataset
        With ``mean_upper_error`` (controller, condition, air, factor, seed).
    methods, air : mapping of str to str
        Words by name, in the order in which they are drawn.

    Returns
    -------
    matplotlib.figure.Figure
    """
    conditions = [str(name) for name in dataset["condition"].values]
    figure = new_figure(16, 4.0 * len(air) + 0.9, "Mean upper error of the methods")
    figure.subplots_adjust(left=0.05, right=0.99, bottom=0.12, top=0.91, hspace=0.38, wspace=0.14)
    panels = figure.subplots(len(air), len(conditions), squeeze=False)
    for row, (kind, words) in enumerate(air.items()):
        for column, condition in enumerate(conditions):
            axes = panels[row, column]
            _bars(axes, dataset["mean_upper_error"].sel(condition=condition, air=kind), methods)
            axes.set_title(f"{CONDITION_WORDS[condition]}, {words}", fontsize=10, loc="left")
            if column == 0:
                axes.set_ylabel("mean upper error, Eq. 18 (deg)", fontsize=9)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=len(methods), fontsize=9, frameon=False)
    return figure


def _bars(axes: Axes, cell: xr.DataArray, methods: Mapping[str, str]) -> None:
    factors = cell["factor"].values
    middle, width = np.arange(len(factors)), 0.84 / len(methods)
    top = 1.35 * float(cell.sel(controller="none").mean("seed").max())
    for place, (method, words) in enumerate(methods.items()):
        values = cell.sel(controller=method).values
        mean, deviation = values.mean(axis=-1), values.std(axis=-1)
        where = middle + (place - 0.5 * (len(methods) - 1)) * width
        axes.bar(where, np.minimum(mean, top), width, yerr=deviation, color=COLOURS[place], label=words, capsize=2)
        for x, height in zip(where, mean, strict=True):
            if height > top:
                axes.text(x, 0.97 * top, f"{height:.2g}", rotation=90, fontsize=7, ha="center", va="top", color="white")
    axes.set_ylim(0.0, top)
    axes.set_xticks(middle, [f"× {factor:g}" for factor in factors])
    axes.set_xlabel("size of the disturbances", fontsize=9)
    axes.tick_params(labelsize=8)
    axes.grid(True, axis="y", color="#DDDDDD", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
