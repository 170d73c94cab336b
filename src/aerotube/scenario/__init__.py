"""Scenarios: what to fly, in a validated TOML file, and the objects that it names."""

from aerotube.scenario.sections import (
    ERRORS,
    Aircraft,
    Control,
    Disturbance,
    Draws,
    Flight,
    Lqr,
    Nominal,
    Scenario,
    Setting,
    State,
    Synthesis,
    Trim,
)
from aerotube.scenario.source import Source, built_in_text, load, parse

__all__ = [
    "ERRORS",
    "Aircraft",
    "Control",
    "Disturbance",
    "Draws",
    "Flight",
    "Lqr",
    "Nominal",
    "Scenario",
    "Setting",
    "Source",
    "State",
    "Synthesis",
    "Trim",
    "built_in_text",
    "load",
    "parse",
]
