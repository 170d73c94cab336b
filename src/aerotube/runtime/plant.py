"""The aircraft that flies, without a clock.

An undisturbed flight is that of :func:`aerotube.flight.simulate` with the same draws. What is added here is the
world: commands that come late or not at all, actuators, and delays.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.dynamics.errors import ErrorCoordinates
from aerotube.dynamics.step import step
from aerotube.flight.gusts import CHANNELS
from aerotube.runtime.world import Truth, World

Array = NDArray[np.float64]

_EULER = ErrorCoordinates("euler")


class Plant:
    """The aircraft without the clock: one manoeuvre after the other, substep by substep."""

    def __init__(self, world: World) -> None:
        self.world = world
        runs, beats = world.manoeuvres, world.beats
        draws = world.draws
        self.noise = world.noise * draws.measurement_noise(beats) if world.noise > 0 else np.zeros((runs, beats, 8))
        still = np.zeros((runs, beats, 6))
        self.wind = still if world.gusts is None else world.gusts.sample(draws.gust_noise(beats, CHANNELS), world.dt)
        self._step = world.aircraft.compiled_step()
        n = len(world.start)
        self.states = np.full((runs, beats + 1, n), np.nan)
        self.flown = np.full((runs, beats, world.substeps, 4), np.nan)
        self.taken = np.full((runs, beats), -1)
        self.illegal = 0
        self._low, self._high = world.aircraft.control_lower, world.aircraft.control_upper
        self.begin(0)

    def begin(self, manoeuvre: int) -> None:
        """Put the aircraft at the start of a manoeuvre, off by its initial error."""
        world = self.world
        self.manoeuvre = manoeuvre
        self.state = _EULER.retract(world.start, world.draws.initial_error[manoeuvre])
        self.states[manoeuvre, 0] = self.state
        self._queue = [world.controls[min(k, world.beats - 1)] for k in range(world.delay)]
        self._position = self._effective = world.controls[0].copy()

    def measure(self, beat: int) -> Array:
        """Measured state, with the sensors' noise."""
        return _EULER.retract(self.state, self.noise[self.manoeuvre, beat])

    def command(self, values: tuple[float, ...] | Array) -> bool:
        """Take a command; one beyond the limits is not flown."""
        control = np.asarray(values)
        margin = 1e-9
        if (
            not (np.isfinite(control).all() and (control >= self._low - margin).all())
            or (control > self._high + margin).any()
        ):
            self.illegal += 1
            return False
        if self.world.delay:
            self._queue[-1] = control
        else:
            self._effective = control
        return True

    def next_beat(self) -> None:
        """Let the delayed commands move up; a beat without a command repeats the last."""
        if self.world.delay:
            self._effective = self._queue.pop(0)
            self._queue.append(self._queue[-1] if self._queue else self._effective)

    def advance(self, beat: int, substep: int) -> None:
        """Fly a substep."""
        world, m = self.world, self.manoeuvre
        seconds = world.dt / world.substeps
        if world.actuators is None:
            self._position = self._effective
        else:
            self._position = world.actuators.move(self._position, self._effective, seconds)
        self.flown[m, beat, substep] = self._position
        self.state = fly_substep(
            world.aircraft,
            self._step,
            self.state,
            self._position,
            world.draws.parameters[m],
            self.wind[m, beat],
            seconds,
        )
        if substep == world.substeps - 1:
            self.states[m, beat + 1] = self.state

    def truth(self, manoeuvres: int) -> Truth:
        """What happened, of the first manoeuvres."""
        return Truth(
            self.states[:manoeuvres],
            self.flown[:manoeuvres],
            self.wind[:manoeuvres],
            self.world.draws.parameters[:manoeuvres],
            self.taken[:manoeuvres],
            self.illegal,
            manoeuvres,
        )


def fly_substep(
    aircraft: Aircraft,
    compiled: Any,
    state: Array,
    control: Array,
    parameters: Array,
    wind: Array,
    seconds: float,
) -> Array:
    """State (n,) after a substep, by the aircraft's compiled step where it has one."""
    if compiled is None:
        return step(aircraft, state, control, seconds, parameters=parameters, wind=wind)
    return np.asarray(compiled(state[None], control[None], parameters[None], wind[None], seconds, 1)[0])
