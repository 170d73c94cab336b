"""From a measurement to a command: what is done in every beat, in flight and in replay alike."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.dynamics.errors import ErrorCoordinates
from aerotube.dynamics.step import step
from aerotube.flight.estimator import Estimate, ExtendedKalmanFilter
from aerotube.runtime.kernels import clamp, corrected, increments, plausible
from aerotube.runtime.law import Form, Laws
from aerotube.runtime.messages import Rung

Array = NDArray[np.float64]


class Source(IntEnum):
    """Where the state that the law was given came from."""

    MEASURED = 0
    PREDICTED = 1
    """No measurement that could be used: the last one, carried on by the model."""
    NONE = 2
    """Neither: the law was not asked."""


@dataclass(frozen=True)
class Beat:
    """What flies in a beat.

    Attributes
    ----------
    nominal_state : ndarray (n,)
    nominal_control : ndarray (4,)
    law : Laws
        Of the one beat.
    rung : Rung
        What stands behind them: the worst of the parts.
    next_state : ndarray (n,)
        The nominal at the end of the beat.
    """

    nominal_state: Array
    nominal_control: Array
    law: Laws
    rung: Rung
    next_state: Array


@dataclass(frozen=True)
class Command:
    """A command and how it came about.

    Attributes
    ----------
    control : ndarray (4,)
        Within the limits, always.
    error : ndarray (8,)
        What the law was given; zeros where there was nothing to give.
    rung : Rung
    source : Source
    clamped : ndarray (4,) of bool
        Controls that the clamp holds at a limit where the nominal has none.
    """

    control: Array
    error: Array
    rung: Rung
    source: Source
    clamped: NDArray[np.bool_]


class Commander:
    """Turns measurements into commands; holds the last state and the estimate of one flight.

    Parameters
    ----------
    aircraft : Aircraft
        The controller's model of it.
    coordinates : ErrorCoordinates
    dt : float
        Length of a beat, s.
    estimator : ExtendedKalmanFilter, optional
    form : Form
        Of the laws.
    gate : ndarray (8,)
        A measurement further than this from what was expected is not believed, unless three in a row are.
    stale : int
        Beats for which a state is carried on by the model.
    """

    def __init__(
        self,
        aircraft: Aircraft,
        coordinates: ErrorCoordinates,
        dt: float,
        estimator: ExtendedKalmanFilter | None,
        form: Form,
        gate: Array,
        stale: int = 5,
    ) -> None:
        self.aircraft, self.coordinates, self.dt = aircraft, coordinates, dt
        self.estimator, self.gate, self.stale = estimator, gate, stale
        self._relative = coordinates.kind == "relative"
        self._low, self._high = aircraft.control_lower, aircraft.control_upper
        self._compiled: Any = aircraft.compiled_step()
        self._realise = aircraft.compiled_realise()
        self._parameters = np.asarray(aircraft.parameter_nominal, dtype=float)
        self._still = np.zeros(6)
        self._factors, self._part_of = form.factors, form.part_of
        self.begin()

    def begin(self) -> None:
        """Forget the flight so far: a manoeuvre begins."""
        self._expected: Array | None = None
        self._age = 0
        self._doubted = 0
        self._state: Array | None = None
        self._estimate: Estimate | None = None if self.estimator is None else self.estimator.start(1)

    def believes(self, state: Array, beat: Beat) -> bool:
        """Whether a measured state can be used; three unlikely ones in a row are believed."""
        expected = beat.nominal_state if self._expected is None else self._expected
        if plausible(state, expected, self.gate, self._relative):
            self._doubted = 0
            return True
        everywhere = np.full(8, np.inf)
        if not plausible(state, expected, everywhere, self._relative) or not bool(self.aircraft.in_domain(state)):
            return False
        self._doubted += 1
        return self._doubted >= 3

    def command(self, number: int, measured: Array | None, beat: Beat) -> Command:
        """Command of a beat.

        Parameters
        ----------
        number : int
            Of the beat, in the manoeuvre.
        measured : ndarray (n,) or None
            A state that is believed; None: there is none.
        beat : Beat

        Returns
        -------
        Command
        """
        source = Source.MEASURED if measured is not None else Source.PREDICTED
        state = measured if measured is not None else self._expected
        self._age = 0 if measured is not None else self._age + 1
        if state is None or self._age > self.stale:
            self._state = None
            return self._alone(beat, Source.NONE)
        if self.estimator is not None and self._estimate is not None:
            state = self._corrected(number, state, measured is not None)
        self._state = state
        law = beat.law
        error, increment = increments(
            law.coefficients,
            law.room,
            law.reach,
            self._factors,
            self._part_of,
            state,
            beat.nominal_state,
            self._relative,
        )
        if not np.isfinite(increment).all():
            return self._alone(beat, source)
        if self._realise is None:
            control = self.aircraft.realise(state, beat.nominal_control, increment)
        else:
            control = self._realise(state[None], beat.nominal_control[None], increment[None])[0]
        control, clamped = clamp(control, beat.nominal_control, increment, self._low, self._high)
        return Command(control, error, beat.rung, source, clamped)

    def rehearse(self, number: int, beat: Beat) -> None:
        """Do what the next beat will ask for, to no effect: code and numbers that were just used come faster."""
        state = beat.nominal_state if self._expected is None else self._expected
        kept = self._state, self._estimate, self._age, self._doubted
        self.believes(state, beat)
        self.command(number, state, beat)
        self._state, self._estimate, self._age, self._doubted = kept

    def after(self, number: int, beat: Beat, control: Array) -> None:
        """What can wait until the command is out: carry state and estimate on to the next beat."""
        if self._state is None:
            self._expected = None
        elif self.estimator is not None and self._estimate is not None:
            self._estimate = self._predicted(number, beat, control)
            ahead = self._state.copy()
            moved = self.coordinates.retract(beat.next_state, self._estimate.error[0])
            ahead[:10] = moved[:10]
            self._expected = ahead if np.isfinite(ahead).all() else None
        else:
            self._expected = self._stepped(self._state, control)

    def _alone(self, beat: Beat, source: Source) -> Command:
        control = np.clip(beat.nominal_control, self._low, self._high)
        return Command(control, np.zeros(8), Rung.NOMINAL, source, np.zeros(4, bool))

    def _stepped(self, state: Array, control: Array) -> Array | None:
        if self._compiled is None:
            ahead = step(self.aircraft, state, control, self.dt)
        else:
            ahead = self._compiled(state[None], control[None], self._parameters[None], self._still[None], self.dt, 1)[0]
        return ahead if np.isfinite(ahead).all() else None

    def _corrected(self, number: int, state: Array, measured: bool) -> Array:
        """Estimated state; position and further states as measured (or expected)."""
        assert self.estimator is not None
        assert self._estimate is not None
        nominal, before = self.estimator.nominal.states[number], self._estimate
        if measured and self.estimator.coordinates.kind == "relative":
            packed = np.concatenate([before.error[0], before.parameters[0], before.gust[0]])
            after, out = corrected(state, nominal, packed, np.ascontiguousarray(self.estimator.gains[number]))
            last = 8 + before.parameters.shape[1]
            self._estimate = Estimate(after[None, :8], after[None, 8:last], after[None, last:])
            return out
        if measured:
            error = self.estimator.coordinates.difference(state, nominal)
            self._estimate = self.estimator.correct(number, before, error[None])
        out = state.copy()
        out[:10] = self.estimator.coordinates.retract(nominal, self._estimate.error[0])[:10]
        return out

    def _predicted(self, number: int, beat: Beat, control: Array) -> Estimate:
        assert self.estimator is not None
        assert self._estimate is not None
        ahead = self.estimator.predict(number, self._estimate, control[None])
        lost = np.asarray(~np.isfinite(ahead.error).all(axis=-1))
        return self.estimator.restart(ahead, lost) if lost.any() else ahead
