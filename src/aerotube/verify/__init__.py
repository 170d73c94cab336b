"""Checks that share no code with what they check."""

from aerotube.verify.adversity import Adversity
from aerotube.verify.falsification import FORMS, Falsification, falsify
from aerotube.verify.margins import Margins, gain_margin, linear_part, margins, phase_margin

__all__ = [
    "FORMS",
    "Adversity",
    "Falsification",
    "Margins",
    "falsify",
    "gain_margin",
    "linear_part",
    "margins",
    "phase_margin",
]
