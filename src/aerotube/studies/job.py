"""Doing studies: each one's files are written as it ends, then what gathers them all."""

from __future__ import annotations

import csv
import datetime
import io
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from aerotube import __version__, results
from aerotube.errors import ComputationError, InputError
from aerotube.results import whole_file, write_json, write_text
from aerotube.studies import STUDIES
from aerotube.studies.bench import Bench, Tell
from aerotube.studies.outcome import Outcome
from aerotube.studies.page import build_page

_DOTS_PER_INCH = 100
_COLUMNS = ("figure", "words", "unit", "paper", "ours", "ours_sd", "ratio", "verdict")


@dataclass
class Done:
    """How the studies went.

    Attributes
    ----------
    verdicts : dict of str
        One line for each study that was finished.
    seconds : dict of float
        Time that each took.
    problems : list of str
        One sentence for each that was not.
    interrupted : bool
    """

    verdicts: dict[str, str] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    interrupted: bool = False


def chosen(names: Sequence[str]) -> list[str]:
    """The studies that are asked for, in the registry's order.

    Parameters
    ----------
    names : sequence of str
        Names of studies, or ``all``.

    Returns
    -------
    list of str

    Raises
    ------
    InputError
        For a name that is none.
    """
    for name in names:
        if name != "all" and name not in STUDIES:
            raise InputError(f"there is no study {name!r}; choose all, or among: {', '.join(STUDIES)}")
    if not names:
        raise InputError(f"no study was asked for; choose all, or among: {', '.join(STUDIES)}")
    return [name for name in STUDIES if name in names or "all" in names]


def run(
    names: Sequence[str],
    folder: str | Path,
    *,
    runs: int | None = None,
    seeds: int | None = None,
    workers: int = 1,
    progress: Tell | None = None,
) -> Done:
    """Do studies and write what they come to.

    Parameters
    ----------
    names : sequence of str
        Names of studies, or ``all``.
    folder : str or Path
        Gets a folder for each study (``data.nc``, ``figure.png``, ``table.csv``, ``study.json``), and of all
        studies that it holds, those of earlier runs as well, ``studies.json`` and ``studies.html``.
    runs, seeds : int, optional
        Runs a seed and number of seeds; those of the built-in scenario without them.
    workers : int
        Threads that solve.
    progress : callable, optional

    Returns
    -------
    Done
        A study that fails is named in it, the others are done all the same. Nothing is written if the first was
        interrupted.

    Raises
    ------
    InputError
        For an unknown study, a number of runs or seeds that makes no sense, or a folder that cannot be written.
    """
    wanted = chosen(names)
    bench = Bench(runs, seeds, workers)
    with results.out_folder(folder) as target:
        done = _all(wanted, bench, target, progress)
        try:
            if done.verdicts or not done.interrupted:
                gather(target)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"interrupted while writing; the finished studies are in {folder}, and `aerotube study` gathers them "
                "when it is run there again"
            ) from None
    return done


def _all(wanted: list[str], bench: Bench, target: Path, progress: Tell | None) -> Done:
    """Do studies one after the other, until they are interrupted."""
    total = sum(STUDIES[name].share for name in wanted)
    done, before = Done(), 0.0
    try:
        for name in wanted:
            weight = STUDIES[name].share
            bench.tell = _telling(progress, name, before / total, weight / total)
            bench.tell("", 0.0)
            _do(name, bench, target, done)
            before += weight
    except KeyboardInterrupt:
        done.interrupted = True
    return done


def _telling(progress: Tell | None, name: str, before: float, weight: float) -> Tell:
    """Turn a share of one study into a share of all, told where the words change or a percent has been done."""
    last: list[tuple[str, float]] = []

    def tell(words: str, share: float) -> None:
        now = words, max(before + share * weight, last[0][1] if last else 0.0)
        if progress is None or (last and last[0][0] == words and abs(now[1] - last[0][1]) < 0.01):
            return
        last[:] = [now]
        progress(f"{name}: {words}" if words else name, now[1])

    return tell


def _do(name: str, bench: Bench, target: Path, done: Done) -> None:
    """Do one study and write its files; a failure is put down."""
    start = time.perf_counter()
    try:
        outcome = STUDIES[name](bench)
    except (ComputationError, InputError) as error:
        done.problems.append(f"{name}: {error}")
        return
    except Exception as error:
        # One nobody foresaw: the other studies are none the worse for it.
        done.problems.append(f"{name}: an unforeseen error, {type(error).__name__}: {error}")
        return
    seconds = round(time.perf_counter() - start, 1)
    write(name, outcome, bench, target, seconds)
    done.verdicts[name], done.seconds[name] = outcome.verdict, seconds


def write(name: str, outcome: Outcome, bench: Bench, target: Path, seconds: float) -> None:
    """Write the files of one study.

    Parameters
    ----------
    name : str
    outcome : Outcome
    bench : Bench
    target : Path
        Exists; gets a folder of the study's name.
    seconds : float
        That the study took.
    """
    folder = results.ensure_folder(target / name)
    description: dict[str, Any] = {
        "name": name,
        "title": STUDIES[name].title,
        "runs_per_seed": bench.runs,
        "seeds": list(bench.seeds),
        "workers": bench.workers,
        "seconds": seconds,
        "aerotube_version": __version__,
        "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    } | outcome.described()
    dataset = outcome.dataset.assign_attrs(
        results.provenance(bench.prepared.source)
        | {"title": f"aerotube study: {STUDIES[name].title}", "verdict": outcome.verdict}
        | {"seeds": json.dumps(list(bench.seeds)), "runs_per_seed": bench.runs}
    )
    results.write(dataset, folder / "data.nc")
    with whole_file(folder / "figure.png") as aside:
        outcome.figure.savefig(aside, format="png", dpi=_DOTS_PER_INCH)
    write_text(folder / "table.csv", _csv(description["compared"]))
    # Last: with it the study counts as finished.
    write_json(folder / "study.json", description)


def _csv(compared: list[dict[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for row in compared:
        values = (row["name"] if column == "figure" else row[column] for column in _COLUMNS)
        writer.writerow("" if value is None else value for value in values)
    return text.getvalue()


def gather(target: Path) -> dict[str, dict[str, dict[str, Any]]]:
    """Write ``studies.json`` and ``studies.html`` of all finished studies in a folder.

    Parameters
    ----------
    target : Path

    Returns
    -------
    dict
        What ``studies.json`` holds: study -> figure name -> ``paper``, ``ours``, ``ours_sd``, ``verdict``.
    """
    finished = [
        json.loads((target / name / "study.json").read_text(encoding="utf-8"))
        for name in STUDIES
        if (target / name / "study.json").is_file()
    ]
    keys = ("paper", "ours", "ours_sd", "verdict")
    together = {
        one["name"]: {row["name"]: {key: row[key] for key in keys} for row in one["compared"]} for one in finished
    }
    write_json(target / "studies.json", together)
    write_text(target / "studies.html", build_page(finished, target))
    return together
