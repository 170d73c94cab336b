"""Compensation laws that make trajectory tubes small."""

from aerotube.compensation.law import LinearLaw
from aerotube.compensation.settings import COUPLED, DECOUPLED, Part, SynthesisSettings
from aerotube.compensation.synthesis import Compensation, synthesise
from aerotube.compensation.tubes import Tubes

__all__ = [
    "COUPLED",
    "DECOUPLED",
    "Compensation",
    "LinearLaw",
    "Part",
    "SynthesisSettings",
    "Tubes",
    "synthesise",
]
