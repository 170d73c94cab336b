"""The main job: scenario, nominal trajectory, laws and tubes, flights, results, report.

Each step is a function of what the step before made. What has been computed is kept in a `Record` as it comes, so
that a failure or an interruption later on loses nothing of it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from aerotube import compensation, flight, results, scenario, verify
from aerotube.dynamics import ErrorCoordinates, linearise
from aerotube.errors import ComputationError
from aerotube.preparation import SETTINGS, Prepared, coefficient_curves, error_states, estimated_parameters, prepare
from aerotube.results import CALM, ESTIMATOR, NOISE, Case, Law, Record
from aerotube.tube import parameter_ranges

#: Told what is being done, and which part of the whole is done (0 to 1).
Progress = Callable[[str, float], None]

#: Told which share of one part is done.
Share = Callable[[float], None]


def new_record(prepared: Prepared) -> Record:
    """Start the record of a run with what is known before anything is computed."""
    chosen, plant = prepared.source.scenario, prepared.model
    alpha, coefficients = coefficient_curves(prepared.plant)
    return Record(
        times=prepared.nominal.times,
        nominal_error_states=error_states(prepared.nominal.states),
        nominal_controls=prepared.nominal.controls,
        nominal_states=prepared.nominal.states,
        full_state_names=plant.state_names,
        full_state_units=plant.state_units,
        half_widths=prepared.disturbance.half_widths,
        control_lower=plant.control_lower,
        control_upper=plant.control_upper,
        seeds=chosen.draws.seed_values,
        runs=chosen.draws.runs,
        conditions=prepared.conditions,
        provenance=results.provenance(prepared.source),
        coefficient_alpha=alpha,
        coefficients=coefficients,
    )


def compute(prepared: Prepared, record: Record, workers: int = 1, progress: Progress | None = None) -> None:
    """Compute laws and flights into a record, part by part.

    Parameters
    ----------
    prepared : Prepared
    record : Record
        Filled as the parts are finished; computed failures are put down in ``problems``.
    workers : int
        Threads that solve; the numbers do not depend on it.
    progress : callable, optional
    """
    # One more for the writing, which follows.
    total = len(SETTINGS) + len(results.CONTROLLERS) * len(prepared.conditions) + 1
    for done, (words, part) in enumerate(_steps(prepared, record, workers)):

        def tell(share: float, done: int = done, words: str = words) -> None:
            if progress is not None:
                progress(words, (done + share) / total)

        tell(0.0)
        start = time.perf_counter()
        try:
            part(tell)
            record.seconds[words] = round(time.perf_counter() - start, 3)
        except ComputationError as error:
            record.problems.append(f"{words}: {error}")
    if progress is not None:
        progress("results and report", (total - 1) / total)


def _steps(prepared: Prepared, record: Record, workers: int) -> Iterator[tuple[str, Callable[[Share], None]]]:
    """The parts of the work, in order; each puts what it made into the record."""
    laws: dict[str, compensation.Compensation] = {}
    for key in SETTINGS:
        yield f"laws, {_words(key)} setting", partial(_design, prepared, record, key, laws, workers)
    flights = _Flights(prepared, laws)
    for condition in prepared.conditions:
        for controller in results.CONTROLLERS:
            if controller == "compensated" and flights.setting(condition) not in laws:
                continue  # its failure is on record
            words = f"flights, {results.CONDITION_WORDS[condition]}, {results.CONTROLLER_WORDS[controller]}"

            def part(_: Share, controller: str = controller, condition: str = condition) -> None:
                case = flights.fly(controller, condition)
                if not any(case is known for known in record.cases.values()):
                    record.problems.extend(f"{condition}, {controller}: {message}" for message in case.messages)
                record.cases[controller, condition] = case

            yield words, part


def _words(key: str) -> str:
    return key.replace("_", "-")


def _design(
    prepared: Prepared,
    record: Record,
    key: Literal["noise_free", "noise"],
    laws: dict[str, compensation.Compensation],
    workers: int,
    tell: Share,
) -> None:
    made = compensation.synthesise(
        prepared.model,
        prepared.nominal,
        prepared.disturbance,
        prepared.settings[key],
        workers=workers,
        progress=lambda done, total: tell(done / total),
    )
    laws[key] = made
    tubes = made.tubes
    record.laws[key] = Law(
        parts=tuple((part.name, part.errors) for part in tubes.parts),
        initial_shape=tubes.initial_shape,
        initial_rho=tubes.initial_rho,
        terminal_shape=tubes.terminal_shape,
        terminal_rho=tubes.terminal_rho,
        nominal_shape=tubes.nominal_shape,
        nominal_rho=tubes.nominal_rho,
        metric=tubes.metric,
        size=tubes.size,
        size_nominal=tubes.size_nominal,
        gains=made.law.gains,
        coefficients=made.law.coefficients,
        exponents=made.law.exponents,
        coordinates=made.law.coordinates.kind,
        room=made.law.room,
        reach=made.law.unwhitening,
        feasible=made.feasible,
        solve_seconds=made.solve_seconds,
        certificate=tubes.certificate,
        certificate_nominal=tubes.certificate_nominal,
        polynomial_size=tubes.polynomial_size,
        shares=tubes.shares,
        control=tubes.control,
        boundary=tubes.boundary,
        certify_seconds=tubes.certify_seconds,
        sampling={**asdict(tubes.sampling), "share": tubes.sampling.share},
        notes=tubes.messages,
        messages=tuple(made.messages),
        evidence=made.evidence,
        settings=prepared.source.scenario.synthesis.setting(key),
        margins=verify.margins(
            made.linearisation.A,
            made.linearisation.B,
            verify.linear_part(made.law, prepared.nominal.beats),
            prepared.nominal.dt,
        ),
    )
    record.problems.extend(f"{_words(key)} law, {message}" for message in made.messages)
    for index, part in enumerate(tubes.parts):
        sizes = np.stack([tubes.terminal_rho[:, index], tubes.nominal_rho[:, index]])
        unknown = np.flatnonzero(~np.isfinite(sizes).all(axis=0))
        if unknown.size:
            record.problems.append(f"{_words(key)} law, {part.name}: no tube was found at beat {_ranges(unknown)}")


def _ranges(numbers: NDArray[np.intp]) -> str:
    """Rising numbers in words, runs of them as ranges: "0 to 3, 7"."""
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1)
    return ", ".join(f"{run[0]}" if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs)


class _Flights:
    """Flies controllers in conditions, on the same draws."""

    def __init__(self, prepared: Prepared, laws: dict[str, compensation.Compensation]) -> None:
        self.prepared, self.laws = prepared, laws
        self.chosen = prepared.source.scenario
        self._filter: flight.ExtendedKalmanFilter | None = None
        self._alone: Case | None = None

    def setting(self, condition: str) -> str:
        """Which setting of the synthesis is flown in a condition; the estimator takes the noise away."""
        return "noise" if condition == NOISE else "noise_free"

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
        prepared, made = self.prepared, self.laws[self.setting(condition)]
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
            key = self.setting(condition)
            return self.laws[key].law, f"law of the {_words(key)} setting"
        coordinates = ErrorCoordinates("relative")
        sweep = flight.best_lqr(
            self.prepared.rigid,
            self.prepared.nominal,
            linearise(self.prepared.model, self.prepared.nominal, coordinates),
            coordinates,
            self.prepared.draws,
            noise=noise,
            estimator=estimator,
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


def save_certificates(record: Record, folder: Path) -> None:
    """Write a certificate for the size of every tube, to be checked offline by ``aerotube check``.

    Parameters
    ----------
    record : Record
    folder : Path
        Gets ``certificates/SETTING/beat_BEAT_PART.json``, one file for each tube that has one.
    """
    for key, law in record.laws.items():
        target = results.ensure_folder(folder / "certificates" / key)
        for (name, _), evidence in zip(law.parts, law.evidence, strict=True):
            for beat in np.flatnonzero(evidence.holds):
                evidence.save(target / f"beat_{beat:03d}_{name}.json", (int(beat),))


def save(record: Record, folder: Path) -> dict[str, Any]:
    """Write dataset, summary, figures and report of a record.

    Parameters
    ----------
    record : Record
        Complete or not.
    folder : Path
        Exists.

    Returns
    -------
    dict
        The summary.
    """
    from aerotube import report

    dataset = results.build(record)
    results.write(dataset, folder / "results.nc")
    summary = results.summarise(dataset)
    results.write_json(folder / "summary.json", summary)
    report.write(dataset, folder)
    return summary


def run(
    source: scenario.Source,
    folder: str | Path,
    workers: int = 1,
    progress: Progress | None = None,
    certificates: bool = False,
) -> dict[str, Any]:
    """Do the main job: fly a scenario and write its results.

    Parameters
    ----------
    source : scenario.Source
    folder : str or Path
        Made if it is not there.
    workers : int
        Threads that solve; the numbers do not depend on it.
    progress : callable, optional
    certificates : bool
        Write the tubes' certificates as well.

    Returns
    -------
    dict
        The summary that was written; ``problems`` has the computed failures, ``interrupted`` says whether the
        work was cut short.

    Raises
    ------
    InputError
        If the scenario cannot be flown or the folder not be written; nothing has been written then.
    """
    prepared = prepare(source)
    record = new_record(prepared)
    target = results.ensure_folder(folder)
    try:
        compute(prepared, record, workers, progress)
    except KeyboardInterrupt:
        record.interrupted = True
    except BaseException:
        # An error nobody foresaw: keep what there is before it is shown.
        record.problems.append("an unforeseen error ended the run early")
        save(record, target)
        raise
    summary = save(record, target)
    if certificates:
        save_certificates(record, target)
    if progress is not None:
        progress("done", 1.0)
    return summary
