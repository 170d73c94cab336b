"""The command line: thin. Every command says in one sentence what the user did wrong, and what failed."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NoReturn, cast

import typer

from aerotube import __version__
from aerotube.commands.common import EPILOG, FAILED, FINE, INTERRUPTED, MISTAKE, Interrupted, interruptible, progress
from aerotube.errors import ComputationError, InputError

cli = typer.Typer(
    name="aerotube",
    help="Trajectory tubes and compensation laws for aircraft, by sum-of-squares programming.",
    epilog=EPILOG,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@cli.callback(invoke_without_command=True)
def _main(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        typer.echo(f"aerotube {__version__}")
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())


@cli.command()
def init(
    file: Annotated[Path, typer.Argument(help="The file to write.")] = Path("scenario.toml"),
    force: Annotated[bool, typer.Option("--force", help="Write over a file that is there.")] = False,
) -> None:
    """Write out the built-in scenario (Table 2), commented, to change and to run.

    Example: aerotube init mine.toml && aerotube run mine.toml
    """
    from aerotube.results import write_text
    from aerotube.scenario import built_in_text

    if file.exists() and not force:
        raise InputError(f"{file} is there already; choose another name, or --force to write over it")
    try:
        write_text(file, built_in_text())
    except OSError as error:
        raise InputError(f"{file} cannot be written ({error.strerror}); choose another name") from None
    typer.echo(f"{file} written; change it, then: aerotube run {file}")


@cli.command(epilog=EPILOG)
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


@cli.command()
def report(
    results: Annotated[Path, typer.Argument(help="A results file, as `aerotube run` writes one.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="The folder to write to; that of the file.")] = None,
) -> None:
    """Draw the figures and the report of a results file again, nothing computed anew."""
    from aerotube import report as reports
    from aerotube.results import ensure_folder, read

    with interruptible():
        dataset = read(results)
        folder = ensure_folder(out or results.parent)
        reports.write(dataset, folder)
    typer.echo(f"{folder / 'report.html'} written")


@cli.command()
def check(
    files: Annotated[list[Path], typer.Argument(help="Certificates, as `aerotube run --certificates` writes them.")],
) -> None:
    """Check saved certificates in exact arithmetic, by code that shares nothing with the solver.

    Exit code 0: every certificate holds; 1: some do not.
    """
    from aerotube.sos import check_file

    sound = True
    with interruptible():
        for file in files:
            try:
                found = check_file(file)
            except OSError as error:
                raise InputError(f"{file} cannot be read ({error.strerror}); check the name") from None
            except ValueError as error:
                raise InputError(str(error)) from None
            sound = sound and found.holds
            typer.echo(f"{file}: " + ("holds" if found.holds else "DOES NOT HOLD") if len(files) > 1 else str(found))
    raise typer.Exit(FINE if sound else FAILED)


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
    console.print(f"Report: {out / 'report.html'}", soft_wrap=True)


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


def app(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and leave the process with its exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the process without it.
    """
    # Typer's own error of the command line, under whatever name it keeps the module it comes from.
    usage_error = cast("type[Exception]", typer.BadParameter.__mro__[2])
    try:
        code = cli(args=arguments, standalone_mode=False, prog_name="aerotube")
    except InputError as error:
        code = _say(error, MISTAKE)
    except ComputationError as error:
        code = _say(error, FAILED)
    except OSError as error:
        code = _say(f"{error.filename or 'a file'} cannot be read or written: {error.strerror or error}", FAILED)
    except (Interrupted, KeyboardInterrupt, typer.Abort):
        code = _say("interrupted before the end; the files that are there are whole", INTERRUPTED)
    except usage_error as error:
        code = _say(f"{error.format_message()} See: aerotube --help", MISTAKE)  # type: ignore[attr-defined]
    sys.exit(code if isinstance(code, int) else FINE)


def _say(sentence: object, code: int) -> int:
    print(f"aerotube: {sentence}", file=sys.stderr)
    return code
