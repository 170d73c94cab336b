"""The page of all studies: one file that opens offline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from aerotube import __version__
from aerotube.report.template import fill, picture

_ROUNDING = 1e-9  # what is smaller is shown as zero


def build_page(finished: Sequence[Mapping[str, Any]], folder: Path) -> str:
    """Build the page.

    Parameters
    ----------
    finished : sequence of mapping
        Descriptions of studies, as their ``study.json`` hold them.
    folder : Path
        Holds each study's folder with its ``figure.png``.

    Returns
    -------
    str
        HTML.
    """
    sections = [(one["name"], one["title"], _section(one, folder)) for one in finished]
    overview = "".join(
        f'<tr><td class="w"><a href="#{one["name"]}">{escape(one["title"])}</a></td>'
        f"<td>{escape(one['verdict'])}</td></tr>"
        for one in finished
    )
    head = ("overview", "All studies in a line each", f"<table>{overview}</table>" if finished else "")
    return fill(
        title="The paper's figures and ours",
        lead=(
            "What “Fast Tube-Based Robust Compensation Control for Fixed-Wing UAVs” reports on its own, unpublished "
            "aircraft, and what aerotube gets on the public F-16 with the manoeuvre and disturbances of its Table 2. "
            "The aircraft differ, so the sizes of errors do; what can be compared is how much each technique changes."
        ),
        sections=[head, *sections],
        version=__version__,
    )


def _section(one: Mapping[str, Any], folder: Path) -> str:
    seeds = one["seeds"]
    notes = "".join(f"<li>{escape(note)}</li>" for note in one["notes"])
    return (
        f"<p><b>{escape(one['verdict'])}</b></p>"
        f"{_compared(one['compared'])}"
        f"{picture(folder / one['name'] / 'figure.png', one['caption'])}"
        f"{''.join(_table(table) for table in one['tables'])}"
        + (f"<ul>{notes}</ul>" if notes else "")
        + f'<p class="lead">Seeds {seeds[0]} to {seeds[-1]}, {one["runs_per_seed"]} runs each; {one["workers"]} '
        f"worker(s), {one['seconds']:g} s; {escape(one['created'])}, aerotube {escape(one['aerotube_version'])}. "
        f"Data: <code>{escape(one['name'])}/data.nc</code>, table: <code>{escape(one['name'])}/table.csv</code>.</p>"
    )


def _compared(rows: Sequence[Mapping[str, Any]]) -> str:
    # Where the paper gives no numbers there is nothing to put in their columns.
    beside = any(row["paper"] is not None for row in rows)

    def numbers(row: Mapping[str, Any]) -> str:
        told = (_number(row["paper"]), _with_spread(row), _number(row["ratio"])) if beside else (_with_spread(row),)
        return "".join(f'<td class="n">{one}</td>' for one in told)

    cells = "".join(
        f"<tr><td>{escape(row['words'])}</td><td>{escape(row['unit'])}</td>{numbers(row)}"
        f"<td>{escape(row['verdict'])}</td></tr>"
        for row in rows
    )
    heads = ("the paper", "ours", "ratio") if beside else ("ours",)
    head = "".join(f'<th class="n">{words}</th>' for words in heads)
    return f'<div class="scroll"><table><tr><th></th><th>unit</th>{head}<th></th></tr>{cells}</table></div>'


def _table(table: Mapping[str, Any]) -> str:
    head = "".join(f"<th>{escape(word)}</th>" for word in table["head"])
    rows = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in table["rows"])
    return (
        f"<details open><summary>{escape(table['title'])}</summary>"
        f'<div class="scroll"><table><tr>{head}</tr>{rows}</table></div></details>'
    )


def _with_spread(row: Mapping[str, Any]) -> str:
    ours = _number(row["ours"])
    return ours if row["ours_sd"] is None else f"{ours} ± {_number(row['ours_sd'], 2)}"


def _number(value: float | None, digits: int = 3) -> str:
    if value is None:
        return "–"
    if abs(value) < _ROUNDING:
        return "0"
    if 1e-5 <= abs(value) < 1e5:
        places = max(0, digits - 1 - _magnitude(value))
        return f"{value:.{places}f}"
    return f"{value:.{digits - 1}e}"


def _magnitude(value: float) -> int:
    """Place of the first digit: 0 for 1 to 9.99."""
    return 0 if value == 0.0 else int(f"{abs(value):e}".split("e")[1])
