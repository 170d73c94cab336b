"""The counterpart of Fig. 8: trajectory tubes projected on pairs of states over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from aerotube.report.style import COLOURS, Array, new_figure, tidy
from aerotube.report.words import certificate_words
from aerotube.results import CONTROLLER_WORDS
from aerotube.units import DISPLAY

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: The pairs of the paper's four projections, (a) to (d).
PAIRS = (("alpha", "q"), ("V", "theta"), ("beta", "r"), ("phi", "p"))


HOW_TO_READ = (
    "A beat starts from an ellipsoid around the disturbance set (around a box of n errors up to √n times as wide). The "
    "law makes the size in the metric of cost small: half-widths of single errors may grow while that size shrinks."
)


@dataclass(frozen=True)
class Projection:
    """A tube projected on two states, in the units in which they are shown.

    Attributes
    ----------
    times : ndarray (beat,)
        End of each beat, s.
    initial, terminal, nominal : ndarray (beat, 2, 2)
        P of the ellipses ``{x : x' P^-1 x <= 1}``: the disturbance set at the start of a beat, and what it
        has become at the end of the beat with the law and without.
    """

    times: Array
    initial: Array
    terminal: Array
    nominal: Array

    def ellipses(self, which: str, points: int = 48) -> Array:
        """Boundaries of one kind of ellipse: ndarray (beat, points, 2)."""
        angle = np.linspace(0.0, 2.0 * np.pi, points)
        circle = np.stack([np.cos(angle), np.sin(angle)])
        P: Array = getattr(self, which)
        # The square root of a 2 x 2 matrix in closed form: of a degenerate or missing ellipse too.
        a, b, c = (P[:, i, j, None, None] for i, j in ((0, 0), (0, 1), (1, 1)))
        scale, trace = np.sqrt(np.maximum(a * c - b * b, 0.0)), a + c
        root = (P + scale * np.eye(2)) / np.sqrt(np.maximum(trace + 2.0 * scale, np.finfo(float).tiny))
        boundary: Array = np.swapaxes(root @ circle, -1, -2)
        return boundary

    def half_extent(self, which: str, state: int) -> Array:
        """Half the extent of the ellipses along one of the two states: ndarray (beat,)."""
        extent: Array = np.sqrt(getattr(self, which)[:, state, state])
        return extent


def projection(dataset: xr.Dataset, law: str, pair: tuple[str, str]) -> Projection:
    """Project the tubes of one law on two states of the same part.

    Parameters
    ----------
    dataset : xarray.Dataset
    law : str
    pair : tuple of str
        Names of two error states.

    Returns
    -------
    Projection
        The projection of ``{x : x'Ex <= rho}`` on some components is the ellipse of that block of
        ``rho E^-1``.
    """
    tubes = dataset.sel(law=law)
    states = [list(row) for row in tubes["part_state"].values]
    part = next(i for i, row in enumerate(states) if pair[0] in row and pair[1] in row)
    index = [states[part].index(name) for name in pair]
    factors = np.array([DISPLAY[name].factor for name in pair])

    def block(kind: str) -> Array:
        inverse = np.linalg.inv(tubes[f"{kind}_shape"].values[:, part])
        cover = tubes[f"{kind}_rho"].values[:, part, None, None] * inverse
        chosen: Array = cover[:, index][:, :, index] * np.outer(factors, factors)
        return chosen

    return Projection(
        times=tubes["time"].values[1:],
        initial=block("initial"),
        terminal=block("terminal"),
        nominal=block("nominal"),
    )


def tubes_figure(dataset: xr.Dataset, law: str) -> Figure | None:
    """Draw the tubes of one law with and without compensation.

    Parameters
    ----------
    dataset : xarray.Dataset
    law : str

    Returns
    -------
    matplotlib.figure.Figure or None
        None if the dataset has no tubes.
    """
    if "law" not in dataset.dims:
        return None
    kinds, numbers = np.unique(dataset["certificate"].sel(law=law).values, return_counts=True)
    counts = {str(kind): int(number) for kind, number in zip(kinds, numbers, strict=True)}
    title = (
        "Trajectory tubes about the nominal: the error one beat after the disturbance set "
        f"({law.replace('_', '-')} law)\ncertificate: {certificate_words(counts)}"
    )
    figure = new_figure(16, 10, title)
    grid = figure.add_gridspec(4, 2, left=0.63, right=0.99, bottom=0.12, top=0.9, hspace=0.52, wspace=0.34)
    for number, pair in enumerate(PAIRS):
        tube = projection(dataset, law, pair)
        corner = (0.283 * (number % 2), 0.5 - 0.45 * (number // 2), 0.265, 0.39)
        _draw_surface(figure.add_axes(corner, projection="3d"), tube, pair, "abcd"[number])
        for column, name in enumerate(pair):
            axes = figure.add_subplot(grid[number, column])
            _draw_extent(axes, tube, column, name)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=3, fontsize=10, frameon=False)
    figure.text(0.5, 0.04, HOW_TO_READ, ha="center", fontsize=9, color="#555555")
    return figure


def _draw_surface(axes: Any, tube: Projection, pair: tuple[str, str], letter: str) -> None:
    from matplotlib.ticker import MaxNLocator

    # The inner tube first, the outer one as a veil with rings over it: matplotlib cannot sort the two by depth.
    axes.computed_zorder = False
    for which, controller, alpha in (("terminal", "compensated", 0.9), ("nominal", "none", 0.15)):
        ellipses = tube.ellipses(which)
        times = np.broadcast_to(tube.times[:, None], ellipses.shape[:2])
        surface = (times, ellipses[..., 0], ellipses[..., 1])
        colour = COLOURS[controller]
        axes.plot_surface(*surface, color=colour, alpha=alpha, linewidth=0, rstride=1, cstride=2)
        rings = max(1, len(tube.times) // 12)
        axes.plot_wireframe(*surface, color=colour, alpha=0.7, linewidth=0.6, rstride=rings, cstride=0)
    first, second = (DISPLAY[name] for name in pair)
    axes.set_xlabel("time (s)", fontsize=9, labelpad=6)
    axes.set_ylabel(f"error in {first.label}", fontsize=9, labelpad=2)
    axes.set_zlabel(f"error in {second.label}", fontsize=9, labelpad=0)
    for axis in (axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(5))
    axes.tick_params(labelsize=8, pad=1)
    axes.set_title(f"({letter}) {first.name} and {second.name}", fontsize=10, y=0.98)
    axes.view_init(elev=20, azim=-55)
    axes.set_box_aspect((1.6, 1.0, 1.0), zoom=1.0)


def _draw_extent(axes: Axes, tube: Projection, state: int, name: str) -> None:
    styles = (
        ("nominal", COLOURS["none"], (0, (5, 2)), CONTROLLER_WORDS["none"]),
        ("terminal", COLOURS["compensated"], "solid", CONTROLLER_WORDS["compensated"]),
        ("initial", "#777777", (0, (1, 1.2)), "start of the beat"),
    )
    for which, colour, dashes, label in styles:
        axes.plot(tube.times, tube.half_extent(which, state), color=colour, linestyle=dashes, label=label)
    axes.set_ylim(bottom=0.0)
    axes.set_title(f"half-width in {DISPLAY[name].name}", fontsize=9, loc="left")
    tidy(axes, DISPLAY[name].label)
    axes.yaxis.set_label_coords(-0.17, 0.5)  # clear of the widest numbers
