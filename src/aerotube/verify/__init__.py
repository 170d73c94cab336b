"""Checks that share no code with what they check."""

from aerotube.verify.falsification import Falsification, falsify

__all__ = ["Falsification", "falsify"]
