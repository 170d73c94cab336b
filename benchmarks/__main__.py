"""``python -m benchmarks``: time the solvers, print the tables, write ``bench.json`` and ``bench-growth.json``."""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks import tables
from benchmarks.solvers import SOLVERS
from benchmarks.worker import THREADS


def _arguments(given: Sequence[str] | None) -> argparse.Namespace:
    from benchmarks.programs import TABLE

    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    names = [*TABLE, "batch", "growth"]
    parser.add_argument("--programs", nargs="+", choices=names, metavar="NAME", help=f"of {', '.join(names)}")
    parser.add_argument("--solvers", nargs="+", choices=list(SOLVERS), metavar="NAME", help=f"of {', '.join(SOLVERS)}")
    parser.add_argument("--solves", type=int, help="at most so many solves of each (for a quick look)")
    parser.add_argument("--deadline", type=float, default=120.0, help="seconds a peer may take for a set-up or a solve")
    parser.add_argument("--out", type=Path, default=Path("bench.json"), help="where the results go")
    chosen = parser.parse_args(given)
    chosen.programs = chosen.programs or names
    chosen.solvers = chosen.solvers or list(SOLVERS)
    return chosen


def main(given: Sequence[str] | None = None) -> None:
    """Run what was asked for; results are written after every program."""
    # Before NumPy is loaded, and handed on to every process that is started.
    os.environ.update(dict.fromkeys(THREADS, "1"))
    chosen = _arguments(given)
    from benchmarks import batch, growth, programs, timing

    console = Console(highlight=False, width=140)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder, console.status("") as status:

        def say(words: str) -> None:
            status.update(words)

        for name in chosen.programs:
            if name not in programs.TABLE:
                continue
            entry = programs.TABLE[name]
            say(f"{name}: making the programs")
            made = entry.make(entry.beats)
            found = timing.compare(made, chosen.solvers, Path(folder), chosen.solves, chosen.deadline, say)
            own = [timed.row(name) for timed in found]
            rows += own
            _write(chosen.out, rows)
            tables.comparison(console, name, entry.words, own)
            tables.notes(console, found)
        if "batch" in chosen.programs:
            beats = range(programs.manoeuvre("linear").nominal.beats)
            made = [
                p for part in (programs.LONGITUDINAL, programs.LATERAL) for p in programs.map_programs(part, 4, beats)
            ]
            own = batch.measure(made, (1, 2), chosen.solves, say)
            rows += own
            _write(chosen.out, rows)
            tables.scaling(console, len(made), own, batch.scaling(own))
        if "growth" in chosen.programs:
            made = programs.map_programs(programs.LONGITUDINAL, 4, range(60))
            grown = growth.measure(made, 9 if chosen.solves is None else min(9, chosen.solves), say)
            _write(chosen.out.with_name(f"{chosen.out.stem}-growth.json"), grown)
            tables.growth(console, grown)


def _write(path: Path, rows: list[dict[str, Any]]) -> None:
    path.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
