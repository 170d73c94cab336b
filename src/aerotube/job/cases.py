"""The flights of a run: each controller in each condition, and how they kept to their tubes."""

from __future__ import annotations

from typing import Any

import numpy as np

from aerotube import compensation, flight
from aerotube.dynamics import ErrorCoordinates, linearise
from aerotube.preparation import Prepared, estimated_parameters
from aerotube.results import CALM, ESTIMATOR, SETTING, Case
from aerotube.tube import parameter_ranges


class Cases:
    """Flies controllers in conditions, on the same draws.

    Parameters
    ----------
    prepared : Prepared
    laws : dict of Compensation
        Of the settings, by name.
    """

    def __init__(self, prepared: Prepared, laws: dict[str, compensation.Compensation]) -> None:
        self.prepared, self.laws = prepared, laws
        self.chosen = prepared.source.scenario
        self._filter: flight.ExtendedKalmanFilter | None = None
        self._alone: Case | None = None

    def fly(self, controller: str, condition: str) -> Case:
        """Fly one controller in one condition."""
        if controller == "none" and self._alone is not None:
            return self._alone  # neither noise nor estimator reaches the nominal controls
        prepared = self.prepared
        noise = 0.0 if condition == CALM else self.chosen.flight.noise
        estimator = self._estimator() if condition == ESTIMATOR else None
        law, words = self._law(controller, condition, noise, estimator)
        flown = flight.simulate(
            prepared.plant,
            prepared.nominal,
            law,
            prepared.draws,
            noise=noise,
            estimator=estimator,
            gusts=prepared.gusts,
            substeps=self.chosen.flight.substeps,
            trace=controller == "compensated",
        )
        seeds, runs = len(flown.seeds), flown.runs_per_seed
        metric = flown.metric.reshape(seeds, runs, -1)
        diverged = np.zeros(seeds * runs, dtype=bool)
        diverged[[divergence.run for divergence in flown.diverged]] = True
        case = Case(
            error=flown.error[:runs],
            command=flown.control[:runs],
            upper_metric=metric.max(axis=1),
            mean_metric=metric.mean(axis=1),
            diverged=diverged.reshape(seeds, runs),
            outside=flown.outside.reshape(seeds, runs),
            messages=tuple(str(divergence) for divergence in flown.diverged),
            law=words,
            containment=self._containment(condition, flown.trace),
        )
        if controller == "none":
            self._alone = case
        return case

    def _containment(self, condition: str, trace: flight.Trace | None) -> flight.Containment | None:
        """How traced flights kept to the tubes of their law."""
        if trace is None:
            return None
        prepared, made = self.prepared, self.laws[SETTING[condition]]
        settings, states = made.settings, prepared.nominal.states[:-1]
        largest = settings.measurement_error * prepared.disturbance.half_widths
        return flight.containment(
            trace,
            prepared.draws.parameters,
            made.tubes,
            parameter_ranges(prepared.plant, prepared.disturbance.relative),
            measurement=made.law.coordinates.box(states, largest) if largest.any() else None,
            wind=np.repeat([settings.gust, settings.gust_rotation], 3),
        )

    def _law(self, controller: str, condition: str, noise: float, estimator: Any) -> tuple[Any, str]:
        if controller == "none":
            return None, "the nominal controls"
        if controller == "compensated":
            key = SETTING[condition]
            return self.laws[key].law, f"law of the {key.replace('_', '-')} setting"
        coordinates = ErrorCoordinates("relative")
        sweep = flight.best_lqr(
            self.prepared.rigid,
            self.prepared.nominal,
            linearise(self.prepared.model, self.prepared.nominal, coordinates),
            coordinates,
            self.prepared.draws,
            noise=noise,
            estimator=estimator,
            substeps=self.chosen.flight.substeps,
            control_weights=self.chosen.lqr.control_weights,
            noise_weights=self.chosen.lqr.noise_weights,
            seeds=self.chosen.lqr.seeds,
        )
        words = (
            f"control weight {sweep.control_weight:g}, noise weight {sweep.noise_weight:g}: the best of "
            f"{sweep.scores.size} pairs on the draws of {len(sweep.seeds)} seed(s)"
            + (", in still air" if self.prepared.gusts is not None else "")
            + (", without engine lag" if self.chosen.aircraft.engine_lag else "")
        )
        return sweep.law, words

    def _estimator(self) -> flight.ExtendedKalmanFilter:
        if self._filter is None:
            disturbance = self.chosen.disturbance
            self._filter = flight.extended_kalman_filter(
                self.prepared.rigid,
                self.prepared.nominal,
                disturbance.half_widths,
                self.chosen.flight.noise,
                **estimated_parameters(disturbance),
            )
        return self._filter
