"""The main job."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import typer

from aerotube.commands.common import FAILED, FINE, NOTHING, Interrupted, interruptible, progress


def run(
    scenario: Annotated[
        Path | None, typer.Argument(help="A scenario file, as `aerotube init` writes one; Table 2 without it.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="The folder to write to.")] = Path("out"),
    runs: Annotated[int | None, typer.Option(help="Runs per seed.")] = None,
    seeds: Annotated[int | None, typer.Option(help="Number of seeds.")] = None,
    noise: Annotated[
        float | None,
        typer.Option(
            metavar="SHARE",
            help="Sensor noise as a share of the disturbance box: 1 is all of it, 0 leaves the noisy flights out.",
        ),
    ] = None,
    estimator: Annotated[
        bool | None, typer.Option("--estimator/--no-estimator", help="Fly every law once more with a state estimator.")
    ] = None,
    gusts: Annotated[
        str | None, typer.Option(metavar="SEVERITY", help="Dryden turbulence: none, light, moderate or severe.")
    ] = None,
    horizon: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Length of the manoeuvre, a whole number of beats.")
    ] = None,
    algorithm: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="decoupled (two halves of four states) or coupled (all eight at once)."),
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Threads that solve; as many as cores without it.")] = None,
    certificates: Annotated[
        bool, typer.Option("--certificates", help="Write every tube's certificate too, for `aerotube check`.")
    ] = False,
) -> None:
    """Fly a scenario with and without compensation, and with LQR, and write results and a report.

    Writes results.nc (all data, labelled), summary.json, figures/ and report.html to the out folder. The options
    overrule the scenario file; what is not given is the scenario's (`aerotube init` shows the built-in one's values).
    """
    asked: dict[str, Any] = {
        "draws.runs": runs,
        "draws.seeds": seeds,
        "flight.noise": None if noise is None else f"{100 * noise!r} %",
        "flight.estimator": estimator,
        "flight.gusts": gusts,
        "nominal.horizon": None if horizon is None else f"{horizon!r} s",
        "synthesis.algorithm": algorithm,
    }
    given = {key: value for key, value in asked.items() if value is not None}
    typed = {
        "draws.runs": f"--runs {runs}",
        "draws.seeds": f"--seeds {seeds}",
        "flight.noise": f"--noise {noise:g}" if noise is not None else "",
        "flight.gusts": f"--gusts {gusts}",
        "nominal.horizon": f"--horizon {horizon:g}" if horizon is not None else "",
        "synthesis.algorithm": f"--algorithm {algorithm}",
    }
    with interruptible(NOTHING), progress() as tell:
        from aerotube import job
        from aerotube.scenario import load

        source = load(scenario, given, {key: words for key, words in typed.items() if key in given})
        summary = job.run(source, out, workers or os.cpu_count() or 1, tell, certificates)
    _print_summary(summary, out)
    raise typer.Exit(_exit_code(summary, out))


def _print_summary(summary: dict[str, Any], out: Path) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    from aerotube.report.words import certificate_lines, change_words, containment_lines, margin_lines
    from aerotube.results import CONTROLLER_WORDS, KEY_SUFFIX

    console = Console(highlight=False)
    table = Table(title="Mean upper error (Eq. 18, deg), mean over seeds ± sd", title_justify="left", box=SIMPLE_HEAD)
    table.add_column("", no_wrap=True)
    shown = {c: s for c, s in KEY_SUFFIX.items() if summary[f"mean_upper_error{s}"]["none"]["mean"] is not None}
    for condition in shown:
        table.add_column(condition, justify="right", no_wrap=True)
    for controller, words in CONTROLLER_WORDS.items():
        table.add_row(words, *(_spread(summary[f"mean_upper_error{s}"][controller]) for s in shown.values()))
    table.add_section()
    for key, words in (("reduction", "change (%)"), ("lqr_reduction", "change by LQR (%)")):
        table.add_row(words, *(change_words(summary[f"{key}{s}"]) for s in shown.values()))
    if shown:
        console.print(table)
    solve = summary["solve_ms"]
    if solve["median"] is not None:
        console.print(
            f"{summary['seeds']} seed(s) of {summary['runs_per_seed']} run(s), {summary['horizon_s']:g} s; "
            f"{summary['feasible_beats']} of {summary['beats']} beats feasible; one program takes "
            f"{solve['median']:.1f} ms (median), {solve['p99']:.1f} ms (99th percentile)",
            soft_wrap=True,
        )
    for line in (*certificate_lines(summary), *margin_lines(summary), *containment_lines(summary)):
        console.print(line, soft_wrap=True)
    console.print(f"Report: {out / 'report.html'}", soft_wrap=True)


def _spread(value: dict[str, float | None]) -> str:
    if value["mean"] is None:
        return "–"
    return f"{value['mean']:.3f}" if value["sd"] is None else f"{value['mean']:.3f} ± {value['sd']:.3f}"


def _exit_code(summary: dict[str, Any], out: Path) -> int:
    from aerotube.report.words import worse_words

    worse = worse_words(summary)
    if worse:
        typer.echo(f"aerotube: warning: {worse}", err=True)
    problems = summary["problems"]
    for problem in problems[:10]:
        typer.echo(f"aerotube: {problem}", err=True)
    if len(problems) > 10:
        typer.echo(f"aerotube: and {len(problems) - 10} more failures; all are in {out / 'summary.json'}", err=True)
    if summary["interrupted"]:
        raise Interrupted(f"interrupted; the parts that were finished are in {out}")
    return FAILED if problems else FINE
