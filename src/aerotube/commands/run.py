"""The main job."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from aerotube.commands.common import FAILED, FINE, INTERRUPTED, interruptible, progress


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
    overrule the scenario file.
    """
    from aerotube import job
    from aerotube.scenario import load

    asked: dict[str, Any] = {
        "draws.runs": runs,
        "draws.seeds": seeds,
        "flight.noise": None if noise is None else f"{100 * noise!r} %",
        "flight.estimator": estimator,
        "flight.gusts": gusts,
        "nominal.horizon": None if horizon is None else f"{horizon!r} s",
        "synthesis.algorithm": algorithm,
    }
    with interruptible(), progress() as tell:
        source = load(scenario, {key: value for key, value in asked.items() if value is not None})
        summary = job.run(source, out, workers or os.cpu_count() or 1, tell, certificates)
    _print_summary(summary, out)
    raise typer.Exit(_exit_code(summary, out))


def _print_summary(summary: dict[str, Any], out: Path) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    from aerotube.results import CONTROLLER_WORDS, KEY_SUFFIX

    console = Console(highlight=False)
    table = Table(title="Mean upper error (Eq. 18, deg), mean over seeds ± sd", title_justify="left", box=SIMPLE_HEAD)
    table.add_column("", no_wrap=True)
    shown = {c: s for c, s in KEY_SUFFIX.items() if summary[f"mean_upper_error{s}"]["none"]["mean"] is not None}
    for condition in shown:
        table.add_column(condition, justify="right", no_wrap=True)
    for controller, words in CONTROLLER_WORDS.items():
        table.add_row(words, *(_spread(summary[f"mean_upper_error{s}"][controller], 1.0, 3) for s in shown.values()))
    table.add_section()
    for key, words in (("reduction", "reduction (%)"), ("lqr_reduction", "reduction by LQR (%)")):
        table.add_row(words, *(_spread(summary[f"{key}{s}"], 100.0, 1) for s in shown.values()))
    if shown:
        console.print(table)
    solve = summary["solve_ms"]
    if solve["median"] is not None:
        console.print(
            f"{summary['seeds']} seeds of {summary['runs_per_seed']} runs, {summary['horizon_s']:g} s; "
            f"{summary['feasible_beats']} of {summary['beats']} beats feasible; one program takes "
            f"{solve['median']:.1f} ms (median), {solve['p99']:.1f} ms (99th percentile)",
            soft_wrap=True,
        )
    for line in (*_margin_lines(summary), *_containment_lines(summary)):
        console.print(line, soft_wrap=True)
    console.print(f"Report: {out / 'report.html'}", soft_wrap=True)


def _margin_lines(summary: dict[str, Any]) -> Iterator[str]:
    """The worst margins of every law over the beats, in words."""
    from aerotube.report.assurance import delay_words, gain_words

    for law, facts in summary["laws"].items():
        margins = facts["margins"]
        words = f"{law.replace('_', '-')} law, worst margins of the frozen loops: "
        if margins is None:
            continue
        if margins["all"] is None:
            yield words + "none, as no loop is stable by itself"
            continue
        single = {name: worst for name, worst in margins.items() if isinstance(worst, dict) and name != "all"}
        name = min(single, key=lambda control: single[control]["disk"])
        told = (f"{name} alone", single[name]), ("all controls at once", margins["all"])
        words += "; ".join(
            f"{which} gain {gain_words(worst['gain_db'])}, phase ±{worst['phase_deg']:.0f}° (beat {worst['at_beat']}), "
            f"delay {delay_words(worst)}"
            for which, worst in told
        )
        unstable = margins["unstable_beats"]
        yield words + (f"; beats not stable by themselves: {unstable}" if unstable else "")


def _containment_lines(summary: dict[str, Any]) -> Iterator[str]:
    """How flights kept to their tubes, in words."""
    for condition, found in summary["containment"].items():
        beats, inside = found["beats"], found["started_inside"]
        violations = ", ".join(f"{name} {count}" for name, count in found["violations"].items() if count) or "none"
        reasons = ", ".join(f"{reason} {count}" for reason, count in found["outside"].items() if count)
        yield (
            f"{condition}: {100.0 * inside / max(beats, 1):.1f} % of {beats} beats started inside the sets of their "
            f"tubes{f' (outside: {reasons})' if reasons else ''}; of these left their tube: {violations}"
        )


def _spread(value: dict[str, float | None], factor: float, digits: int) -> str:
    if value["mean"] is None:
        return "–"
    mean = f"{factor * value['mean']:.{digits}f}"
    return mean if value["sd"] is None else f"{mean} ± {factor * value['sd']:.{digits}f}"


def _exit_code(summary: dict[str, Any], out: Path) -> int:
    problems = summary["problems"]
    for problem in problems[:10]:
        typer.echo(f"aerotube: {problem}", err=True)
    if len(problems) > 10:
        typer.echo(f"aerotube: and {len(problems) - 10} more failures; all are in {out / 'summary.json'}", err=True)
    if summary["interrupted"]:
        typer.echo(f"aerotube: interrupted; the parts that were finished are in {out}", err=True)
        return INTERRUPTED
    return FAILED if problems else FINE
