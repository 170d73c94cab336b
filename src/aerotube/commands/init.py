"""The built-in scenario as a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerotube.errors import InputError


def init(
    file: Annotated[Path, typer.Argument(help="The file to write.")] = Path("scenario.toml"),
    force: Annotated[bool, typer.Option("--force", help="Write over a file that is there.")] = False,
) -> None:
    """Write out the built-in scenario (Table 2), commented, to change and to run.

    Example: aerotube init mine.toml && aerotube run mine.toml
    """
    from aerotube.results import write_text
    from aerotube.scenario import built_in_text

    if file.exists() and not force:
        raise InputError(f"{file} is there already; choose another name, or --force to write over it")
    try:
        write_text(file, built_in_text())
    except OSError as error:
        raise InputError(f"{file} cannot be written ({error.strerror}); choose another name") from None
    typer.echo(f"{file} written; change it, then: aerotube run {file}")
