"""The command line: thin. Every command says in one sentence what the user did wrong, and what failed."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated, NoReturn, cast

import typer

from aerotube import __version__
from aerotube.commands.check import check
from aerotube.commands.common import EPILOG, FAILED, FINE, INTERRUPTED, MISTAKE, Interrupted
from aerotube.commands.falsify import falsify
from aerotube.commands.fly import fly
from aerotube.commands.init import init
from aerotube.commands.report import report
from aerotube.commands.run import run
from aerotube.commands.study import study
from aerotube.commands.tube import tube
from aerotube.errors import ComputationError, InputError

cli = typer.Typer(
    name="aerotube",
    help="Trajectory tubes and compensation laws for aircraft, by sum-of-squares programming.",
    epilog=EPILOG,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@cli.callback(invoke_without_command=True)
def _main(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        typer.echo(f"aerotube {__version__}")
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())


cli.command()(init)
cli.command(epilog=EPILOG)(run)
cli.command(epilog=EPILOG)(tube)
cli.command()(report)
cli.command()(check)
cli.command(epilog=EPILOG)(study)
cli.command(epilog=EPILOG)(fly)
cli.command(epilog=EPILOG)(falsify)


def app(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and leave the process with its exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the process without it.
    """
    # Typer's own error of the command line, under whatever name it keeps the module it comes from.
    usage_error = cast("type[Exception]", typer.BadParameter.__mro__[2])
    try:
        code = cli(args=arguments, standalone_mode=False, prog_name="aerotube")
        if code == INTERRUPTED:  # between the commands' own parts, where the library swallows it
            code = _say("interrupted; the files that are there are whole", INTERRUPTED)
    except InputError as error:
        code = _say(error, MISTAKE)
    except ComputationError as error:
        code = _say(error, FAILED)
    except OSError as error:
        code = _say(f"{error.filename or 'a file'} cannot be read or written: {error.strerror or error}", FAILED)
    except (Interrupted, KeyboardInterrupt, typer.Abort) as interruption:
        code = _say(str(interruption) or "interrupted; the files that are there are whole", INTERRUPTED)
    except usage_error as error:
        context = getattr(error, "ctx", None)
        command = "aerotube" if context is None else context.command_path
        message = error.format_message()  # type: ignore[attr-defined]
        code = _say(f"{message.rstrip('.')}; see: {command} --help", MISTAKE)
    sys.exit(code if isinstance(code, int) else FINE)


def _say(sentence: object, code: int) -> int:
    print(f"aerotube: {sentence}", file=sys.stderr)
    return code
