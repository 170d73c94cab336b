"""``aerotube fly``: a flight against the clock."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from aerotube.commands.common import FAILED, FINE, NOTHING, interruptible
from aerotube.errors import InputError

if TYPE_CHECKING:
    from aerotube.runtime.options import Options


def fly(
    context: typer.Context,
    scenario: Annotated[
        Path | None, typer.Argument(help="A scenario file, as `aerotube init` writes one; Table 2 without it.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="The folder to write to.")] = Path("out/fly"),
    speed: Annotated[
        float,
        typer.Option(metavar="X", help="Seconds of flight for one of the clock; inf: without a clock."),
    ] = 1.0,
    duration: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Repeat the manoeuvre for this long, rounded up to whole manoeuvres; once without it.",
        ),
    ] = None,
    window: Annotated[int, typer.Option(metavar="N", help="Beats of a window of laws.")] = 16,
    on_demand: Annotated[bool, typer.Option("--on-demand", help="Solve each beat during the beat before it.")] = False,
    reuse: Annotated[int, typer.Option(metavar="K", help="Use each law for K more beats.")] = 0,
    algorithm: Annotated[str | None, typer.Option(metavar="NAME", help="decoupled or coupled.")] = None,
    beat: Annotated[float | None, typer.Option(metavar="SECONDS", help="Length of a beat.")] = None,
    estimator: Annotated[bool, typer.Option("--estimator", help="State estimator before the law.")] = False,
    noise: Annotated[
        float | None, typer.Option(metavar="SHARE", help="Sensor noise as a share of the disturbance box.")
    ] = None,
    deviation: Annotated[
        str,
        typer.Option(
            metavar="KIND",
            help="Initial error: the paper's (3 m/s too slow, 0.3 deg of sideslip), or drawn from the box.",
        ),
    ] = "paper",
    gusts: Annotated[
        str | None, typer.Option(metavar="SEVERITY", help="Dryden turbulence: none, light, moderate or severe.")
    ] = None,
    actuators: Annotated[bool, typer.Option("--actuators", help="Lags and rate limits of the surfaces.")] = False,
    delay: Annotated[int, typer.Option(metavar="N", help="Whole beats from a command to its effect.")] = 0,
    replan: Annotated[
        float,
        typer.Option(
            metavar="SHARE",
            help="Move the nominal at every window, by a share of the controls' travel; "
            "with --port another's aircraft is led along it by the commands, and not told.",
        ),
    ] = 0.0,
    event: Annotated[
        float | None,
        typer.Option(metavar="SHARE", help="Keep a law while its certified tube on the new nominal grows by no more."),
    ] = None,
    faults: Annotated[
        int, typer.Option(metavar="N", help="Inject so many faults in all: of the link, the sensors and the workers.")
    ] = 0,
    seed: Annotated[int, typer.Option(help="Of noise, gusts, guidance and faults.")] = 1,
    workers: Annotated[int, typer.Option(min=1, help="Threads that solve.")] = 2,
    udp: Annotated[bool, typer.Option("--udp", help="Talk to the aircraft over UDP on loopback.")] = False,
    port: Annotated[
        int | None,
        typer.Option(metavar="PORT", help="Wait at this UDP port of this machine for another's aircraft, and fly it."),
    ] = None,
    headless: Annotated[bool, typer.Option("--headless", help="No live view.")] = False,
    replay: Annotated[
        Path | None,
        typer.Option(metavar="FLIGHT.NC", help="Fly a log again and compare; takes nothing else and writes nothing."),
    ] = None,
) -> None:
    """Fly a scenario against the clock: the aircraft in its own process, laws computed while it flies.

    Writes flight.nc (the log), fly.json, figures/ and report.html to the out folder. Exit code 1 if a deadline was
    missed that neither an injected fault nor the machine explains, or the aircraft did not fly to the end. The messages
    between aircraft and controller are documented in aerotube.runtime.messages.

    Example: aerotube fly --duration 60
    """
    with interruptible(NOTHING):
        if replay is not None:
            _replay(replay, [name for name in _given(context) if name != "--replay"])
            return
        from aerotube.runtime.options import Options

        options = Options(
            speed=speed,
            duration=duration,
            window=reuse + 1 if on_demand else window,
            reuse=reuse,
            estimator=estimator,
            noise=noise,
            deviation=cast(Any, deviation),  # one that there is not is refused with the other options
            gusts=gusts,
            delay=delay,
            actuators=actuators,
            replan=replan,
            tolerance=event,
            faults=faults,
            seed=seed,
            workers=workers,
            link="udp" if udp else "local",
            port=port,
        )
        overrides = {"synthesis.algorithm": algorithm, "nominal.beat": None if beat is None else f"{beat!r} s"}
        _fly(scenario, {key: value for key, value in overrides.items() if value is not None}, options, out, headless)


def _fly(scenario: Path | None, overrides: dict[str, str], options: Options, out: Path, headless: bool) -> None:
    """Fly, write what came of it, and leave with the exit code that it deserves."""
    from rich.console import Console

    from aerotube.preparation import prepare
    from aerotube.results import ensure_folder
    from aerotube.runtime.flight import fly as take_off
    from aerotube.runtime.page import save
    from aerotube.runtime.view import LiveView
    from aerotube.scenario import load

    prepared = prepare(load(scenario, overrides))
    console = Console(stderr=True, highlight=False)
    say = partial(console.print, soft_wrap=True, markup=False)
    with _no_empty_folders(out):
        ensure_folder(out)
        flown = take_off(prepared, options, say, None if headless else LiveView(console))
        if flown.interrupted and not flown.record.flown:
            raise KeyboardInterrupt
        with interruptible():
            summary = save(flown, out)
    with interruptible():
        _print(summary, out)
        if flown.interrupted:
            raise KeyboardInterrupt
    failed = not summary["beats"] or summary["ended"] in ("behind", "lost") or summary["missed_unexplained"]
    raise typer.Exit(FAILED if failed else FINE)


@contextmanager
def _no_empty_folders(out: Path) -> Iterator[None]:
    """Where something ends it, take the folders away again that were made in this block and stayed empty."""
    missing = [folder for folder in (out / "figures", out, *out.parents) if not folder.exists()]
    try:
        yield
    except BaseException:
        for folder in missing:
            with suppress(OSError):  # it holds something, or was never made
                folder.rmdir()
        raise


def _given(context: typer.Context) -> list[str]:
    """The arguments and options that stand on the command line, by name."""
    given = [p for p in context.command.params if _stands(context, p.name)]
    return [p.opts[0] if p.param_type_name == "option" else str(p.name) for p in given]


def _stands(context: typer.Context, name: str | None) -> bool:
    source = context.get_parameter_source(name) if name else None
    return source is not None and source.name == "COMMANDLINE"


def _replay(path: Path, others: list[str]) -> None:
    from aerotube.runtime import log, replay

    dataset = log.read(path)
    if others:
        raise InputError(
            f"--replay flies {path} again as it was flown and writes nothing; leave out {', '.join(others)}"
        )
    found = replay.replay(dataset)
    same = all(found[key] in (0.0, None) for key in ("state", "command"))
    typer.echo(
        f"{path}: "
        + ("flies again to the same numbers" if same else "DOES NOT fly again to the same numbers")
        + f" (largest difference of a command {found['command']:.3g}"
        + ("" if found["state"] is None else f", of a state {found['state']:.3g}, SI")
        + ")"
    )
    if found["mae"] is not None:
        typer.echo(f"mean absolute error {found['mae']:.6f}, root mean square {found['rmse']:.6f} (Eq. 18, deg)")
    raise typer.Exit(FINE if same else FAILED)


def _print(summary: dict[str, Any], out: Path) -> None:
    from rich.console import Console

    from aerotube.runtime.words import told

    console = Console(highlight=False)
    for line in told(summary):
        console.print(line, soft_wrap=True, markup=False)
    if summary["beats"]:
        console.print(f"Report: {out / 'report.html'}", soft_wrap=True)
