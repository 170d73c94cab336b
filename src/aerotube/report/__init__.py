"""The report of a run: figures (PNG) and one self-contained page (HTML), from its dataset."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from aerotube.report.assurance import containment_figure, margins_figure
from aerotube.report.coefficients import coefficients_figure
from aerotube.report.page import build_page
from aerotube.report.shares import shares_figure
from aerotube.report.tracking import tracking_figure
from aerotube.report.tubes import tubes_figure
from aerotube.results import CALM, ESTIMATOR, NOISE, summarise, whole_file, write_text

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

__all__ = ["build_page", "coefficients_figure", "draw", "tracking_figure", "tubes_figure", "write"]

_DOTS_PER_INCH = 110


def draw(dataset: xr.Dataset, folder: str | Path) -> dict[str, Path]:
    """Draw all figures that a dataset has data for.

    Parameters
    ----------
    dataset : xarray.Dataset
    folder : str or Path
        Made if it is not there.

    Returns
    -------
    dict of str to Path
        The PNG files by name; figures of parts that were not computed are absent.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    law = str(dataset["law"].values[0]) if "law" in dataset.dims else ""
    figures: dict[str, Figure | None] = {
        "fig7_coefficients": coefficients_figure(dataset),
        "fig8_tubes": tubes_figure(dataset, law),
        "tube_shares": shares_figure(dataset),
        "margins": margins_figure(dataset),
        "containment": containment_figure(dataset),
        "fig9_tracking": tracking_figure(dataset, CALM),
        "fig9_tracking_noise": tracking_figure(dataset, NOISE),
        "fig9_tracking_estimator": tracking_figure(dataset, ESTIMATOR),
    }
    files = {}
    for name, figure in figures.items():
        path = folder / f"{name}.png"
        if figure is None:
            path.unlink(missing_ok=True)  # of an earlier run in the same folder
            continue
        with whole_file(path) as aside:
            figure.savefig(aside, format="png", dpi=_DOTS_PER_INCH)
        files[name] = path
    return files


def write(dataset: xr.Dataset, folder: str | Path) -> None:
    """Write ``figures/`` and ``report.html`` into a folder.

    Parameters
    ----------
    dataset : xarray.Dataset
    folder : str or Path
        Exists.
    """
    folder = Path(folder)
    figures = draw(dataset, folder / "figures")
    write_text(folder / "report.html", build_page(dataset, summarise(dataset), figures))
