"""Certificates checked offline."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerotube.commands.common import FAILED, FINE, interruptible
from aerotube.errors import InputError


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
