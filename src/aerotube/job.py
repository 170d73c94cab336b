"""The main job: scenario, nominal trajectory, laws and tubes, flights, results, report.

Each step is a function of what the step before made. What has been computed is kept in a `Record` as it comes, so
that a failure or an interruption later on loses nothing of it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from aerotube import compensation, flight, nominal, results, scenario
from aerotube.aircraft import Aircraft, make
from aerotube.aircraft.rigid_body import flow_angles, velocity_from_flow
from aerotube.dynamics import ErrorCoordinates, linearise
from aerotube.errors import ComputationError, InputError
from aerotube.numerics import euler_from_quaternion, quaternion_from_euler
from aerotube.results import CALM, ESTIMATOR, NOISE, Case, Law, Record
from aerotube.tube import DisturbanceBox
from aerotube.units import DISPLAY

Array = NDArray[np.float64]

#: Told what is being done, and which part of the whole is done (0 to 1).
Progress = Callable[[str, float], None]

#: Told which share of one part is done.
Share = Callable[[float], None]

_SETTINGS: tuple[Literal["noise_free", "noise"], ...] = ("noise_free", "noise")


@dataclass(frozen=True)
class Prepared:
    """Everything that a scenario names, made and checked.

    Attributes
    ----------
    source : scenario.Source
    plant : Aircraft
        The aircraft that flies.
    rigid : Aircraft
        The same without engine lag: of the nominal and of the estimator, which would take any other reading of
        the tables for an error of the measurement.
    model : Aircraft
        What the laws are computed on.
    nominal : nominal.Nominal
    disturbance : DisturbanceBox
    draws : flight.Draws
        Of all seeds.
    settings : dict of SynthesisSettings
        By name, "noise_free" and "noise".
    gusts : flight.Dryden or None
    """

    source: scenario.Source
    plant: Aircraft
    rigid: Aircraft
    model: Aircraft
    nominal: nominal.Nominal
    disturbance: DisturbanceBox
    draws: flight.Draws
    settings: dict[str, compensation.SynthesisSettings]
    gusts: flight.Dryden | None

    @property
    def conditions(self) -> tuple[str, ...]:
        """The conditions that the scenario asks for."""
        wanted = self.source.scenario.flight
        noisy = (NOISE, *((ESTIMATOR,) if wanted.estimator else ())) if wanted.noise > 0 else ()
        return (CALM, *noisy)


def prepare(source: scenario.Source) -> Prepared:
    """Make and check everything that a scenario names; nothing is computed yet that can fail otherwise.

    Parameters
    ----------
    source : scenario.Source

    Returns
    -------
    Prepared

    Raises
    ------
    InputError
        If the scenario cannot be flown as it stands: a nominal outside the aircraft's model, controls beyond
        their limits, an option out of range.
    """
    chosen = source.scenario
    common: dict[str, Any] = {"xcg": chosen.aircraft.xcg, "engine_momentum": chosen.aircraft.engine_momentum}
    name, published = chosen.aircraft.model, chosen.aircraft.interpolation
    rigid = make(name, interpolation=published, **common)
    plant = make(name, interpolation=published, engine_lag=True, **common) if chosen.aircraft.engine_lag else rigid
    model = make(name, interpolation=chosen.aircraft.synthesis_interpolation, **common)
    reference = make_nominal(source, rigid)
    reference.check(rigid)
    reference.check(model)
    box = DisturbanceBox(np.array(chosen.disturbance.half_widths), {"mass": chosen.disturbance.mass})
    draws = flight.draw(
        chosen.disturbance.half_widths,
        chosen.draws.seed_values,
        chosen.draws.runs,
        mass_error=chosen.disturbance.mass,
    )
    settings: dict[str, compensation.SynthesisSettings] = {
        key: compensation.SynthesisSettings(**chosen.synthesis.setting(key)) for key in _SETTINGS
    }
    return Prepared(source, plant, rigid, model, reference, box, draws, settings, _gusts(source, reference))


def _gusts(source: scenario.Source, reference: nominal.Nominal) -> flight.Dryden | None:
    severity = source.scenario.flight.gusts
    if severity == "none":
        return None
    from aerotube.aircraft.f16_aerodynamics import SPAN

    start = reference.states[0]
    return flight.Dryden(severity, float(start[12]), float(np.linalg.norm(start[:3])), SPAN)


def make_nominal(source: scenario.Source, aircraft: Aircraft) -> nominal.Nominal:
    """Make the nominal trajectory of a scenario.

    Parameters
    ----------
    source : scenario.Source
    aircraft : Aircraft
        Of thirteen states.

    Returns
    -------
    nominal.Nominal

    Raises
    ------
    InputError
        If the initial state or the controls are outside the aircraft's model, or the file does not fit.
    """
    wanted = source.scenario.nominal
    if wanted.source == "file":
        assert wanted.file is not None  # seen to by the scenario
        return _cut(nominal.read(source.folder / wanted.file, aircraft), wanted, wanted.file)
    if wanted.source == "trim":
        assert wanted.trim is not None
        trim = wanted.trim
        return nominal.from_trim(aircraft, trim.V, trim.altitude, trim.turn_rate, dt=wanted.beat, beats=wanted.beats)
    assert wanted.state is not None
    assert wanted.control is not None
    control = np.array([getattr(wanted.control, name) for name in aircraft.control_names])
    _check_controls(aircraft, control)
    return nominal.constant_controls(aircraft, full_state(wanted.state), control, wanted.beat, wanted.beats)


def _check_controls(aircraft: Aircraft, control: Array) -> None:
    """Name a control beyond its limits by its key and in its unit of the scenario."""
    tolerance = 1e-9
    for i, name in enumerate(aircraft.control_names):
        low, high = aircraft.control_lower[i], aircraft.control_upper[i]
        if not low - tolerance <= control[i] <= high + tolerance:
            display = DISPLAY[name]
            # Adding zero turns the limit -0 into 0.
            value, least, most = (display.factor * x + 0.0 for x in (control[i], low, high))
            raise InputError(
                f"nominal.control.{name} is {value:g} {display.unit}".rstrip()
                + f", beyond its limits of {least:g} to {most:g} {display.unit}".rstrip()
                + "; choose a value within them"
            )


def _cut(given: nominal.Nominal, wanted: scenario.Nominal, name: str) -> nominal.Nominal:
    """The first beats of a nominal from a file."""
    if not np.isclose(given.dt, wanted.beat, rtol=1e-6):
        raise InputError(
            f"nominal.file {name} has beats of {given.dt:g} s, nominal.beat is {wanted.beat:g} s; agree them"
        )
    if given.beats < wanted.beats:
        raise InputError(
            f"nominal.file {name} is {given.beats * given.dt:g} s long, nominal.horizon is {wanted.horizon:g} s; "
            "shorten the horizon"
        )
    return nominal.Nominal(given.dt, given.states[: wanted.beats + 1], given.controls[: wanted.beats], given.source)


def full_state(start: scenario.State) -> Array:
    """Full state of a scenario's initial state: ndarray (13,)."""
    velocity = velocity_from_flow(start.V, start.alpha, start.beta)
    attitude = quaternion_from_euler(start.phi, start.theta, start.psi)
    return np.array([*velocity, *attitude, start.p, start.q, start.r, 0.0, 0.0, start.altitude], dtype=float)


