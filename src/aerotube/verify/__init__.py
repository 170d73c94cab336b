"""Checks that share no code with what they check."""

from aerotube.verify.adversity import Adversity
from aerotube.verify.falsification import PROMISING, Falsification, falsify, kinds
from aerotube.verify.margins import Margins, gain_margin, linear_part, margins, phase_margin
from aerotube.verify.recheck import recheck

__all__ = [
    "PROMISING",
    "Adversity",
    "Falsification",
    "Margins",
    "falsify",
    "gain_margin",
    "kinds",
    "linear_part",
    "margins",
    "phase_margin",
    "recheck",
]
