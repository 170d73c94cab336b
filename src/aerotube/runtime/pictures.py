"""Figures of a flight: the timeline of solves (as the paper's Fig. 15), and states and controls (its Fig. 16)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from aerotube.flight.metrics import error_metric
from aerotube.preparation import error_states
from aerotube.report.style import COLOURS, DASHES, new_figure, shown, tidy
from aerotube.runtime.messages import Rung
from aerotube.units import DISPLAY

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: Colours of the ladder, best first; also told apart by their height in the strip.
RUNG_COLOURS = ("#009E73", "#56B4E9", "#E69F00", "#CC79A7", "#D55E00")
_RUNG_WORDS = ("planned", "any-time answer", "last law", "LQR gain", "nominal alone")
_PANELS = (
    ("a", "V"),
    ("b", "throttle"),
    ("c", "alpha"),
    ("d", "elevator"),
    ("e", "q"),
    ("f", "theta"),
    ("g", "beta"),
    ("h", "rudder"),
    ("i", "r"),
    ("j", "aileron"),
    ("k", "p"),
    ("l", "phi"),
)
_STATES = ("V", "alpha", "q", "theta", "beta", "p", "r", "phi")
_CONTROLS = ("elevator", "throttle", "aileron", "rudder")


def timeline_figure(dataset: xr.Dataset) -> Figure:
    """When each window was computed and when it was flown, what was flown in each beat, and its latency.

    Parameters
    ----------
    dataset : xarray.Dataset
        A log; the first manoeuvres are drawn.

    Returns
    -------
    matplotlib.figure.Figure
    """
    horizon = int(dataset.attrs["beats_of_manoeuvre"])
    count = min(dataset.sizes["beat"], max(2 * horizon, 80))
    due = dataset["due"].values
    length = float(np.median(np.diff(due))) if len(due) > 1 else float(dataset.attrs["beat_seconds"])
    end = due[count - 1] + length
    figure = new_figure(13, 7.5, "Computing while flying: windows of laws, beats and their latency")
    grid = figure.add_gridspec(
        3, 1, height_ratios=(2.2, 1, 1.2), hspace=0.5, left=0.075, right=0.985, bottom=0.075, top=0.92
    )
    first = float(dataset["window_asked"].values[0]) if dataset.sizes["window"] else 0.0
    span = (max(first, -0.25 * end) - 0.01 * end, end)
    _windows(figure.add_subplot(grid[0]), dataset, due, length, count)
    _beats(figure.add_subplot(grid[1]), dataset, due, length, count)
    _latencies(figure.add_subplot(grid[2]), dataset, due, count)
    for axes in figure.axes:
        axes.set_xlim(*span)
        axes.set_axisbelow(True)
    return figure


def _windows(axes: Axes, dataset: xr.Dataset, due: Array, length: float, count: int) -> None:
    rows = 0
    for w in range(dataset.sizes["window"]):
        first, beats = int(dataset["window_first"][w]), int(dataset["window_beats"][w])
        if first >= count:
            continue
        rows = w + 1
        start, done = float(dataset["window_started"][w]), float(dataset["window_done"][w])
        axes.broken_barh([(due[first], beats * length)], (w - 0.4, 0.8), color="#DDDDDD")
        if np.isfinite(done):
            late = done > due[first]
            axes.broken_barh([(start, done - start)], (w - 0.4, 0.8), color=RUNG_COLOURS[4 if late else 0])
    axes.set_ylim(rows - 0.4, -0.6)
    axes.set_title("(a) windows: computed (coloured; late ones red) and flown (grey)", fontsize=10, loc="left")
    tidy(axes, "window")


def _beats(axes: Axes, dataset: xr.Dataset, due: Array, length: float, count: int) -> None:
    worst = dataset["rung"].values.max(axis=1)[:count]
    for rung in Rung:
        at = np.flatnonzero(worst == rung)
        label = f"{_RUNG_WORDS[rung]} ({len(at)})"
        axes.broken_barh([(due[g], length) for g in at], (rung - 0.4, 0.8), color=RUNG_COLOURS[rung], label=label)
    missed = np.flatnonzero(dataset["missed"].values[:count])
    axes.plot(
        due[missed], np.full(len(missed), 4.8), "v", color="#333333", markersize=4, label=f"missed ({len(missed)})"
    )
    axes.set_ylim(5.4, -0.6)
    axes.set_yticks([])
    axes.set_title("(b) what was flown", fontsize=10, loc="left")
    tidy(axes, "")
    axes.legend(fontsize=8, frameon=False, ncols=6, loc="upper left", bbox_to_anchor=(0.12, 1.28))


def _latencies(axes: Axes, dataset: xr.Dataset, due: Array, count: int) -> None:
    spans = 1e6 * (dataset["sent"].values - dataset["arrived"].values)
    axes.semilogy(due[:count], spans[:count], ".", color=COLOURS["compensated"], markersize=4)
    finite = spans[np.isfinite(spans)]
    drawn = spans[:count][np.isfinite(spans[:count])]
    if len(drawn):
        from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

        narrow = drawn.max() < 30.0 * drawn.min()
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if narrow else (1.0,)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    if len(finite):
        median, most = np.median(finite), np.percentile(finite, 99)
        axes.axhline(median, color=COLOURS["nominal"], linewidth=0.9)
        words = f"(c) measurement in to command out: median {median:.0f} µs, 99th percentile {most:.0f} µs (all beats)"
        axes.set_title(words, fontsize=10, loc="left")
    tidy(axes, "latency (µs)")


def flight_figure(dataset: xr.Dataset, manoeuvre: int = 0) -> Figure | None:
    """States, controls and error of one manoeuvre, with compensation and without (the paper's Fig. 16).

    Parameters
    ----------
    dataset : xarray.Dataset
        A log.
    manoeuvre : int

    Returns
    -------
    matplotlib.figure.Figure or None
        None without the aircraft's own log.
    """
    if "true_error" not in dataset:
        return None
    beats, dt = int(dataset.attrs["beats_of_manoeuvre"]), float(dataset.attrs["beat_seconds"])
    own = slice(manoeuvre * beats, (manoeuvre + 1) * beats)
    nominal = np.concatenate([dataset["nominal_state"].values[own], dataset["nominal_end"].values[own][-1:]])
    lines = {"nominal": error_states(nominal)}
    for key, name in (("none", "alone_error"), ("compensated", "true_error")):
        lines[key] = lines["nominal"] + dataset[name].values[manoeuvre]
    times = np.asarray(dt * np.arange(beats + 1), dtype=np.float64)
    case: dict[str, Any] = {
        "measured": error_states(dataset["measured"].values[own]),
        "command": dataset["command"].values[own],
        "nominal_control": dataset["nominal_control"].values[own],
    }
    figure = new_figure(15, 13, f"Runtime flight, manoeuvre {manoeuvre + 1}")
    margins = {"left": 0.05, "right": 0.99, "bottom": 0.07, "top": 0.945}
    grid = figure.add_gridspec(5, 3, height_ratios=(1, 1, 1, 1, 1.2), hspace=0.5, wspace=0.2, **margins)
    for place, (letter, name) in enumerate(_PANELS):
        axes = figure.add_subplot(grid[divmod(place, 3)])
        _panel(axes, name, times, lines, case)
        axes.set_title(f"({letter}) {DISPLAY[name].name}", fontsize=10, loc="left")
    axes = figure.add_subplot(grid[4, :])
    for key, name, words in (
        ("none", "alone_error", "without compensation"),
        ("compensated", "true_error", "with compensation"),
    ):
        metric = error_metric(dataset[name].values[manoeuvre])
        label = f"{words} (mean {metric.mean():.2f}, root mean square {np.sqrt((metric**2).mean()):.2f})"
        axes.plot(times, metric, color=COLOURS[key], linestyle=DASHES[key], label=label)
    axes.set_title("(m) sum of errors (Eq. 18)", fontsize=10, loc="left")
    axes.set_ylim(bottom=0.0)
    tidy(axes, "error (deg)")
    axes.legend(fontsize=9, frameon=False)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="lower center", ncols=4, fontsize=9, frameon=False)
    return figure


def _panel(axes: Axes, name: str, times: Array, lines: dict[str, Array], case: dict[str, Any]) -> None:
    if name in _CONTROLS:
        i = _CONTROLS.index(name)
        for key, values in (("nominal", case["nominal_control"]), ("compensated", case["command"])):
            held = np.append(values[:, i], values[-1, i])
            axes.step(times, shown(name, held), where="post", color=COLOURS[key], linestyle=DASHES[key], linewidth=1.2)
    else:
        i = _STATES.index(name)
        axes.plot(times[:-1], shown(name, case["measured"][:, i]), ".", color="#999999", markersize=3, label="measured")
        words = {"nominal": "nominal", "none": "without compensation", "compensated": "with compensation"}
        for key, values in lines.items():
            drawn = shown(name, values[:, i])
            axes.plot(times, drawn, label=words[key], color=COLOURS[key], linestyle=DASHES[key], linewidth=1.2)
    tidy(axes, DISPLAY[name].label)
