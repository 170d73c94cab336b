"""Compensation laws that make trajectory tubes small."""

from aerotube.compensation.bounds import KINDS, NONE, SHARES
from aerotube.compensation.design import Design, design
from aerotube.compensation.gauge import Reading, gauge, gauge_beat
from aerotube.compensation.law import LinearLaw, PolynomialLaw
from aerotube.compensation.settings import COUPLED, DECOUPLED, Part, SynthesisSettings
from aerotube.compensation.sizes import certified_size, flown_size
from aerotube.compensation.synthesis import Compensation, synthesise
from aerotube.compensation.tubes import Tubes, measure
from aerotube.compensation.worst_points import Sampling

__all__ = [
    "COUPLED",
    "DECOUPLED",
    "KINDS",
    "NONE",
    "SHARES",
    "Compensation",
    "Design",
    "LinearLaw",
    "Part",
    "PolynomialLaw",
    "Reading",
    "Sampling",
    "SynthesisSettings",
    "Tubes",
    "certified_size",
    "design",
    "flown_size",
    "gauge",
    "gauge_beat",
    "measure",
    "synthesise",
]
