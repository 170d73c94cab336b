"""What the commands share: exit codes, interruption, progress."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

FINE, FAILED, MISTAKE, INTERRUPTED = 0, 1, 2, 130

EPILOG = (
    "Exit codes: 0 all is well; 1 something could not be computed (it is named, the rest is kept); "
    "2 a mistake in what was asked for (nothing is written); 130 interrupted (what was finished is kept)."
)


NOTHING = "interrupted before anything was finished; nothing was written"


class Interrupted(Exception):
    """Ctrl-C, under a name that the library of the command line leaves alone, with what is to be said of it."""


@contextmanager
def interruptible(words: str = "interrupted before the end; the files that are there are whole") -> Iterator[None]:
    """Let Ctrl-C leave under a name of its own, with its own sentence or else this one."""
    try:
        yield
    except KeyboardInterrupt as interruption:
        raise Interrupted(*(interruption.args or (words,))) from None


@contextmanager
def progress() -> Iterator[Callable[[str, float], None]]:
    """Give a callback that shows how far the work is: a bar on a terminal, a line a part elsewhere."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    first = ""

    def told(words: str) -> str:
        # Code that was never run is compiled in the first part of the work, or the first part of that.
        nonlocal first
        if not first or words.startswith(f"{first}: "):
            first = words
        return f"{words} (compiling code first, once)" if cold and words == first else words

    console, cold = Console(stderr=True), not compiled()
    if not console.is_terminal:
        start = time.monotonic()

        def line(words: str, share: float) -> None:
            print(f"{time.monotonic() - start:6.1f} s {100 * share:4.0f} %  {told(words)}", file=sys.stderr)

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
        yield lambda words, share: bar.update(task, description=told(words), completed=share)


def compiled() -> bool:
    """Whether compiled code of this version is kept, to be loaded in a second where compiling takes a minute or two."""
    kept = os.environ.get("NUMBA_CACHE_DIR")
    if kept:
        return any(Path(kept).rglob("*.nbi"))
    package = Path(__file__).parent.parent
    for source in package.rglob("*.py"):
        indices = [index.stat().st_mtime for index in (source.parent / "__pycache__").glob(f"{source.stem}.*.nbi")]
        if indices and max(indices) < source.stat().st_mtime:
            return False
    return any(package.rglob("*.nbi"))
