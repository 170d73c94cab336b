"""How figures look: colours that the colour-blind can tell apart, with a line style each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from aerotube.units import DISPLAY

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: Okabe and Ito's palette, by controller; darker is the one under study.
COLOURS = {"none": "#D55E00", "compensated": "#0072B2", "lqr": "#009E73", "nominal": "#333333"}
DASHES = {"none": (0, (5, 2)), "compensated": "solid", "lqr": (0, (1, 1.2)), "nominal": (0, (6, 2, 1, 2))}


def new_figure(width: float, height: float, title: str = "") -> Figure:
    """Make a figure that is drawn without a display and without global state (inches).

    Panels are placed by hand: a layout engine draws everything twice or more, which is most of a report's time.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, fontsize=12, y=0.985)
    return figure


def tidy(axes: Axes, label: str, *, time: bool = True) -> None:
    """Label a panel, with light grid lines and no box."""
    axes.set_ylabel(label, fontsize=9)
    if time:
        axes.set_xlabel("time (s)", fontsize=9)
        axes.margins(x=0.01)
    axes.tick_params(labelsize=8)
    axes.grid(True, color="#DDDDDD", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def legend(figure: Figure, columns: int) -> None:
    """Name below a figure every series that one of its panels shows, once."""
    found: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    figure.legend([*found.values()], [*found], loc="lower center", ncols=columns, fontsize=9, frameon=False)


def shown(name: str, values: Any) -> Array:
    """Convert values of a state or control from SI to the unit in which it is shown."""
    return np.asarray(values, dtype=float) * DISPLAY[name].factor


def flown(dataset: xr.Dataset, condition: str) -> list[str]:
    """Return the controllers that were flown in a condition."""
    if "flown" not in dataset or condition not in dataset["condition"].values:
        return []
    cases = dataset["flown"].sel(condition=condition)
    return [str(name) for name in dataset["controller"].values if bool(cases.sel(controller=name))]
