"""Where a scenario comes from: a TOML file or the built-in one, with keys that are set over it."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from aerotube.errors import InputError
from aerotube.scenario.mistakes import sentence
from aerotube.scenario.sections import Scenario


@dataclass(frozen=True)
class Source:
    """A scenario with the text that it came from.

    Attributes
    ----------
    scenario : Scenario
    name : str
        Name of the file, or "built-in".
    text : str
        The TOML text, without the overrides.
    overrides : dict
        Keys (dotted) that were set over the text, with their values as written.
    folder : Path
        What relative paths in the scenario are relative to.
    """

    scenario: Scenario
    name: str
    text: str
    overrides: dict[str, Any]
    folder: Path

    @property
    def sha256(self) -> str:
        """Hash of the text."""
        return hashlib.sha256(self.text.encode()).hexdigest()


def built_in_text(name: str = "table2") -> str:
    """Return the TOML text of a built-in scenario, comments included."""
    return resources.files("aerotube").joinpath("scenarios", f"{name}.toml").read_text(encoding="utf-8")


def load(
    path: str | Path | None = None,
    overrides: Mapping[str, Any] | None = None,
    typed: Mapping[str, str] | None = None,
) -> Source:
    """Read and validate a scenario.

    Parameters
    ----------
    path : str or Path, optional
        A TOML file; the built-in scenario (Table 2) without it.
    overrides : mapping, optional
        Dotted keys with values as they would be written in the file, set over the text.
    typed : mapping, optional
        What was typed on the command line for them, to be named in a mistake.

    Returns
    -------
    Source

    Raises
    ------
    InputError
        If the file is missing or no TOML, or a key is unknown, missing, of the wrong type or unit, or
        out of range.
    """
    if path is None:
        name, folder, text = "built-in", Path.cwd(), built_in_text()
    else:
        file = Path(path)
        name, folder = str(path), file.resolve().parent
        try:
            text = file.read_text(encoding="utf-8")
        except FileNotFoundError:
            raise InputError(f"scenario {name}: no such file; `aerotube init FILE` writes one to start from") from None
        except UnicodeDecodeError:
            raise InputError(f"scenario {name} is not text in UTF-8") from None
        except OSError as error:
            raise InputError(f"scenario {name} cannot be read: {error.strerror}") from None
    return parse(text, name=name, folder=folder, overrides=overrides, typed=typed)


def parse(
    text: str,
    *,
    name: str = "scenario",
    folder: Path | None = None,
    overrides: Mapping[str, Any] | None = None,
    typed: Mapping[str, str] | None = None,
) -> Source:
    """Validate the TOML text of a scenario; see `load`."""
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"scenario {name} is not valid TOML: {error}") from None
    chosen = dict(overrides or {})
    for key, value in chosen.items():
        _set(document, key.split("."), value)
    try:
        scenario = Scenario.model_validate(document)
    except ValidationError as error:
        words = sentence(error, Scenario, chosen, typed or {})
        raise InputError(words if words.startswith("--") else f"scenario {name}: {words}") from None
    return Source(scenario, name, text, chosen, folder or Path.cwd())


def _set(document: dict[str, Any], keys: list[str], value: Any) -> None:
    for key in keys[:-1]:
        inner = document.setdefault(key, {})
        if not isinstance(inner, dict):
            return  # the validation below names the misplaced key
        document = inner
    document[keys[-1]] = value
