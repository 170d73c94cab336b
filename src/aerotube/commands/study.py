"""The paper's experiments."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from aerotube.commands.common import FAILED, FINE, NOTHING, Interrupted, interruptible, progress
from aerotube.studies import STUDIES


def study(
    names: Annotated[list[str], typer.Argument(metavar="NAME...", help=f"all, or among: {', '.join(STUDIES)}.")],
    runs: Annotated[int | None, typer.Option(help="Runs per seed and case; 100 without it.")] = None,
    seeds: Annotated[int | None, typer.Option(help="Number of seeds; 30 without it.")] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="The folder to write to.")] = Path("out/studies"),
    workers: Annotated[int | None, typer.Option(min=1, help="Threads that solve; as many as cores without it.")] = None,
) -> None:
    """Do the paper's experiments, and set our figures beside the paper's.

    Writes a folder for each study (data.nc, figure.png, table.csv) as it ends, and gathers all that the out folder
    has in studies.json and studies.html.
    """
    with interruptible(NOTHING), progress() as tell:
        from aerotube.studies import job

        done = job.run(names, out, runs=runs, seeds=seeds, workers=workers or os.cpu_count() or 1, progress=tell)
    for name, verdict in done.verdicts.items():
        typer.echo(f"{name} ({done.seconds[name]:.0f} s): {verdict}")
    if done.verdicts or not done.interrupted:
        typer.echo(f"Report: {out / 'studies.html'}")
    for problem in done.problems:
        typer.echo(f"aerotube: {problem}", err=True)
    if done.interrupted and not done.verdicts:
        raise Interrupted(NOTHING)
    if done.interrupted:
        raise Interrupted(f"interrupted; the studies that were finished are in {out}")
    raise typer.Exit(FAILED if done.problems else FINE)
