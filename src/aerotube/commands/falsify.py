"""Tubes attacked on the flown aircraft."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from aerotube.commands.common import FAILED, FINE, NOTHING, Interrupted, interruptible, progress
from aerotube.errors import InputError

if TYPE_CHECKING:
    from aerotube.compensation import SynthesisSettings
    from aerotube.preparation import Prepared
    from aerotube.results.falsified import Attack
    from aerotube.scenario import Source

_SHOWN = 10


def falsify(
    scenario: Annotated[
        Path | None, typer.Argument(help="A scenario file, as `aerotube init` writes one; Table 2 without it.")
    ] = None,
    samples: Annotated[
        int, typer.Option(min=1, help="Random points for each tube, besides extreme points and ascents.")
    ] = 10_000,
    beats: Annotated[str, typer.Option(metavar="BEATS", help="Which beats: all, or such as 0-9,20,30-39.")] = "all",
    certificate: Annotated[
        str | None, typer.Option(metavar="KIND", help="What the tubes are to rest on, in place of the scenario's.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random points.")] = 0,
    workers: Annotated[int | None, typer.Option(min=1, help="Threads; as many as cores without it.")] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="The folder to write to; out/falsified/SCENARIO without it."),
    ] = None,
) -> None:
    """Try to break every tube of a scenario: search its sets for a flight of one beat that leaves it.

    Tubes that are sampled or rigorous are attacked with everything that they promise to withstand; those that hold for
    polynomials only, with the errors of their own half. Writes falsification.json, falsification.nc and a figure.
    Exit code 1: a tube that promises more than its polynomials is broken. A million points a tube take a few minutes.
    """
    threads = workers or os.cpu_count() or 1
    with interruptible(NOTHING), progress() as tell:
        from aerotube.preparation import prepare
        from aerotube.results import out_folder
        from aerotube.scenario import load

        source = load(scenario, {})
        prepared = prepare(source)
        chosen = parse_beats(beats, prepared.nominal.beats)
        settings = prepared.settings
        if certificate is not None:
            asked: Any = certificate  # the settings say so if there is no such kind
            settings = {key: replace(value, certificate=asked) for key, value in settings.items()}
        # a folder of its own, so that it does not come to lie among the results of another scenario
        folder = out or Path("out", "falsified", "built-in" if scenario is None else scenario.stem)
        options = {"beats": chosen, "samples": samples, "seed": seed, "workers": threads}
        with out_folder(folder) as target:
            attacks, interrupted = _attacked(prepared, settings, options, tell)
            if not attacks:
                raise KeyboardInterrupt
            try:
                _save(attacks, source, target)
            except KeyboardInterrupt:
                raise KeyboardInterrupt(
                    f"interrupted while writing; in {folder} some files are new and whole, the others missing or older"
                ) from None
        tell("done", 1.0)
    _print(attacks, folder)
    if interrupted:
        raise Interrupted(f"interrupted; what was finished is in {folder}")
    raise typer.Exit(FAILED if any(attack.refuted.any() for attack in attacks.values()) else FINE)


def parse_beats(text: str, count: int) -> list[int]:
    """Read a list of beats such as ``0-9,20``.

    Parameters
    ----------
    text : str
    count : int
        Number of beats there are.

    Returns
    -------
    list of int
        Rising, each once.

    Raises
    ------
    InputError
        If it cannot be read or names a beat that there is not.
    """
    if text.strip() == "all":
        return list(range(count))
    found: set[int] = set()
    for piece in text.split(","):
        first, _, last = piece.partition("-")
        try:
            low, high = int(first), int(last or first)
        except ValueError:
            raise InputError(f'beats: "{piece}" is no beat; write all, or such as 0-9,20') from None
        if not 0 <= low <= high < count:
            raise InputError(f'beats: "{piece}" is not among the beats of the scenario, 0 to {count - 1}')
        found.update(range(low, high + 1))
    return sorted(found)


def _attacked(
    prepared: Prepared, settings: Mapping[str, SynthesisSettings], options: dict[str, Any], tell: Any
) -> tuple[dict[str, Attack], bool]:
    """Attack the tubes of both settings: what was finished, and whether an interruption cut it short."""
    from aerotube import compensation, verify
    from aerotube.preparation import SETTINGS
    from aerotube.results.falsified import Attack

    attacks: dict[str, Attack] = {}
    problem = prepared.model, prepared.nominal, prepared.disturbance
    width = 1.0 / len(SETTINGS)
    for done, key in enumerate(SETTINGS):
        words = f"{key.replace('_', '-')} setting"
        told = _share(tell, f"attack, {words}", done * width, width, len(options["beats"]))
        try:
            tell(f"laws and tubes, {words}", done * width)
            made = compensation.synthesise(*problem, settings[key], workers=options["workers"])
            found = verify.falsify(*problem, made, **options, progress=told)
        except KeyboardInterrupt:
            return attacks, True
        attacks[key] = Attack(found, verify.kinds(made.tubes), tuple(prepared.model.parameter_names))
        if found.interrupted:
            return attacks, True
    return attacks, False


def _share(tell: Any, words: str, start: float, width: float, total: int) -> Any:
    """Tell of an attack every twentieth of it."""
    every = max(1, total // 20)

    def told(done: int, of: int) -> None:
        if done % every == 0 or done == of:
            tell(f"{words}: {done} of {of} beats", start + width * done / of)

    return told


def _save(attacks: Mapping[str, Attack], source: Source, folder: Path) -> None:
    from aerotube.report.falsified import tightness_figure
    from aerotube.results import ensure_folder, provenance, whole_file, write, write_json
    from aerotube.results.falsified import attack_dataset, summarise_attack, violations

    origin = provenance(source)
    write(attack_dataset(attacks, origin), folder / "falsification.nc")
    first = next(iter(attacks.values())).found
    write_json(
        folder / "falsification.json",
        {
            "samples": first.samples,
            "seed": first.seed,
            "interrupted": any(attack.found.interrupted for attack in attacks.values()),
            "tightness": {law: summarise_attack(attack) for law, attack in attacks.items()},
            "violations": {law: violations(attack) for law, attack in attacks.items()},
            "refuted": {law: int(attack.refuted.sum()) for law, attack in attacks.items()},
            "provenance": {
                key: origin[key] for key in ("aerotube_version", "scenario_name", "scenario_sha256", "created")
            },
        },
    )
    with whole_file(ensure_folder(folder / "figures") / "falsification.png") as aside:
        tightness_figure(attacks).savefig(aside, format="png", dpi=110)


def _print(attacks: Mapping[str, Attack], folder: Path) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    from aerotube.compensation.sampled import FACTOR, TERMINAL_FACTOR
    from aerotube.results.falsified import FORM_WORDS, summarise_attack, violations

    console = Console(highlight=False)
    for law, attack in attacks.items():
        title = f"{law.replace('_', '-')} law: worst found over the bound (above 1: broken)"
        table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
        for name in ("tube", "certificate"):
            table.add_column(name, no_wrap=True)
        for name in ("tubes", "median", "min", "max", "broken"):
            table.add_column(name, justify="right", no_wrap=True)
        for row in summarise_attack(attack):
            sizes = (ratio_words(row[name]) for name in ("median", "min", "max"))
            tube = f"{row['part']}, {row['form']}"
            table.add_row(tube, row["certificate"], str(row["tubes"]), *sizes, str(row["broken"]))
        console.print(table)
    for law, attack in attacks.items():
        broken = violations(attack)
        for one in broken[:_SHOWN]:
            ratio = "not finite" if one["ratio"] is None else f"{one['ratio']:.6g} times the tube"
            console.print(
                f"{law.replace('_', '-')} law, beat {one['beat']}, {one['part']}, {FORM_WORDS[one['form']]} "
                f"({one['certificate']}): {ratio} with {one['point']}",
                soft_wrap=True,
            )
        if len(broken) > _SHOWN:
            console.print(f"and {len(broken) - _SHOWN} more; all are in {folder / 'falsification.json'}")
    if any("sampled" in attack.certificate for attack in attacks.values()):
        console.print(
            f"Sampled tubes keep a reserve, {FACTOR:g} times the largest size found for them and {TERMINAL_FACTOR:g} "
            f"times in their terminal ellipsoids: a search that finds no more than theirs comes to {1 / FACTOR:.3f} "
            f"and {1 / TERMINAL_FACTOR:.3f}.",
            soft_wrap=True,
        )
    console.print(
        f"Written to {folder}: falsification.json, falsification.nc, figures/falsification.png", soft_wrap=True
    )


def ratio_words(ratio: float | None) -> str:
    """A ratio in words, with what it differs from one by where three decimals do not show it: "1+2.3e-07"."""
    if ratio is None:
        return "–"
    close = 0.0 < abs(ratio - 1.0) < 5e-4
    return f"1{ratio - 1.0:+.1e}" if close else f"{ratio:.3f}"
