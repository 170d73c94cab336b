"""How close a search came to breaking each tube, in a figure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from aerotube.flight import FORMS
from aerotube.report.style import COLOURS, legend, new_figure, tidy
from aerotube.results.falsified import FORM_WORDS, Attack

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PARTS = (("#0072B2", "o"), ("#009E73", "s"))


def tightness_figure(attacks: Mapping[str, Attack]) -> Figure:
    """Draw the ratio of the worst found to the bound over the beats, a column for each law, a row for each shape.

    Parameters
    ----------
    attacks : mapping of str to Attack
        By law.

    Returns
    -------
    matplotlib.figure.Figure
    """
    samples = next(iter(attacks.values())).found.samples
    title = f"Falsification: the largest size found over the tube's ({samples:,} random points a tube, and ascents)"
    figure = new_figure(15, 7.5, title)
    grid = figure.add_gridspec(2, len(attacks), hspace=0.34, wspace=0.16, left=0.055, right=0.99, bottom=0.13, top=0.89)
    for column, (law, attack) in enumerate(attacks.items()):
        beats = np.arange(len(attack.certificate))
        for row, form in enumerate(FORMS):
            axes = figure.add_subplot(grid[row, column])
            axes.axhline(1.0, color=COLOURS["nominal"], linewidth=0.9, label="the tube")
            for index, part in enumerate(attack.found.parts):
                colour, marker = _PARTS[index % 2]
                ratio = attack.found.ratio[:, index, row]
                axes.plot(beats, ratio, color=colour, marker=marker, markersize=3.5, linewidth=0.9, label=part)
            broken = np.argwhere(attack.found.broken[:, :, row])
            places, heights = broken[:, 0], attack.found.ratio[broken[:, 0], broken[:, 1], row]
            if len(places):
                axes.plot(places, heights, "x", color=COLOURS["none"], markersize=8, label="broken")
            kinds = ", ".join(sorted({str(kind) for kind in attack.certificate.ravel()}))
            axes.set_title(f"{law.replace('_', '-')} law, {FORM_WORDS[form]} ({kinds})", fontsize=10, loc="left")
            finite = attack.found.ratio[:, :, row][np.isfinite(attack.found.ratio[:, :, row])]
            if finite.size and finite.max() > 3.0:
                axes.set_yscale("log")
            else:
                axes.set_ylim(0.95 * finite.min(initial=1.0), 1.03 * finite.max(initial=1.0))
            tidy(axes, "worst found / bound", time=False)
            axes.set_xlabel("beat", fontsize=9)
    legend(figure, columns=4)
    return figure
