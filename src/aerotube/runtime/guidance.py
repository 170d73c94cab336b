"""Where the nominal comes from in flight: as planned, or moved again and again while it is flown."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.dynamics.step import step
from aerotube.errors import InputError
from aerotube.nominal import Nominal

Array = NDArray[np.float64]


class Guidance:
    """The nominal of each manoeuvre, window by window.

    Parameters
    ----------
    aircraft : Aircraft
        Of the nominal: thirteen states.
    nominal : Nominal
        As planned before take-off.
    change : float
        Each time a window is asked for, the controls from its first beat on are moved by up to this share of their
        travel, and the states that follow are flown anew. Zero: the nominal stays as planned.
    seed : int
    """

    def __init__(self, aircraft: Aircraft, nominal: Nominal, change: float = 0.0, seed: int = 0) -> None:
        if not 0 <= change <= 0.5:
            raise InputError(f"guidance: a change of {change:g} of the controls' travel is asked for; give 0 to 0.5.")
        self.aircraft, self.planned, self.change = aircraft, nominal, change
        self._seed = seed
        self._now = nominal
        self._manoeuvre = 0

    def update(self, manoeuvre: int, first: int) -> Nominal:
        """The nominal of a manoeuvre, as decided when the window from beat `first` is about to be computed.

        Beats before `first` are as they were. A change that would leave the aircraft's model is not made.
        """
        if manoeuvre != self._manoeuvre:
            self._manoeuvre, self._now = manoeuvre, self.planned
        if not self.change:
            return self._now
        random = np.random.default_rng([self._seed, manoeuvre, first])
        low, high = self.aircraft.control_lower, self.aircraft.control_upper
        # from the plan and not from the last change, so that a long flight does not wander off
        moved = self.planned.controls[first:] + 0.5 * self.change * (high - low) * random.uniform(-1.0, 1.0, 4)
        controls, states = self._now.controls.copy(), self._now.states.copy()
        controls[first:] = np.clip(moved, low, high)
        for beat in range(first, self._now.beats):
            states[beat + 1] = _step(self.aircraft, states[beat], controls[beat], self._now.dt)
        if np.isfinite(states).all() and self.aircraft.in_domain(states).all():
            self._now = Nominal(self._now.dt, states, controls, "re-planned in flight")
        return self._now


def _step(aircraft: Aircraft, state: Array, control: Array, dt: float) -> Array:
    compiled = aircraft.compiled_step()
    if compiled is None:
        return step(aircraft, state, control, dt)
    parameters = np.asarray(aircraft.parameter_nominal, dtype=float)
    return np.asarray(compiled(state[None], control[None], parameters[None], np.zeros((1, 6)), dt, 1)[0])
