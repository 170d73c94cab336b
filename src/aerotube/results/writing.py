"""Files that are there whole or not at all."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from aerotube.errors import InputError


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Give a path beside `path` to write to; it becomes `path` when the block ends without an error.

    Parameters
    ----------
    path : str or Path
        The file that is to appear. Its folder exists.

    Yields
    ------
    Path
        A file in the same folder, so that the renaming is atomic.
    """
    target = Path(path)
    aside = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        yield aside
        os.replace(aside, target)
    finally:
        aside.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file whole or not at all."""
    with whole_file(path) as aside:
        aside.write_text(text, encoding="utf-8")


def write_json(path: str | Path, value: Any) -> None:
    """Write a JSON file whole or not at all; numbers that are no numbers are refused, use None."""
    write_text(path, json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def ensure_folder(path: str | Path) -> Path:
    """Make a folder and see that files can be written in it.

    Raises
    ------
    InputError
        If it cannot be made or written to; nothing is left behind.
    """
    folder, _ = _made(path)
    return folder


@contextmanager
def out_folder(path: str | Path) -> Iterator[Path]:
    """Give a folder to write to, as of `ensure_folder`; those made for it go again if the block leaves them empty."""
    folder, made = _made(path)
    try:
        yield folder
    finally:
        _remove(made)


def _made(path: str | Path) -> tuple[Path, list[Path]]:
    """The folder, free of links and dots, and the folders that had to be made for it, the outermost first."""
    folder = Path(path).resolve()
    made: list[Path] = []
    try:
        for one in (*reversed(folder.parents), folder):
            if not one.is_dir():
                one.mkdir()
                made.append(one)
        with tempfile.NamedTemporaryFile(dir=folder, prefix=".write-test-"):
            pass
    except OSError as error:
        _remove(made)
        reason = error.strerror or type(error).__name__
        raise InputError(f"out folder {path} cannot be written ({reason}); choose another with --out") from None
    return folder, made


def _remove(folders: list[Path]) -> None:
    """Remove folders that are empty, the innermost first."""
    for one in reversed(folders):
        try:
            one.rmdir()
        except OSError:  # something is in it
            return
