"""The methods of the comparison: the law of each in every condition and air, and how it was chosen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

import numpy as np

from aerotube import compensation, flight
from aerotube.aircraft.f16_aerodynamics import SPAN
from aerotube.compensation import LinearLaw, SynthesisSettings
from aerotube.dynamics import ErrorCoordinates, linearise
from aerotube.flight import Law
from aerotube.nominal import Nominal
from aerotube.results import CONDITION_WORDS, SETTING
from aerotube.studies.bench import CONDITIONS, Bench

METHODS = {
    "none": "no compensation",
    "lqr": "time-varying LQR, swept",
    "inversion": "dynamic inversion, swept",
    "library": "tube library",
    "compensation": "ours, decoupled",
    "coupled": "ours, coupled",
    "saturating": "ours, saturating",
}
AIR = {"still": "still air", "gusts": "moderate gusts"}

#: How many times its limits the saturating law may ask for where they must hold.
SATURATION = 4.0

#: Of the LQR's sweep, wider than the scenario's; its control weights are the scenario's.
LQR_NOISE_WEIGHTS = (0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)

#: On the draws of so many seeds, the first ones, every sweep chooses.
SWEEP_SEEDS = 3

#: The library: so many manoeuvres from a box of starts and controls around the nominal (SI), and what counts as a
#: unit of distance: the half-ranges of the paper's Table 3.
LIBRARY_SIZE, LIBRARY_SEED = 16, 1
_LIBRARY_BOX = np.array([20.0, *np.radians([4, 5, 10, 2, 5, 4, 10, 2]), 0.1, *np.radians([2, 3])])
_LIBRARY_SCALE = np.array([75.0, *np.radians([17.5, 30, 60, 10, 50, 10, 90, 15]), 0.3, *np.radians([15, 25])])


@dataclass(frozen=True)
class Entered:
    """A law that takes part in a condition, and how it was made."""

    law: Law | None
    words: str


def enter_all(bench: Bench) -> dict[tuple[str, str, str], Entered]:
    """The law of every method in every condition and air."""
    entered: dict[tuple[str, str, str], Entered] = {}
    library = _library(bench)
    for place, condition in enumerate(CONDITIONS):
        bench.tell(f"laws, {CONDITION_WORDS[condition]}", 0.1 + 0.1 * place)
        settings = bench.settings(condition)
        alike = {
            "none": Entered(None, ""),
            "library": library(condition),
            "compensation": Entered(bench.design(settings).law, ""),
            "coupled": Entered(bench.design(replace(settings, algorithm="coupled")).law, ""),
            "saturating": Entered(bench.design(replace(settings, saturation=SATURATION)).law, ""),
        }
        for air in AIR:
            entered |= {(method, condition, air): one for method, one in alike.items()}
            entered["lqr", condition, air] = _lqr(bench, condition, air)
            entered["inversion", condition, air] = _inversion(bench, condition, air)
    return entered


def gusts_in(bench: Bench, air: str) -> flight.Dryden | None:
    """The gusts of an air; none in still air."""
    start = bench.prepared.nominal.states[0]
    if air == "still":
        return None
    return flight.Dryden("moderate", float(start[12]), float(np.linalg.norm(start[:3])), SPAN)


def _lqr(bench: Bench, condition: str, air: str) -> Entered:
    ready, coordinates = bench.prepared, ErrorCoordinates("relative")
    weights = ready.source.scenario.lqr
    sweep = flight.best_lqr(
        ready.rigid,
        ready.nominal,
        linearise(ready.model, ready.nominal, coordinates),
        coordinates,
        ready.draws,
        control_weights=weights.control_weights,
        noise_weights=LQR_NOISE_WEIGHTS,
        seeds=SWEEP_SEEDS,
        gusts=gusts_in(bench, air),
        **bench.flying(condition),
    )
    words = (
        f"control weight {sweep.control_weight:g}, noise weight {sweep.noise_weight:g}: the best of "
        f"{sweep.scores.size} on the draws of {len(sweep.seeds)} seed(s)"
    )
    return Entered(sweep.law, words)


def _inversion(bench: Bench, condition: str, air: str) -> Entered:
    ready = bench.prepared
    sweep = flight.best_inversion(
        ready.rigid,
        ready.nominal,
        ready.draws,
        seeds=SWEEP_SEEDS,
        gusts=gusts_in(bench, air),
        **bench.flying(condition),
    )
    return Entered(sweep.law, sweep.words)


def _library(bench: Bench) -> Callable[[str], Entered]:
    """A library for each setting of the synthesis."""
    ready = bench.prepared
    nominals = flight.nearby_nominals(ready.rigid, ready.nominal, _LIBRARY_BOX, LIBRARY_SIZE, LIBRARY_SEED)
    known = {}
    for place, key in enumerate(sorted(set(SETTING.values()))):
        bench.tell("tube library", 0.05 * place)
        known[key] = flight.build_library(nominals, partial(_linear_law, bench, ready.settings[key]), _LIBRARY_SCALE)

    def enter(condition: str) -> Entered:
        library = known[SETTING[condition]]
        entry, distance = library.nearest(ready.nominal)
        words = (
            f"{len(library.points)} laws, {len(set(entry))} of them flown, at a distance of {distance.mean():.2f} "
            "half-ranges of Table 3 on average"
        )
        return Entered(library.law(ready.nominal), words)

    return enter


def _linear_law(bench: Bench, settings: SynthesisSettings, nominal: Nominal) -> LinearLaw:
    ready = bench.prepared
    made = compensation.design(ready.model, nominal, ready.disturbance, settings, workers=bench.workers)
    return cast("LinearLaw", made.law)  # of the first degree in both settings of the built-in scenario
