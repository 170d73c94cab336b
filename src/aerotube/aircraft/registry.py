"""Aircraft by name, for scenarios and the command line."""

from __future__ import annotations

import inspect
from typing import Any

from aerotube.aircraft.base import Aircraft
from aerotube.aircraft.f16 import F16
from aerotube.errors import InputError

_AIRCRAFT: dict[str, type[Aircraft]] = {"f16": F16}


def available() -> tuple[str, ...]:
    """Names of the aircraft that `make` knows."""
    return tuple(_AIRCRAFT)


def register(name: str, kind: type[Aircraft]) -> None:
    """Make an aircraft known under a name; InputError if the name is taken by another."""
    if _AIRCRAFT.get(name, kind) is not kind:
        raise InputError(f"the aircraft name {name!r} is taken; register it under another")
    _AIRCRAFT[name] = kind


def make(name: str, **options: Any) -> Aircraft:
    """Aircraft of a name.

    Parameters
    ----------
    name : str
        One of `available()`.
    **options
        Passed on to the aircraft.

    Raises
    ------
    InputError
        If the name or an option is not known.
    """
    if name not in _AIRCRAFT:
        raise InputError(f"there is no aircraft {name!r}; choose one of: {', '.join(available())}")
    kind = _AIRCRAFT[name]
    known = list(inspect.signature(kind).parameters)
    for option in options:
        if option not in known:
            raise InputError(f"the aircraft {name} has no option {option!r}; choose among: {', '.join(known)}")
    return kind(**options)
