"""Certificates checked offline."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from aerotube.commands.common import FAILED, FINE, NOTHING, interruptible
from aerotube.errors import InputError

if TYPE_CHECKING:
    from aerotube.sos.check import Report

_MEANING = (
    "Holds: in exact arithmetic, with the file's own numbers, every polynomial of the program is not negative on its "
    "domain. For a tube of `aerotube run` this bounds the size of the error at the end of the beat, from anywhere in "
    "the initial ellipsoid, by the objective (in the program's own unit), for the polynomials through the loop's "
    "values at the nodes; what sampled or rigorous tubes hold beyond these is not in the file."
)


def check(
    files: Annotated[
        list[Path],
        typer.Argument(help="Certificates, as `aerotube run --certificates` writes them, or folders that hold some."),
    ],
) -> None:
    """Check saved certificates in exact arithmetic, by code that shares nothing with the solver.

    Of a folder all certificates in it and in its folders. Exit code 0: every certificate holds; 1: some do not.

    Example: aerotube check out/certificates
    """
    sound = total = 0
    with interruptible(NOTHING):
        alone = len(files) == 1 and not files[0].is_dir()
        for file in _certificates(files):
            found = _checked(file)
            total, sound = total + 1, sound + found.holds
            verdict = "holds" if found.holds else "DOES NOT HOLD"
            typer.echo(str(found) if alone else f"{file}: {verdict}, objective {found.objective:.9g}")
    if not alone:
        typer.echo(f"{sound} of {total} certificates hold.")
    typer.echo(_MEANING)
    raise typer.Exit(FINE if sound == total else FAILED)


def _certificates(files: list[Path]) -> Iterator[Path]:
    """The files themselves, and of folders every certificate in them."""
    for file in files:
        if not file.is_dir():
            yield file
            continue
        inside = [one for one in sorted(file.rglob("*.json")) if _looks_like_one(one)]
        if not inside:
            raise InputError(f"{file} holds no certificates; `aerotube run --certificates` writes some")
        yield from inside


def _looks_like_one(file: Path) -> bool:
    """Whether a file begins as certificates do: the other files of a run are none."""
    with open(file, "rb") as opened:
        return b"sum-of-squares certificate" in opened.read(200)


def _checked(file: Path) -> Report:
    from aerotube.sos import check_file

    try:
        return check_file(file)
    except OSError as error:
        raise InputError(f"{file} cannot be read ({error.strerror}); check the name") from None
    except ValueError as error:
        raise InputError(str(error)) from None
