"""The README's examples run as they stand."""

import re
from pathlib import Path

import pytest

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def test_there_are_examples():
    assert len(EXAMPLES) >= 2


@pytest.mark.parametrize("code", EXAMPLES)
def test_an_example_runs(code):
    exec(compile(code, "README.md", "exec"), {})


@pytest.mark.parametrize("command", re.findall(r"^    (aerotube [^#\n]*)", README, re.MULTILINE))
def test_commands_in_the_text_exist(command):
    from typer.main import get_command

    from aerotube.cli import cli

    words = command.split()
    group = get_command(cli)
    assert words[1] == "--help" or words[1] in group.commands
    options = {option for p in group.commands.get(words[1], group).params for option in p.opts + p.secondary_opts}
    assert {word for word in words[2:] if word.startswith("--")} <= options
