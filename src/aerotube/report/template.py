"""The template of every page: one file that opens offline, with its pictures and scripts inside."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from importlib import resources
from pathlib import Path
from string import Template

from aerotube.report import interactive


def fill(
    title: str, lead: str, sections: Sequence[tuple[str, str, str]], version: str, notice: str = "", cards: str = ""
) -> str:
    """Fill the page's template.

    Parameters
    ----------
    title, lead, version : str
        Plain text.
    sections : sequence of (str, str, str)
        Anchor, title (plain text) and body (HTML) of each; those without a body are left out.
    notice, cards : str
        HTML.

    Returns
    -------
    str
        HTML.
    """
    shown = [one for one in sections if one[2]]
    links = "".join(f'<a href="#{name}">{escape(words)}</a>' for name, words, _ in shown)
    bodies = "".join(f'<section id="{name}"><h2>{escape(words)}</h2>{body}</section>' for name, words, body in shown)
    drawn = any("plotly-graph-div" in body for _, _, body in shown)
    template = Template(resources.files("aerotube.report").joinpath("page.html").read_text(encoding="utf-8"))
    return template.substitute(
        version=escape(version),
        title=escape(title),
        lead=escape(lead),
        notice=notice,
        cards=cards,
        sections=f"<nav>{links}</nav>{bodies}",
        script=f"<script>{interactive.plotly_script()}</script>" if drawn else "",
    )


def picture(path: Path, caption: str) -> str:
    """Embed a PNG with its caption (plain text): HTML."""
    data = base64.b64encode(path.read_bytes()).decode()
    words = escape(caption)
    return f'<figure><img alt="{words}" src="data:image/png;base64,{data}"><figcaption>{words}</figcaption></figure>'
