"""Flying a compensation law: Monte Carlo of the full nonlinear aircraft, all runs at once.

A beat of a run: measure (the true state with noise on the eight error states), estimate if there is an estimator,
ask the law for increments of the virtual controls, turn them into controls within their limits, and advance the
aircraft by one Runge-Kutta step with the control held. Without a law, and at beats for which a law has no gain,
the nominal controls fly alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.dynamics.errors import ERROR_UNITS, ErrorCoordinates, euler_error
from aerotube.dynamics.step import step
from aerotube.errors import InputError
from aerotube.flight.draws import Draws
from aerotube.flight.estimator import ExtendedKalmanFilter
from aerotube.flight.gusts import CHANNELS, Dryden
from aerotube.flight.metrics import error_metric, mean_upper_error, upper_envelope
from aerotube.nominal import Nominal

Array = NDArray[np.float64]

_EULER = ErrorCoordinates("euler")

# Errors beyond which a run counts as diverged, far outside any tube: [V, alpha, q, theta, beta, p, r, phi] in SI,
# the airspeed as a fraction of the nominal; the attitude itself is free.
_DIVERGED = np.array([0.75, np.pi / 2, 10.0, np.inf, np.pi / 2, 10.0, 10.0, np.inf])
_WORDS = ("airspeed", "angle of attack", "pitch rate", "pitch", "sideslip", "roll rate", "yaw rate", "roll")
_DEGREES = float(np.degrees(1.0))
_SHOWN = tuple((1.0, unit) if unit == "m/s" else (_DEGREES, unit.replace("rad", "deg")) for unit in ERROR_UNITS)

_RIGID_BODY = 13


class Law(Protocol):
    """What the simulation needs of a compensation law.

    A law may also have ``feasible``, an ndarray (T,) of bool: at beats where it is false the law is not asked,
    and the nominal flies alone.
    """

    @property
    def coordinates(self) -> ErrorCoordinates:
        """Coordinates in which the law is given the error."""

    def increment(self, beat: int, error: Array) -> Array:
        """Increments of the virtual controls (run, 4) for measured errors (run, 8)."""


@dataclass(frozen=True)
class Divergence:
    """A run that left the aircraft's model for good.

    Attributes
    ----------
    run : int
        Place on the run axis.
    name : str
        Its seed and its place among the seed's runs.
    beat : int
        The beat during which it happened.
    reason : str
    """

    run: int
    name: str
    beat: int
    reason: str

    def __str__(self) -> str:
        return f"{self.name} diverged in beat {self.beat}: {self.reason}; it is frozen at its last state."


@dataclass(frozen=True, eq=False)
class Trace:
    """What a law dealt with, in its own coordinates.

    Attributes
    ----------
    error : ndarray (run, time, 8)
        True errors; NaN from where a run diverged.
    seen : ndarray (run, beat, 8)
        Errors that the law was given: measured or estimated.
    wind : ndarray (run, beat, 6), optional
        Velocity (m/s) and rotation (rad/s) of the air, body axes; None in still air.
    """

    error: Array
    seen: Array
    wind: Array | None


@dataclass(frozen=True, eq=False)
class Flights:
    """Flights of all runs; the runs of one seed are next to each other.

    Attributes
    ----------
    times : ndarray (time,)
        s; one more than there are beats.
    error : ndarray (run, time, 8)
        True differences from the nominal, Euler angles, SI and radians; held from where a run diverged.
    control : ndarray (run, beat, 4)
        Controls flown.
    metric : ndarray (run, time)
        Eq. 18.
    seeds : tuple of int
    runs_per_seed : int
    diverged : tuple of Divergence
    outside : ndarray (run,) of bool
        Runs that at some time were outside the range of the aircraft's tables.
    fallback : ndarray (run, beat) of bool
        Where the law had no gain or no finite answer, and the nominal flew alone.
    trace : Trace, optional
        If it was asked for.
    """

    times: Array
    error: Array
    control: Array
    metric: Array
    seeds: tuple[int, ...]
    runs_per_seed: int
    diverged: tuple[Divergence, ...]
    outside: NDArray[np.bool_]
    fallback: NDArray[np.bool_]
    trace: Trace | None = None

    def upper_envelope(self) -> Array:
        """Largest Eq. 18 over each seed's runs: ndarray (seed, time)."""
        return upper_envelope(self.metric, len(self.seeds))

    def mean_upper_error(self) -> Array:
        """Mean over time of the upper envelope: ndarray (seed,)."""
        return mean_upper_error(self.metric, len(self.seeds))

    def error_envelope(self) -> tuple[Array, Array]:
        """Least and largest error over all runs: two ndarrays (time, 8)."""
        return self.error.min(axis=0), self.error.max(axis=0)

    def control_envelope(self) -> tuple[Array, Array]:
        """Least and largest control over all runs: two ndarrays (beat, 4)."""
        return self.control.min(axis=0), self.control.max(axis=0)