def error_states(states: Array) -> Array:
    """Full states in the eight quantities of the error state, SI: ndarray (..., 8)."""
    airspeed, attack, sideslip = flow_angles((states[..., 0], states[..., 1], states[..., 2]))
    roll, pitch, _ = euler_from_quaternion(tuple(states[..., i] for i in range(3, 7)))
    p, q, r = (states[..., i] for i in (7, 8, 9))
    return np.stack([airspeed, attack, q, pitch, sideslip, p, r, roll], axis=-1)


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


def coefficient_curves(aircraft: Aircraft) -> tuple[Array | None, dict[str, Array]]:
    """Aerodynamic coefficients over angle of attack, as in the paper's Fig. 7.

    Parameters
    ----------
    aircraft : Aircraft

    Returns
    -------
    alpha : ndarray or None
        rad, -10 to 25 degrees; None for an aircraft that has no such tables.
    curves : dict of ndarray
        CD, CL, Cm at no sideslip and CY, Cl, Cn at 5 degrees of it; rates and deflections zero.
    """
    from aerotube.aircraft import F16
    from aerotube.aircraft.f16_aerodynamics import coefficients

    if not isinstance(aircraft, F16):
        return None, {}
    alpha = np.radians(np.linspace(-10.0, 25.0, 141))
    zero = np.zeros_like(alpha)

    def at(sideslip: float) -> tuple[Any, ...]:
        flow = (zero + 150.0, alpha, zero + sideslip)  # without rates the airspeed does not matter
        airframe = aircraft.airframe
        return coefficients(airframe.aerodynamics, flow, (zero,) * 3, (zero,) * 4, airframe.lever)

    cx, _, cz, _, cm, _ = at(0.0)
    _, cy, _, cl, _, cn = at(np.radians(5.0))
    drag, lift = -cx * np.cos(alpha) - cz * np.sin(alpha), cx * np.sin(alpha) - cz * np.cos(alpha)
    return alpha, {"CD": drag, "CL": lift, "Cm": cm, "CY": cy, "Cl": cl, "Cn": cn}


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
    total = len(_SETTINGS) + len(results.CONTROLLERS) * len(prepared.conditions) + 1
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
    for key in _SETTINGS:
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
        feasible=made.feasible,
        solve_seconds=made.solve_seconds,
        certificate=tubes.certificate,
        messages=tuple(made.messages),
        settings=prepared.source.scenario.synthesis.setting(key),
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
        )
        if controller == "none":
            self._alone = case
        return case

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
                mass_error=disturbance.mass,
            )
        return self._filter


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
    source: scenario.Source, folder: str | Path, workers: int = 1, progress: Progress | None = None
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
    if progress is not None:
        progress("done", 1.0)
    return summary
