"""The tables as printed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from benchmarks.timing import Timed

AGREE = 1e-5
"""Relative difference of objectives above which solvers are said to disagree."""


def _number(value: float | None, form: str = ".4g") -> str:
    return "" if value is None else format(value, form)


def comparison(console: Console, name: str, words: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Times and ratios of one program."""
    table = Table(title=f"{name}: {words}", title_justify="left", box=None, padding=(0, 2, 0, 0))
    for column in ("solver", "solves", "set-up ms", "median ms", "p99 ms", "ratio", "objective", "certified", "status"):
        table.add_column(column, justify="left" if column in ("solver", "status") else "right")
    base = next((row["median_ms"] for row in rows if row["solver"] == "aerotube"), None)
    for row in rows:
        ratio = row["median_ms"] / base if base and row["median_ms"] else None
        table.add_row(
            row["solver"],
            str(row["solves"]),
            _number(row["setup_ms"]),
            _number(row["median_ms"]),
            _number(row["p99_ms"]),
            _number(ratio, ".2f"),
            _number(row["objective"], ".9g"),
            _number(row["certified"], ".9g"),
            row["status"],
        )
    console.print()
    console.print(table)


def notes(console: Console, found: Sequence[Timed]) -> None:
    """Where objectives differ from the project's own, and what memory its process took."""
    own = next((timed for timed in found if timed.solver == "aerotube"), None)
    if own is None:
        return
    if own.memory is not None:
        console.print(
            f"  aerotube: {min(own.iterations)} to {max(own.iterations)} iterations; "
            f"peak memory of the whole process {own.memory:.0f} MiB"
        )
    loose = [beat for beat, bound in own.certified.items() if bound is None]
    if loose:
        console.print(f"  aerotube: no certified bound for {len(loose)} of {len(own.certified)} beats")
    for timed in found:
        if timed is own:
            continue
        both = [b for b, x in timed.objectives.items() if x is not None and own.objectives.get(b) is not None]
        if not both:
            continue
        apart = {b: abs(timed.objectives[b] - own.objectives[b]) / abs(own.objectives[b]) for b in both}  # type: ignore
        worst = max(apart, key=lambda b: apart[b])
        verdict = "agrees" if apart[worst] <= AGREE else "DIFFERS"
        console.print(f"  {timed.solver}: {verdict}, objectives of {len(both)} beats are within {apart[worst]:.1e}")


def scaling(
    console: Console, programs: int, rows: Sequence[Mapping[str, Any]], gains: Mapping[int, tuple[float, float]]
) -> None:
    """The batch, beside the control."""
    table = Table(title=f"batch: {programs} programs at once", title_justify="left", box=None, padding=(0, 2, 0, 0))
    for column in ("what", "threads", "batches", "median ms", "p99 ms", "status"):
        table.add_column(column, justify="left" if column in ("what", "status") else "right")
    for row in rows:
        table.add_row(
            row["solver"],
            str(row["threads"]),
            str(row["solves"]),
            _number(row["median_ms"]),
            _number(row["p99_ms"]),
            row["status"],
        )
    console.print()
    console.print(table)
    for count, (own, control) in gains.items():
        console.print(f"  {count} threads: {own:.2f} times as fast, the control {control:.2f}: {own / control:.2f}")


def growth(console: Console, rows: Sequence[Mapping[str, Any]]) -> None:
    """Time along states, degree, beats and threads."""
    table = Table(title="growth", title_justify="left", box=None, padding=(0, 2, 0, 0))
    columns = ("along", "value", "nodes", "gram_order", "variables", "programs", "threads", "median_ms", "iterations")
    for column in (*columns, "status"):
        table.add_column(column.replace("_", " "), justify="left" if column in ("along", "status") else "right")
    for row in rows:
        table.add_row(*(_number(row[c]) if c == "median_ms" else str(row[c]) for c in columns), row["status"])
    console.print()
    console.print(table)
