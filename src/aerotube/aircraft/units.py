"""Exact factors from the units of the sources to SI: multiply to convert."""

FOOT = 0.3048  # m
POUND_FORCE = 4.4482216152605  # N
SLUG = POUND_FORCE / FOOT  # kg
RANKINE = 5.0 / 9.0  # K
