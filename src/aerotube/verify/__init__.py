"""Checks that share no code with what they check."""

from aerotube.verify.falsification import Falsification, falsify
from aerotube.verify.margins import Margins, gain_margin, linear_part, margins, phase_margin

__all__ = ["Falsification", "Margins", "falsify", "gain_margin", "linear_part", "margins", "phase_margin"]
