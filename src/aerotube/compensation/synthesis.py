"""Compensation laws and tubes for every beat of a nominal trajectory."""

from __future__ import annotations

from dataclasses import dataclass

from aerotube import sos
from aerotube.aircraft.base import Aircraft
from aerotube.compensation.design import Design, Progress, design
from aerotube.compensation.settings import SynthesisSettings
from aerotube.compensation.tubes import Tubes, measure
from aerotube.nominal import Nominal
from aerotube.tube import DisturbanceSet


@dataclass(frozen=True)
class Compensation(Design):
    """Laws, their tubes, and how their computation went.

    Attributes
    ----------
    tubes : Tubes
        Of the same beats.
    evidence : tuple of sos.Certificate
        Of ``tubes.size``, one for each part with the beats as its batch; can be saved and checked offline.

    See Also
    --------
    Design : the other attributes.
    """

    tubes: Tubes
    evidence: tuple[sos.Certificate, ...]


def synthesise(
    aircraft: Aircraft,
    nominal: Nominal,
    disturbance: DisturbanceSet,
    settings: SynthesisSettings | None = None,
    *,
    beats: range | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> Compensation:
    """Compute compensation laws and tubes for beats of a nominal trajectory.

    See :func:`~aerotube.compensation.design.design` for parameters and errors, and
    :func:`~aerotube.compensation.tubes.measure` for the tubes.

    Returns
    -------
    Compensation
    """
    made = design(aircraft, nominal, disturbance, settings, beats=beats, workers=workers, progress=progress)
    tubes, evidence = measure(
        aircraft, nominal, disturbance, made.law, made.metric, made.settings, beats=beats, workers=workers
    )
    return Compensation(**vars(made), tubes=tubes, evidence=evidence)
