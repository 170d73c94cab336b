"""Figures and report of a results file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerotube.commands.common import interruptible


def report(
    results: Annotated[Path, typer.Argument(help="A results file, as `aerotube run` writes one.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="The folder to write to; that of the file.")] = None,
) -> None:
    """Draw the figures and the report of a results file again, nothing computed anew."""
    with interruptible():
        from aerotube import report as reports
        from aerotube.results import ensure_folder, read

        dataset = read(results)
        folder = ensure_folder(out or results.parent)
        reports.write(dataset, folder)
    typer.echo(f"{folder / 'report.html'} written")
