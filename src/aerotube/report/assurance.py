"""What speaks for a law besides its tubes, in figures and words: margins of its loops, and its tubes in flight."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from aerotube.report.style import COLOURS, legend, new_figure, tidy
from aerotube.report.words import delay_words, gain_words, no_promise
from aerotube.results import CONDITION_WORDS
from aerotube.units import DISPLAY

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Colours and line styles of the controls, and of all at once.
_CONTROLS: dict[str, tuple[str, Any]] = {
    "elevator": ("#0072B2", "solid"),
    "throttle": ("#E69F00", (0, (5, 2))),
    "aileron": ("#009E73", (0, (1, 1.2))),
    "rudder": ("#CC79A7", (0, (6, 2, 1, 2))),
}
_ALL = "#333333"
_FORM_WORDS = {"size": "size in the metric", "ellipsoid": "terminal ellipsoid"}


def margins_figure(dataset: xr.Dataset) -> Figure | None:
    """Draw disk and delay margins over the beats, a column for each law; None if the dataset has none."""
    if "disk_margin" not in dataset:
        return None
    laws = [str(name) for name in dataset["law"].values]
    figure = new_figure(15, 7.5, "Margins of each beat's frozen loop: every control alone, and all at once")
    margins = {"left": 0.05, "right": 0.96, "bottom": 0.13, "top": 0.89}
    grid = figure.add_gridspec(2, len(laws), hspace=0.34, wspace=0.22, **margins)
    for column, law in enumerate(laws):
        chosen = dataset.sel(law=law)
        times = chosen["time"].values[:-1]
        disks = figure.add_subplot(grid[0, column])
        delays = figure.add_subplot(grid[1, column], sharex=disks, sharey=figure.axes[1] if column else None)
        for name, (colour, dashes) in _CONTROLS.items():
            style: dict[str, Any] = {"color": colour, "linestyle": dashes, "label": DISPLAY[name].name}
            disks.plot(times, chosen["disk_margin"].sel(control=name), linewidth=1.4, **style)
            delays.plot(times, 1e3 * _finite(chosen["delay_margin"].sel(control=name)), linewidth=1.4, **style)
        disks.plot(times, chosen["disk_margin_all"], color=_ALL, linewidth=2.0, label="all at once")
        delays.plot(times, 1e3 * _finite(chosen["delay_margin_all"]), color=_ALL, linewidth=2.0, label="all at once")
        unstable = np.flatnonzero(chosen["loop_radius"].values >= 1.0)
        if unstable.size:
            disks.plot(times[unstable], 0.0 * unstable, "x", color=COLOURS["none"], label="not stable by itself")
        _finish(disks, delays, chosen["time"].values, law)
    legend(figure, columns=6)
    return figure


def _finish(disks: Axes, delays: Axes, times: np.ndarray, law: str) -> None:
    disks.set_ylim(0.0, 2.05)
    disks.set_title(f"{law.replace('_', '-')} law: disk margin", fontsize=10, loc="left")
    tidy(disks, "disk margin α (–)")
    decibels = disks.secondary_yaxis("right")
    ticks = np.array([0.0, 3.0, 6.0, 10.0, 15.0])
    factor = 10 ** (ticks / 20.0)
    decibels.set_yticks(2.0 * (factor - 1.0) / (factor + 1.0), [f"±{tick:g} dB" for tick in ticks])
    decibels.tick_params(labelsize=7)
    delays.set_yscale("log")
    delays.axhline(1e3 * (times[1] - times[0]), color="#777777", linewidth=0.8)
    delays.set_title("delay margin (grey: one beat; no line: no delay does harm)", fontsize=10, loc="left")
    tidy(delays, "delay (ms)")
    disks.set_xlim(times[0], times[-1])


def _finite(values: Any) -> np.ndarray:
    values = np.asarray(values, dtype=float)
    return np.where(np.isfinite(values) & (values > 0), values, np.nan)


def containment_figure(dataset: xr.Dataset) -> Figure | None:
    """Draw how many runs kept to their tubes over time, a panel for each condition in which tubes promise something.

    None if there is no such condition.
    """
    if "containment_flown" not in dataset:
        return None
    inside = dataset["containment_inside"].sum("beat")
    conditions = [str(name) for name in dataset["condition"].values if int(inside.sel(condition=name))]
    if not conditions:
        return None
    figure = new_figure(15, 4.6, "Tubes in flight: all runs of the compensated aircraft, beat by beat")
    margins = {"left": 0.05, "right": 0.99, "bottom": 0.235, "top": 0.84}
    grid = figure.add_gridspec(1, len(conditions), wspace=0.2, **margins)
    for column, name in enumerate(conditions):
        axes = figure.add_subplot(grid[0, column])
        chosen = dataset.sel(condition=name)
        flown = np.maximum(chosen["containment_flown"].values, 1)
        inside = 100.0 * chosen["containment_inside"].values / flown
        violated = 100.0 * chosen["containment_violated"].values / flown[:, None, None]
        size = violated[..., 0].max(axis=1)
        edges = dataset["time"].values

        def bars(
            low: np.ndarray, high: np.ndarray, colour: str, label: str, edges: Any = edges, at: Any = axes
        ) -> None:
            at.fill_between(edges, _held(low), _held(high), step="post", color=colour, linewidth=0, label=label)

        bars(0 * inside, inside - size, "#9CC9E6", "started inside, and kept to the size of the tube")
        if size.any():
            bars(inside - size, inside, COLOURS["none"], "started inside, and left it")
        if (inside < 100.0).any():
            bars(inside, 0 * inside + 100.0, "#E4E4E4", "started outside")
        for index, part in enumerate(dataset["part"].values):
            if not violated[:, index, 1].any():
                continue
            axes.step(
                edges, _held(violated[:, index, 1]), where="post", color=COLOURS["nominal"], linewidth=1.3,
                linestyle=("solid", (0, (1, 1.2)))[index % 2], label=f"left the terminal ellipsoid, {part}",
            )  # fmt: skip
        axes.set_ylim(0.0, 100.0)
        axes.set_title(CONDITION_WORDS[name], fontsize=10, loc="left")
        tidy(axes, "runs (%)")
        axes.grid(False)
    legend(figure, columns=3)
    return figure


def _held(values: np.ndarray) -> np.ndarray:
    """Values of beats up to the end of the last."""
    return np.append(values, values[-1])


def margins_html(summary: Mapping[str, Any]) -> str:
    """Table of the worst margins of every law, or nothing."""
    rows = []
    for law, facts in summary["laws"].items():
        margins = facts.get("margins")
        if margins is None:
            return ""
        words = escape(law.replace("_", "-"))
        if margins["all"] is None:
            rows.append(f'<tr><td class="w">{words}</td><td colspan="7">no frozen loop is stable by itself</td></tr>')
            continue
        for name in (*_CONTROLS, "all"):
            worst = margins[name]
            told = "all at once" if name == "all" else DISPLAY[name].name
            rows.append(
                f'<tr><td class="w">{words}</td><td class="w">{told}</td><td class="n">{worst["disk"]:.2f}</td>'
                f'<td class="n">{gain_words(worst["gain_db"])}</td><td class="n">±{worst["phase_deg"]:.0f}°</td>'
                f'<td class="n">{worst["at_beat"]}</td><td class="n">{delay_words(worst)}</td>'
                f'<td class="n">{"–" if worst["delay_ms"] is None else worst["delay_at_beat"]}</td></tr>'
            )
            words = ""
        if margins["unstable_beats"]:
            rows.append(
                '<tr><td></td><td colspan="7">beats whose frozen loop is not stable by itself, and has no margin: '
                f"{margins['unstable_beats']}</td></tr>"
            )
    if not rows:
        return ""
    return (
        "<p>The worst over the beats. Each beat's linearised loop is frozen, its control held over the beat; a "
        "balanced disk margin says by how much gain and phase at a control (the other loops closed), or at all "
        "controls at once and independently, may change together before the loop is unstable. The margins of all at "
        "once are lower bounds. A frozen loop says nothing of how the manoeuvre changes it.</p>"
        '<div class="scroll"><table><tr><th>law</th><th>control</th><th class="n">disk margin</th>'
        '<th class="n">gain</th><th class="n">phase</th><th class="n">at beat</th><th class="n">delay</th>'
        '<th class="n">at beat</th></tr>'
        f"{''.join(rows)}</table></div>"
    )


def containment_html(summary: Mapping[str, Any]) -> str:
    """Table of how flights kept to their tubes, or nothing."""
    counted = summary["containment"]
    if not counted:
        return ""
    rows = []
    for condition, found in counted.items():
        why = no_promise(summary, condition)
        if why:
            rows.append(
                f'<tr><td class="w">{escape(CONDITION_WORDS[condition])}</td><td class="n">{found["beats"]}</td>'
                f'<td colspan="5">the tubes promise nothing here: {escape(why)}</td></tr>'
            )
            continue
        share = 100.0 * (1.0 - found["started_inside"] / max(found["beats"], 1))
        reasons = ", ".join(f"{reason} {count}" for reason, count in found["outside"].items() if count) or "none"
        first = (
            f'<td class="w">{escape(CONDITION_WORDS[condition])}</td><td class="n">{found["beats"]}</td>'
            f'<td class="n">{share:.1f} %</td><td>{escape(reasons)}</td>'
        )
        for name, count in found["violations"].items():
            worst = found["worst"][name]
            rows.append(
                f'<tr>{first}<td class="w">{escape(_pair_words(name))}</td><td class="n">{count}</td>'
                f'<td class="n">{"–" if worst is None else f"{worst:.3g}"}</td></tr>'
            )
            first = "<td></td>" * 4
    return (
        "<p>Of the beats of all runs that start inside every set of their tubes (errors of all parts, measurement "
        "error, wind, parameters), those that end outside the tube are violations: tubes that are sampled or rigorous "
        "must have none. What starts outside is promised nothing.</p>"
        '<div class="scroll"><table><tr><th>condition</th><th class="n">beats flown</th>'
        '<th class="n">started outside</th><th>because of</th><th>tube</th><th class="n">violations</th>'
        f'<th class="n">largest size over the tube\'s</th></tr>{"".join(rows)}</table></div>'
    )


def _pair_words(name: str) -> str:
    part, form = name.split(", ")
    return f"{part}, {_FORM_WORDS[form]}"
