"""Timing the computation of laws, beat by beat, and drawing the distributions."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from aerotube import compensation
from aerotube.compensation import SynthesisSettings
from aerotube.report.style import new_figure
from aerotube.studies.bench import Bench
from aerotube.studies.flown import COLOURS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: Solves of each kind, as in the paper.
SOLVES = 100


def solve_times(bench: Bench, settings: SynthesisSettings, words: str, solves: int = SOLVES) -> tuple[Array, Array]:
    """Times of single laws, one after the other on one thread.

    Parameters
    ----------
    bench : Bench
    settings : SynthesisSettings
    words : str
        Told while it goes on.
    solves : int
        Laws to time; beats of the manoeuvre in turn.

    Returns
    -------
    solver : ndarray (solves, parts)
        Time in the solver, of each part, s.
    whole : ndarray (solves,)
        Time of the whole command for one beat: expansion, sampling of the map, program data, all parts solved, s.
    """
    ready = bench.prepared
    solver, whole = [], []

    def make(beat: int) -> Any:
        return compensation.design(
            ready.model, ready.nominal, ready.disturbance, settings, beats=range(beat, beat + 1), workers=1
        )

    with threadpool_limits(limits=1):
        make(0)  # compiles, and makes what all beats share
        for number in range(solves):
            start = time.perf_counter()
            made = make(number % ready.nominal.beats)
            whole.append(time.perf_counter() - start)
            solver.append(made.solve_seconds[0])
            bench.tell(words, (number + 1) / solves)
    return np.array(solver), np.array(whole)


def distributions_figure(
    title: str, samples: Mapping[str, Array], columns: int, groups: Sequence[str], counted: str = "solves"
) -> Figure:
    """Draw distributions of times, one panel a group, on logarithmic axes where they span decades.

    Parameters
    ----------
    title : str
    samples : mapping of str to ndarray
        Times in ms; a name starts with its group and a colon.
    columns : int
    groups : sequence of str
    counted : str
        What each time is of.

    Returns
    -------
    matplotlib.figure.Figure
    """
    rows = -(-len(groups) // columns)
    figure = new_figure(5.2 * columns, 3.6 * rows + 0.6, title)
    figure.subplots_adjust(
        left=0.2 / (columns + 1), right=0.985, bottom=0.16 / rows, top=1 - 0.2 / rows, wspace=0.22, hspace=0.45
    )
    panels = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for axes, group in zip(panels, groups, strict=False):
        mine = {name.split(": ", 1)[1]: values for name, values in samples.items() if name.startswith(f"{group}: ")}
        together = np.concatenate(list(mine.values()))
        wide = together.max() > 20 * together.min()
        edges = (
            np.geomspace(together.min() * 0.95, together.max() * 1.05, 50)
            if wide
            else np.linspace(0.95 * together.min(), 1.05 * np.percentile(together, 99), 40)
        )
        for place, (name, values) in enumerate(mine.items()):
            label = f"{name} (median {np.median(values):.3g} ms)"
            axes.hist(values, bins=edges, color=COLOURS[place], alpha=0.6, label=label)
        if wide:
            axes.set_xscale("log")
        axes.set_title(group, fontsize=10, loc="left")
        axes.set_xlabel("time (ms)", fontsize=9)
        axes.set_ylabel(counted, fontsize=9)
        axes.tick_params(labelsize=8)
        axes.grid(True, color="#DDDDDD", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
        axes.margins(y=0.25)
        axes.legend(fontsize=8, frameon=False)
    for axes in panels[len(groups) :]:
        axes.set_visible(False)
    return figure
