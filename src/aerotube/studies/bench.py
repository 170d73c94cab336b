"""What the studies share: the manoeuvre of Table 2, its draws, laws made once, and flights in three conditions."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from aerotube import compensation, flight, job, results, scenario
from aerotube.compensation import Design, SynthesisSettings
from aerotube.errors import ComputationError
from aerotube.preparation import estimated_parameters, prepare
from aerotube.results import CALM, ESTIMATOR, NOISE, SETTING
from aerotube.units import DISPLAY

if TYPE_CHECKING:
    import xarray as xr

#: The conditions of flight, in the order of the tables.
CONDITIONS = (CALM, NOISE, ESTIMATOR)

# Of a study that needs the main job, the share of time that this takes.
_MAIN = 0.6

#: Told what is being done and which share of a study is done.
Tell = Callable[[str, float], None]


class Bench:
    """The built-in scenario, prepared, with what several studies need computed once.

    Parameters
    ----------
    runs, seeds : int, optional
        Runs a seed and number of seeds; those of the scenario without them.
    workers : int
        Threads that solve; the numbers do not depend on it.
    tell : callable, optional

    Raises
    ------
    InputError
        If the numbers of runs or seeds make no sense.
    """

    def __init__(
        self, runs: int | None = None, seeds: int | None = None, workers: int = 1, tell: Tell | None = None
    ) -> None:
        asked = {"draws.runs": runs, "draws.seeds": seeds}
        self.overrides: dict[str, Any] = {key: value for key, value in asked.items() if value is not None}
        self.prepared = prepare(scenario.load(None, self.overrides))
        self.workers = workers
        self.tell: Tell = tell or (lambda words, share: None)
        self._designs: dict[SynthesisSettings, Design] = {}
        self._estimator: flight.ExtendedKalmanFilter | None = None
        self._alone: flight.Flights | None = None
        self._results: xr.Dataset | None = None

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of the draws."""
        return self.prepared.draws.seeds

    @property
    def runs(self) -> int:
        """Runs of a seed."""
        return self.prepared.draws.runs_per_seed

    def words(self) -> str:
        """The draws in words."""
        return f"{len(self.seeds)} seeds ({self.seeds[0]} to {self.seeds[-1]}) of {self.runs} runs"

    def design(self, settings: SynthesisSettings) -> Design:
        """Laws for the whole manoeuvre, made once for each settings."""
        if settings not in self._designs:
            ready = self.prepared
            self._designs[settings] = compensation.design(
                ready.model, ready.nominal, ready.disturbance, settings, workers=self.workers
            )
        return self._designs[settings]

    def results(self) -> xr.Dataset:
        """Results of the main job on the same draws: laws, tubes and flights, as `aerotube.results.build` labels them.

        Raises
        ------
        ComputationError
            If a part of it cannot be computed.
        """
        if self._results is None:
            record = job.new_record(self.prepared)
            job.compute(self.prepared, record, self.workers, lambda words, share: self.tell(words, _MAIN * share))
            if record.problems:
                raise ComputationError(f"the main job has failures, the first: {record.problems[0]}")
            self._results = results.build(record)
        return self._results

    def settings(self, condition: str) -> SynthesisSettings:
        """The scenario's settings for a condition of flight."""
        return self.prepared.settings[SETTING[condition]]

    def estimator(self) -> flight.ExtendedKalmanFilter:
        """The state estimator, designed for the scenario's disturbances."""
        if self._estimator is None:
            ready = self.prepared
            self._estimator = flight.extended_kalman_filter(
                ready.rigid,
                ready.nominal,
                ready.disturbance.half_widths,
                1.0,
                **estimated_parameters(ready.source.scenario.disturbance),
            )
        return self._estimator

    def flying(self, condition: str) -> dict[str, Any]:
        """Noise and estimator of a condition, as `aerotube.flight.simulate` takes them."""
        return {
            "noise": 0.0 if condition == CALM else 1.0,
            "estimator": self.estimator() if condition == ESTIMATOR else None,
        }

    def fly(
        self,
        law: flight.Law | None,
        condition: str = CALM,
        *,
        draws: flight.Draws | None = None,
        gusts: flight.Dryden | None = None,
    ) -> flight.Flights:
        """Fly a law, or the nominal alone, on every draw.

        Parameters
        ----------
        law : Law or None
        condition : str
            One of `CONDITIONS`; sensor noise is of the full range.
        draws : Draws, optional
            Those of the scenario without them.
        gusts : Dryden, optional

        Returns
        -------
        Flights
        """
        plain = draws is None and gusts is None and law is None
        if plain and self._alone is not None:
            return self._alone  # neither noise nor estimator reaches the nominal controls
        flown = flight.simulate(
            self.prepared.plant,
            self.prepared.nominal,
            law,
            draws or self.prepared.draws,
            gusts=gusts,
            **self.flying(condition),
        )
        if plain:
            self._alone = flown
        return flown

    def scaled_draws(self, factor: float) -> flight.Draws:
        """The same draws with every disturbance larger: initial errors, noise, mass and other parameters.

        Parameters
        ----------
        factor : float
            Positive.

        Returns
        -------
        Draws
        """
        disturbance = self.prepared.source.scenario.disturbance
        larger: dict[str, Any] = {
            f"disturbance.{name}": f"{factor * getattr(disturbance, name)!r} {_si_unit(name)}"
            for name in ("V", "alpha", "q", "theta", "beta", "p", "r", "phi")
        }
        for name in disturbance.relative:
            larger[f"disturbance.{name}"] = f"{100.0 * factor * disturbance.relative[name]!r} %"
        return prepare(scenario.load(None, self.overrides | larger)).draws


def _si_unit(name: str) -> str:
    return DISPLAY[name].unit.replace("deg", "rad")
