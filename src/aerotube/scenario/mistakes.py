"""Mistakes in a scenario, each in one sentence: where, what, and what to do."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ValidationError

_EXPECTED = {
    "float_type": "a number without quotes",
    "int_type": "a whole number without quotes",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "string_type": "text in quotes",
    "list_type": "a list in brackets",
    "finite_number": "a finite number",
    "model_type": "a table",
    "model_attributes_type": "a table",
}


def sentence(
    error: ValidationError, model: type[BaseModel], overrides: Mapping[str, Any], typed: Mapping[str, str]
) -> str:
    """Turn the first problem of a document into one sentence.

    Parameters
    ----------
    error : ValidationError
    model : type of BaseModel
        Of the whole document.
    overrides : mapping
        Dotted keys that were set over it on the command line.
    typed : mapping
        What was typed there for them, such as ``--noise -1``.

    Returns
    -------
    str
    """
    # An unknown key explains a missing one better than the other way round.
    problems = sorted(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    first = problems[0]
    place = ".".join(str(part) for part in first["loc"])
    kind, given = first["type"], first["input"]
    context = first.get("ctx", {})
    options = [
        option
        for key, option in typed.items()
        if key == place or (key.startswith(f"{place}.") and f" {key.rsplit('.', 1)[-1]} " in first["msg"])
    ]
    got = "" if options else f", not {shown(given)}"
    if kind == "extra_forbidden":
        known = _known_keys(model, first["loc"][:-1])
        close = difflib.get_close_matches(str(first["loc"][-1]), known, n=1)
        hint = f'did you mean "{close[0]}"?' if close else f"known here: {', '.join(known)}"
        words = f"{place} is an unknown key; {hint}"
    elif kind == "missing":
        words = f"{place} is missing; add it"
        if len(first["loc"]) == 1:
            words += " (`aerotube init FILE` writes a whole scenario to start from)"
    elif kind in _EXPECTED:
        words = f"{place} must be {_EXPECTED[kind]}{got}"
    elif kind == "literal_error":
        words = f"{place} must be {context['expected']}{got}"
    elif kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal"):
        relation = kind.replace("_than", " than").replace("_equal", " or equal to")
        (bound,) = context.values()
        words = f"{place} must be {relation} {bound:g}{got}"
    elif kind == "value_error":
        message = str(context["error"])
        words = message if len(first["loc"]) <= 1 else f"{place}: {message}"
    elif kind in ("too_short", "too_long"):
        count = context.get("min_length", context.get("max_length"))
        words = f"{place} must have {count} value{'s' * (count != 1)} at {'least' if kind == 'too_short' else 'most'}"
    else:
        words = f"{place}: {first['msg'][:1].lower()}{first['msg'][1:]}; given is {shown(given)}"
    if options:
        words = f"{' or '.join(options)}: {words}"
    elif place in overrides:
        words += " (set by a command-line option)"
    if len(problems) > 1:
        words += f" (and {len(problems) - 1} more)"
    return words


def shown(value: Any) -> str:
    """A value as it was given, cut short."""
    text = f'"{value}"' if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _known_keys(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    for part in location:
        annotation = model.model_fields[str(part)].annotation
        candidates: list[Any] = [annotation, *getattr(annotation, "__args__", ())]
        model = next(c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel))
    return list(model.model_fields)
