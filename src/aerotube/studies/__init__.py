"""The paper's experiments, one file each, ours beside the paper's.

A study is a function from the :class:`~aerotube.studies.bench.Bench` to an :class:`~aerotube.studies.outcome.Outcome`;
this registry says where each is.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from aerotube.studies.bench import Bench
    from aerotube.studies.outcome import Outcome


@dataclass(frozen=True)
class Study:
    """Where a study is.

    Attributes
    ----------
    title : str
    module : str
        Of this package; has a function ``study``.
    share : float
        About how long it takes beside the others.
    """

    title: str
    module: str
    share: float

    def __call__(self, bench: Bench) -> Outcome:
        """Do the study."""
        found = importlib.import_module(f"aerotube.studies.{self.module}")
        return cast("Outcome", found.study(bench))


#: All studies by name, in the paper's order.
STUDIES: dict[str, Study] = {
    "coefficients": Study("Aerodynamic coefficients (Fig. 7)", "coefficients", 1.0),
    "tubes": Study("Trajectory tubes (Fig. 8)", "tubes", 20.0),
    "tracking": Study("Tracking with and without compensation (Fig. 9)", "tracking", 15.0),
    "reuse": Study("Control reuse (Fig. 10)", "reuse", 15.0),
    "decoupling-time": Study("Time to solve, with and without decoupling (Fig. 11)", "decoupling_time", 40.0),
    "decoupling-performance": Study("Tracking with and without decoupling (Fig. 12)", "decoupling_performance", 25.0),
    "steps-time": Study("Time of two and three steps over threads (Fig. 13)", "steps_time", 60.0),
    "steps-performance": Study("Tracking with two and three steps (Fig. 14)", "steps_performance", 30.0),
    "sensitivity": Study("Sensitivity of the law to the nominal (Fig. 17, Table 3)", "sensitivity", 100.0),
    "methods": Study("Compensation beside other methods", "methods", 250.0),
    "tradeoff": Study("Tracking, effort and tube size: what a designer chooses from", "tradeoff", 70.0),
}

__all__ = ["STUDIES", "Study"]
