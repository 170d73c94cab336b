"""The counterpart of Fig. 9: controls, tracking errors and their sum, with and without compensation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from aerotube.report.style import COLOURS, DASHES, flown, new_figure, shown, tidy
from aerotube.results import CONDITION_WORDS, CONTROLLER_WORDS
from aerotube.units import DISPLAY

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Panels in the order of the paper's letters.
_GRID = (
    (("a", "elevator"), ("b", "throttle"), ("c", "V"), ("d", "alpha")),
    (("e", "q"), ("f", "aileron"), ("g", "rudder"), ("h", "beta")),
    (("i", "p"), ("j", "r"), ("k", "theta"), ("l", "phi")),
)
_CONTROLS = ("elevator", "throttle", "aileron", "rudder")


def tracking_figure(dataset: xr.Dataset, condition: str) -> Figure | None:
    """Draw bands of controls and errors over the first seed's runs, and the sum of errors over all seeds.

    Parameters
    ----------
    dataset : xarray.Dataset
    condition : str

    Returns
    -------
    matplotlib.figure.Figure or None
        None if nothing was flown in this condition.
    """
    if "flown" not in dataset or condition not in dataset["condition"].values or not flown(dataset, condition):
        return None
    case = dataset.sel(condition=condition)
    title = (
        f"Tracking under the disturbances of the scenario, {CONDITION_WORDS[condition]}: "
        f"bands over {dataset.sizes['run']} runs (seed {int(dataset['seed'].values[0])})"
    )
    figure = new_figure(15, 12, title)
    margins = {"left": 0.045, "right": 0.99, "bottom": 0.075, "top": 0.935}
    grid = figure.add_gridspec(4, 4, height_ratios=(1, 1, 1, 1.25), hspace=0.42, wspace=0.26, **margins)
    controllers = [name for name in flown(dataset, condition) if name != "lqr"]
    for row, panels in enumerate(_GRID):
        for column, (letter, name) in enumerate(panels):
            axes = figure.add_subplot(grid[row, column])
            if name in _CONTROLS:
                _draw_control(axes, case, name, controllers)
            else:
                _draw_error(axes, case, name, controllers)
            axes.set_title(f"({letter}) {DISPLAY[name].name}", fontsize=10, loc="left")
    axes = figure.add_subplot(grid[3, :])
    _draw_sum(axes, case, flown(dataset, condition))
    axes.set_title("(m) sum of errors: upper envelope over the runs, mean over seeds ± sd", fontsize=10, loc="left")
    _legend(figure, controllers)
    return figure


def _band(axes: Axes, times: np.ndarray, values: np.ndarray, controller: str) -> None:
    low, high = np.nanmin(values, axis=0), np.nanmax(values, axis=0)
    colour = COLOURS[controller]
    axes.fill_between(times, low, high, color=colour, alpha=0.25 if controller == "none" else 0.4, linewidth=0)
    for edge in (low, high):
        axes.plot(times, edge, color=colour, linestyle=DASHES[controller], linewidth=1.1)


def _draw_error(axes: Axes, case: xr.Dataset, name: str, controllers: list[str]) -> None:
    for controller in controllers:
        values = shown(name, case["error"].sel(controller=controller, state=name).values)
        _band(axes, case["time"].values, values, controller)
    axes.axhline(0.0, color=COLOURS["nominal"], linewidth=0.8)
    tidy(axes, f"error in {DISPLAY[name].label}")


def _draw_control(axes: Axes, case: xr.Dataset, name: str, controllers: list[str]) -> None:
    times = case["time"].values
    for controller in controllers:
        if controller == "none":
            continue  # its control is the nominal line
        values = shown(name, case["command"].sel(controller=controller, control=name).values)
        # A control is held over its beat: the last value is drawn up to the end of the last beat.
        _step_band(axes, times, values, controller)
    nominal = shown(name, case["nominal_control"].sel(control=name).values)
    axes.step(times, np.append(nominal, nominal[-1]), where="post", color=COLOURS["nominal"], linewidth=1.0)
    tidy(axes, DISPLAY[name].label)


def _step_band(axes: Axes, times: np.ndarray, values: np.ndarray, controller: str) -> None:
    low, high = np.nanmin(values, axis=0), np.nanmax(values, axis=0)
    low, high = np.append(low, low[-1]), np.append(high, high[-1])
    axes.fill_between(times, low, high, step="post", color=COLOURS[controller], alpha=0.4, linewidth=0)


def _draw_sum(axes: Axes, case: xr.Dataset, controllers: list[str]) -> None:
    times = case["time"].values
    for controller in controllers:
        upper = case["upper_metric"].sel(controller=controller).values
        mean, spread = upper.mean(axis=0), upper.std(axis=0)
        colour = COLOURS[controller]
        label = f"{CONTROLLER_WORDS[controller]} (mean over time {upper.mean():.2f})"
        axes.plot(times, mean, color=colour, linestyle=DASHES[controller], linewidth=1.8, label=label)
        axes.fill_between(times, mean - spread, mean + spread, color=colour, alpha=0.18, linewidth=0)
    axes.set_ylim(0.0, 1.2 * axes.get_ylim()[1])
    tidy(axes, "error, Eq. 18 (deg)")
    axes.legend(fontsize=9, frameon=False, ncols=3, loc="upper right")


def _legend(figure: Figure, controllers: list[str]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Line2D | Patch] = [
        Patch(facecolor=COLOURS[name], alpha=0.4, edgecolor=COLOURS[name], label=CONTROLLER_WORDS[name])
        for name in controllers
    ]
    handles.append(Line2D([], [], color=COLOURS["nominal"], label="nominal"))
    figure.legend(handles=handles, loc="lower center", ncols=3, fontsize=9, frameon=False)
