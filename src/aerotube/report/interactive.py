"""Figures to turn and to read off, for the page: plotly, its script embedded once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from aerotube.report.style import COLOURS, flown
from aerotube.report.tubes import PAIRS, Projection, projection
from aerotube.results import CONDITION_WORDS, CONTROLLER_WORDS
from aerotube.units import DISPLAY

if TYPE_CHECKING:
    import xarray as xr

# The page stays offline: no button that sends data away, under either of the names it has had.
_CONFIG = {
    "displaylogo": False,
    "responsive": True,
    "showSendToCloud": False,
    "modeBarButtonsToRemove": ["sendChartToCloud", "sendDataToCloud"],
}
_PLOTLY_DASHES = {"none": "dash", "compensated": "solid", "lqr": "dot"}


def plotly_script() -> str:
    """Return plotly's own script, to be put into a page once."""
    from plotly.offline import get_plotlyjs

    return str(get_plotlyjs())


def _as_html(figure: Any, name: str) -> str:
    return str(figure.to_html(full_html=False, include_plotlyjs=False, config=_CONFIG, div_id=name))


def tubes_html(dataset: xr.Dataset, law: str) -> str:
    """Draw the four projections of the tubes of one law, to be turned.

    Parameters
    ----------
    dataset : xarray.Dataset
        With tubes.
    law : str

    Returns
    -------
    str
        An HTML element.
    """
    from plotly.subplots import make_subplots

    titles = [
        f"({letter}) {DISPLAY[a].name} and {DISPLAY[b].name}" for letter, (a, b) in zip("abcd", PAIRS, strict=True)
    ]
    figure = make_subplots(
        rows=2,
        cols=2,
        specs=[[{"type": "scene"}] * 2] * 2,
        subplot_titles=titles,
        horizontal_spacing=0.02,
        vertical_spacing=0.05,
    )
    scenes = {}
    for number, pair in enumerate(PAIRS):
        tube = projection(dataset, law, pair)
        for which, controller, opacity in (("nominal", "none", 0.25), ("terminal", "compensated", 0.6)):
            surface = _surface(tube, which, controller, opacity, pair, first=number == 0)
            figure.add_trace(surface, row=1 + number // 2, col=1 + number % 2)
        scenes["scene" if number == 0 else f"scene{number + 1}"] = {
            "xaxis": {"title": {"text": "time (s)"}},
            "yaxis": {"title": {"text": DISPLAY[pair[0]].label}},
            "zaxis": {"title": {"text": DISPLAY[pair[1]].label}},
            "aspectmode": "manual",
            "aspectratio": {"x": 1.7, "y": 1.0, "z": 1.0},
            "camera": {"eye": {"x": 1.1, "y": -2.05, "z": 0.8}, "center": {"x": 0.0, "y": 0.0, "z": -0.1}},
        }
    figure.update_layout(
        height=820,
        margin={"l": 0, "r": 0, "t": 50, "b": 0},
        legend={"orientation": "h", "y": 1.06, "yanchor": "bottom", "x": 0.0},
        font={"size": 12},
        **scenes,
    )
    return _as_html(figure, "interactive-tubes")


def _surface(tube: Projection, which: str, controller: str, opacity: float, pair: tuple[str, str], first: bool) -> Any:
    from plotly.graph_objects import Surface

    ellipses = tube.ellipses(which, points=33)
    times = np.broadcast_to(tube.times[:, None], ellipses.shape[:2])
    colour = COLOURS[controller]
    a, b = (DISPLAY[name] for name in pair)
    # Five digits are more than a screen shows, and keep the page small.
    x, y, z = (np.round(part, 5) for part in (times, ellipses[..., 0], ellipses[..., 1]))
    return Surface(
        x=x.tolist(),
        y=y.tolist(),
        z=z.tolist(),
        surfacecolor=np.zeros(x.shape).tolist(),
        colorscale=[[0, colour], [1, colour]],
        showscale=False,
        opacity=opacity,
        name=CONTROLLER_WORDS[controller],
        legendgroup=controller,
        showlegend=first,
        hovertemplate=f"t = %{{x:.2f}} s<br>{a.symbol} = %{{y:.3f}} {a.unit}<br>{b.symbol} = %{{z:.3f}} {b.unit}",
    )


def errors_html(dataset: xr.Dataset, conditions: list[str]) -> str:
    """Draw the sum of errors of every controller, one panel a condition, to be read off.

    Parameters
    ----------
    dataset : xarray.Dataset
    conditions : list of str
        Flown; at least one.

    Returns
    -------
    str
        An HTML element.
    """
    from plotly.graph_objects import Scatter
    from plotly.subplots import make_subplots

    titles = [CONDITION_WORDS[name] for name in conditions]
    figure = make_subplots(
        rows=1, cols=len(conditions), shared_yaxes=True, subplot_titles=titles, horizontal_spacing=0.02
    )
    times = np.round(dataset["time"].values, 5).tolist()
    curves = (("upper_metric", "largest of the runs", 2.5), ("mean_metric", "mean of the runs", 1.0))
    named: set[tuple[str, str]] = set()
    for column, condition in enumerate(conditions, start=1):
        for controller in flown(dataset, condition):
            for variable, words, width in curves:
                values = dataset[variable].sel(controller=controller, condition=condition).mean("seed").values
                trace = Scatter(
                    x=times,
                    y=np.round(values, 5).tolist(),
                    mode="lines",
                    line={"color": COLOURS[controller], "dash": _PLOTLY_DASHES[controller], "width": width},
                    name=f"{CONTROLLER_WORDS[controller]}, {words}",
                    legendgroup=f"{controller} {variable}",
                    showlegend=(controller, variable) not in named,
                    hovertemplate="%{y:.3f}",
                )
                named.add((controller, variable))
                figure.add_trace(trace, row=1, col=column)
    figure.update_xaxes(title_text="time (s)")
    figure.update_yaxes(rangemode="tozero")
    figure.update_yaxes(title_text="error, Eq. 18 (deg)", col=1)
    figure.update_layout(
        height=430,
        margin={"l": 60, "r": 10, "t": 60, "b": 50},
        hovermode="x unified",
        template="plotly_white",
        legend={"orientation": "h", "y": -0.2},
        font={"size": 12},
    )
    return _as_html(figure, "interactive-errors")
