"""Flights of several cases side by side: their dataset, and their figure drawn like the paper's Fig. 9."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from aerotube.flight import Flights
from aerotube.report.style import Array, new_figure, shown, tidy
from aerotube.results.record import CONTROL_UNITS, CONTROLS, STATE_UNITS, STATES
from aerotube.units import DISPLAY

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Okabe and Ito's palette and line styles, by the place of a case.
COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#333333", "#56B4E9")
DASHES: tuple[Any, ...] = (
    (0, (5, 2)),
    "solid",
    (0, (1, 1.2)),
    (0, (6, 2, 1, 2)),
    (0, (3, 1)),
    (0, (8, 3)),
    (0, (2, 2)),
)


def flights_dataset(cases: Mapping[str, Flights], nominal_controls: Array) -> xr.Dataset:
    """Label the flights of several cases.

    Parameters
    ----------
    cases : mapping of str to Flights
        On the same draws.
    nominal_controls : ndarray (beat, 4)

    Returns
    -------
    xarray.Dataset
        The largest metric over the runs of each seed, the bands of errors and controls over the first seed's runs.
    """
    import xarray as xr

    some = next(iter(cases.values()))
    first = slice(0, some.runs_per_seed)

    def over_runs(name: str, reduce: Any) -> Array:
        return np.stack([reduce(getattr(flown, name)[first], axis=0) for flown in cases.values()])

    by_state, by_control = {"units": ", ".join(STATE_UNITS)}, {"units": ", ".join(CONTROL_UNITS)}
    metric = {"units": "deg", "long_name": "error metric (Eq. 18): RMS over the eight states"}
    return xr.Dataset(
        {
            "upper_metric": (
                ("case", "seed", "time"),
                np.stack([flown.upper_envelope() for flown in cases.values()]),
                metric | {"cell_methods": "run: maximum"},
            ),
            "error_low": (("case", "time", "state"), over_runs("error", np.min), by_state),
            "error_high": (("case", "time", "state"), over_runs("error", np.max), by_state),
            "command_low": (("case", "beat", "control"), over_runs("control", np.min), by_control),
            "command_high": (("case", "beat", "control"), over_runs("control", np.max), by_control),
            "nominal_control": (("beat", "control"), nominal_controls, by_control),
            "diverged_runs": ("case", [len(flown.diverged) for flown in cases.values()]),
            "outside_runs": ("case", [int(flown.outside.sum()) for flown in cases.values()]),
        },
        coords={
            "case": list(cases),
            "seed": list(some.seeds),
            "time": ("time", some.times, {"units": "s"}),
            "state": list(STATES),
            "control": list(CONTROLS),
        },
        attrs={"runs_per_seed": some.runs_per_seed},
    )


def mean_upper_error(dataset: xr.Dataset, case: str) -> Array:
    """Mean over time of a case's upper envelope, one value a seed: ndarray (seed,)."""
    values: Array = dataset["upper_metric"].sel(case=case).mean("time").values
    return values


def bands_figure(
    dataset: xr.Dataset, title: str, panels: Sequence[tuple[str, str]], cases: Sequence[str], columns: int = 4
) -> Figure:
    """Draw bands of states and controls over the first seed's runs, and the sum of errors over all seeds.

    Parameters
    ----------
    dataset : xarray.Dataset
        As from :func:`flights_dataset`.
    title : str
    panels : sequence of (str, str)
        The paper's letter and the state or control of each; the sum of errors comes last.
    cases : sequence of str
        In the order in which they are drawn, at most seven.
    columns : int

    Returns
    -------
    matplotlib.figure.Figure
    """
    rows = -(-len(panels) // columns)
    figure = new_figure(15, 3.1 * (rows + 1) + 0.6, title)
    grid = figure.add_gridspec(
        rows + 1,
        columns,
        height_ratios=(*(1,) * rows, 1.25),
        hspace=0.5,
        wspace=0.27,
        left=0.05,
        right=0.99,
        bottom=0.3 / (rows + 1),
        top=1.0 - 0.26 / (rows + 1),
    )
    for number, (letter, name) in enumerate(panels):
        axes = figure.add_subplot(grid[number // columns, number % columns])
        _draw_bands(axes, dataset, name, cases)
        axes.set_title(f"({letter}) {DISPLAY[name].name}", fontsize=10, loc="left")
    axes = figure.add_subplot(grid[rows, :])
    draw_sum(axes, dataset, cases)
    letter = chr(ord(max(letter for letter, _ in panels)) + 1)
    axes.set_title(
        f"({letter}) sum of errors: upper envelope over the runs, mean over seeds ± sd", fontsize=10, loc="left"
    )
    return figure


def _draw_bands(axes: Axes, dataset: xr.Dataset, name: str, cases: Sequence[str]) -> None:
    control = name in CONTROLS
    kind, along = ("command", "control") if control else ("error", "state")
    times = dataset["time"].values
    for place, case in enumerate(cases):
        low, high = (
            shown(name, dataset[f"{kind}_{edge}"].sel({"case": case, along: name}).values) for edge in ("low", "high")
        )
        colour, dashes = COLOURS[place], DASHES[place]
        if control:
            # A control is held over its beat: the last value is drawn up to the end of the last beat.
            low, high = np.append(low, low[-1]), np.append(high, high[-1])
        step: Any = "post" if control else None
        axes.fill_between(times, low, high, step=step, color=colour, alpha=0.22, linewidth=0)
        for edge in (low, high):
            style = "steps-post" if control else "default"
            axes.plot(times, edge, color=colour, linestyle=dashes, linewidth=1.0, drawstyle=style)
    if control:
        nominal = shown(name, dataset["nominal_control"].sel(control=name).values)
        axes.step(times, np.append(nominal, nominal[-1]), where="post", color="#333333", linewidth=0.9)
        tidy(axes, DISPLAY[name].label)
    else:
        axes.axhline(0.0, color="#333333", linewidth=0.8)
        tidy(axes, f"error in {DISPLAY[name].label}")


def draw_sum(axes: Axes, dataset: xr.Dataset, cases: Sequence[str]) -> None:
    """Draw the sum of errors (Eq. 18) of cases over time."""
    times = dataset["time"].values
    for place, case in enumerate(cases):
        upper = dataset["upper_metric"].sel(case=case).values
        mean, deviation = upper.mean(axis=0), upper.std(axis=0)
        label = f"{case} (mean over time {upper.mean():.3f})"
        axes.plot(times, mean, color=COLOURS[place], linestyle=DASHES[place], linewidth=1.7, label=label)
        axes.fill_between(times, mean - deviation, mean + deviation, color=COLOURS[place], alpha=0.15, linewidth=0)
    axes.set_ylim(0.0, 1.25 * axes.get_ylim()[1])
    tidy(axes, "error, Eq. 18 (deg)")
    axes.legend(fontsize=9, frameon=False, ncols=3, loc="upper right")
