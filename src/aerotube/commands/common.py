"""What the commands share: exit codes, interruption, progress."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

FINE, FAILED, MISTAKE, INTERRUPTED = 0, 1, 2, 130

EPILOG = (
    "Exit codes: 0 all is well; 1 something could not be computed (it is named, the rest is kept); "
    "2 a mistake in what was asked for (nothing is written); 130 interrupted (what was finished is kept)."
)


class Interrupted(Exception):
    """Ctrl-C, under a name that the library of the command line leaves alone."""


@contextmanager
def interruptible() -> Iterator[None]:
    """Let Ctrl-C leave under a name of its own."""
    try:
        yield
    except KeyboardInterrupt:
        raise Interrupted from None


@contextmanager
def progress() -> Iterator[Callable[[str, float], None]]:
    """Give a callback that shows how far the work is: a bar on a terminal, a line a part elsewhere."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        start = time.monotonic()

        def line(words: str, share: float) -> None:
            print(f"{time.monotonic() - start:6.1f} s {100 * share:4.0f} %  {words}", file=sys.stderr)

        yield line
        return
    columns = (
        TextColumn("{task.percentage:3.0f} %"),
        BarColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("reading the scenario", total=1.0)
        yield lambda words, share: bar.update(task, description=words, completed=share)
