"""The counterpart of Fig. 7: aerodynamic coefficients over angle of attack."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from aerotube.report.style import new_figure, tidy

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

PANELS = {
    "Longitudinal: β = 0, q = 0, δe = 0": {"CD": "C_D", "CL": "C_L", "Cm": "C_m"},
    "Lateral: β = 5°, p = r = 0, δa = δr = 0": {"CY": "C_Y", "Cl": "C_l", "Cn": "C_n"},
}
_COLOURS = ("#0072B2", "#D55E00", "#009E73")
_STYLES = ("solid", (0, (5, 2)), (0, (1, 1.2)))


def coefficients_figure(dataset: xr.Dataset) -> Figure | None:
    """Draw the coefficients of a dataset.

    Parameters
    ----------
    dataset : xarray.Dataset

    Returns
    -------
    matplotlib.figure.Figure or None
        None if the dataset has no coefficients.
    """
    if "coefficient_alpha" not in dataset:
        return None
    alpha = np.degrees(dataset["coefficient_alpha"].values)
    figure = new_figure(10, 4, "Aerodynamic coefficients of the aircraft flown")
    figure.subplots_adjust(left=0.065, right=0.99, bottom=0.12, top=0.85, wspace=0.17)
    for axes, letter, (title, names) in zip(figure.subplots(1, 2), "ab", PANELS.items(), strict=True):
        for (name, symbol), colour, style in zip(names.items(), _COLOURS, _STYLES, strict=True):
            values = dataset[f"coefficient_{name}"].values
            axes.plot(alpha, values, color=colour, linestyle=style, label=f"${symbol}$")
        tidy(axes, "coefficient (–)", time=False)
        axes.set_xlabel("angle of attack α (deg)", fontsize=9)
        axes.set_title(f"({letter}) {title}", fontsize=10, loc="left")
        axes.axhline(0.0, color="#999999", linewidth=0.8)
        axes.legend(fontsize=9, frameon=False)
    return figure