def simulate(
    plant: Aircraft,
    nominal: Nominal,
    law: Law | None,
    draws: Draws,
    *,
    noise: float = 0.0,
    estimator: ExtendedKalmanFilter | None = None,
    gusts: Dryden | None = None,
    substeps: int = 1,
    trace: bool = False,
) -> Flights:
    """Fly a law, or the nominal alone, on every draw.

    Parameters
    ----------
    plant : Aircraft
        The aircraft that flies; it may have states of its own after those of the nominal.
    nominal : Nominal
    law : Law or None
        None: the nominal controls alone.
    draws : Draws
    noise : float
        Fraction of the disturbance box that the measurement noise fills, fresh at every beat; not negative.
    estimator : ExtendedKalmanFilter, optional
        Between the measurement and the law.
    gusts : Dryden, optional
        Turbulence, held over a beat.
    substeps : int
        Runge-Kutta steps a beat.
    trace : bool
        Keep what the law dealt with, in its coordinates, beat by beat.

    Returns
    -------
    Flights

    Raises
    ------
    InputError
        For a noise or a number of substeps that makes no sense, or a nominal that is not the plant's.

    Notes
    -----
    A run that becomes non-finite or strays by more than 90 degrees in a flow angle, 10 rad/s in a rate or three
    quarters of the airspeed is named in ``diverged`` and frozen; it never becomes a NaN.

    All runs advance together, in one thread: NumPy's operations on a thousand runs are too short for threads to
    share the interpreter without losing more than they gain (tried: half as long again with two).
    """
    if not (np.isfinite(noise) and noise >= 0):
        raise InputError(f"noise: expected a fraction of the disturbance box, not negative; got {noise!r}.")
    if substeps < 1:
        raise InputError(f"simulation: the number of substeps must be at least 1; got {substeps}.")
    if estimator is not None and estimator.nominal.beats < nominal.beats:
        raise InputError("estimator: it was designed for a shorter nominal; design it for the one that is flown.")
    sensor = noise * draws.measurement_noise(nominal.beats) if law is not None and noise > 0 else None
    air = None if gusts is None else gusts.sample(draws.gust_noise(nominal.beats, CHANNELS), nominal.dt)
    filtered = None if law is None or estimator is None else _Filtered(estimator, draws.runs)
    kept = None
    if trace and law is not None:
        shape = (draws.runs, nominal.beats)
        kept = Trace(np.full((shape[0], shape[1] + 1, 8), np.nan), np.full((*shape, 8), np.nan), air)
    return _fly(plant, nominal, law, draws, sensor, filtered, air, substeps, kept)


def _fly(
    plant: Aircraft,
    nominal: Nominal,
    law: Law | None,
    draws: Draws,
    sensor: Array | None,
    filtered: _Filtered | None,
    air: Array | None,
    substeps: int,
    trace: Trace | None,
) -> Flights:
    """Fly all runs, beat by beat; noise of the sensor (run, beat, 8) and wind (run, beat, 6) are given."""
    beats, runs = nominal.beats, draws.runs
    start = _start_state(plant, nominal)
    state = _EULER.retract(start, draws.initial_error)
    errors = np.empty((runs, beats + 1, 8))
    errors[:, 0] = euler_error(state, start)
    controls = np.empty((runs, beats, 4))
    fallback = np.zeros((runs, beats), bool)
    outside = ~plant.in_domain(state)
    lost = np.zeros(runs, bool)
    diverged: list[Divergence] = []
    advance = partial(step, plant, dt=nominal.dt, parameters=draws.parameters, substeps=substeps)

    # A run that diverges may overflow on its way out; it is caught and named right after the step.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for beat in range(beats):
            measured = state if sensor is None else _EULER.retract(state, sensor[:, beat])
            if filtered is not None:
                measured = filtered.correct(beat, measured)
            if trace is not None and law is not None:
                _keep(trace, law, nominal, beat, state, measured, lost)
            controls[:, beat], fallback[:, beat] = _command(plant, nominal, law, beat, measured)
            wind = None if air is None else air[:, beat]
            state = advance(state=state, control=controls[:, beat], wind=wind)
            if filtered is not None:
                filtered.predict(beat, controls[:, beat])
            errors[:, beat + 1] = euler_error(state, nominal.states[beat + 1])
            newly = _newly_diverged(errors[:, beat + 1], nominal, beat, draws, lost)
            diverged += newly
            lost[[divergence.run for divergence in newly]] = True
            if lost.any():
                # A lost run's place in the batch is taken by the nominal, so that it cannot overflow again.
                state[lost] = np.concatenate([nominal.states[beat + 1], start[nominal.states.shape[1] :]])
                errors[lost, beat + 1] = errors[lost, beat]
                if filtered is not None:
                    filtered.restart(lost)
            outside |= ~plant.in_domain(state) & ~lost
        if trace is not None and law is not None:
            _keep(trace, law, nominal, beats, state, None, lost)
    return Flights(
        nominal.times,
        errors,
        controls,
        error_metric(errors),
        draws.seeds,
        draws.runs_per_seed,
        tuple(diverged),
        outside,
        fallback,
        trace,
    )


def _keep(
    trace: Trace, law: Law, nominal: Nominal, beat: int, state: Array, measured: Array | None, lost: NDArray[np.bool_]
) -> None:
    """Write down the errors at the start of a beat, and, but for the end of the last one, what the law sees of them."""
    error = law.coordinates.difference(state, nominal.states[beat])
    if measured is not None:
        trace.seen[:, beat] = error
        if measured is not state:
            trace.seen[:, beat] = law.coordinates.difference(measured, nominal.states[beat])
    trace.error[:, beat] = error
    trace.error[lost, beat] = np.nan


def _start_state(plant: Aircraft, nominal: Nominal) -> Array:
    """Nominal start with the plant's own further states, at rest where the nominal does not have them."""
    state = nominal.states[0]
    if len(state) == len(plant.state_names):
        return state
    settled = plant.settled(tuple(nominal.controls[0]))
    if _RIGID_BODY + len(settled) != len(plant.state_names):
        raise InputError(
            f"simulation: the nominal has {len(state)} states and the plant {len(plant.state_names)}; "
            "fly the nominal with the same kind of aircraft."
        )
    return np.concatenate([state[:_RIGID_BODY], np.array(settled, dtype=float)])


def _command(
    plant: Aircraft, nominal: Nominal, law: Law | None, beat: int, measured: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Controls of a beat, and the runs for which the law has no answer and the nominal flies alone."""
    alone = np.tile(nominal.controls[beat], (len(measured), 1))
    if law is None:
        return alone, np.zeros(len(measured), bool)
    feasible = getattr(law, "feasible", None)
    if feasible is not None and not feasible[beat]:
        return alone, np.ones(len(measured), bool)
    error = law.coordinates.difference(measured, nominal.states[beat])
    increment = np.asarray(law.increment(beat, error), dtype=float)
    silent = ~np.isfinite(increment).all(axis=-1)
    increment = np.where(silent[:, None], 0.0, increment)
    control = plant.realise(measured, nominal.controls[beat], increment)
    return np.where(silent[:, None], alone, control), silent


def _newly_diverged(
    error: Array, nominal: Nominal, beat: int, draws: Draws, lost: NDArray[np.bool_]
) -> list[Divergence]:
    """Runs that diverged in this beat, each with its reason."""
    bounds = _DIVERGED.copy()
    bounds[0] *= np.linalg.norm(nominal.states[beat + 1, :3])
    within = np.abs(error) <= bounds
    found = []
    for run in np.flatnonzero(~within.all(axis=-1) & ~lost):
        if np.isfinite(error[run]).all():
            component = int(np.argmin(within[run]))
            factor, unit = _SHOWN[component]
            reason = f"the {_WORDS[component]} is {factor * error[run, component]:.3g} {unit} off the nominal"
        else:
            reason = "the state is no longer finite"
        found.append(Divergence(int(run), draws.name(int(run)), beat, reason))
    return found


class _Filtered:
    """An estimator with its estimates for a batch of runs."""

    def __init__(self, estimator: ExtendedKalmanFilter, runs: int) -> None:
        self._estimator = estimator
        self._estimate = estimator.start(runs)

    def correct(self, beat: int, measured: Array) -> Array:
        """Estimated state; position and further states as measured."""
        estimator, nominal = self._estimator, self._estimator.nominal.states[beat]
        error = estimator.coordinates.difference(measured, nominal)
        self._estimate = estimator.correct(beat, self._estimate, error)
        state = measured.copy()
        state[:, :10] = estimator.coordinates.retract(nominal, self._estimate.error)[:, :10]
        return state

    def predict(self, beat: int, control: Array) -> None:
        self._estimate = self._estimator.predict(beat, self._estimate, control)
        # An estimate that overflowed would never come back; the next measurement starts it afresh.
        self.restart(np.asarray(~np.isfinite(self._estimate.error).all(axis=-1)))

    def restart(self, runs: NDArray[np.bool_]) -> None:
        if runs.any():
            self._estimate = self._estimator.restart(self._estimate, runs)
