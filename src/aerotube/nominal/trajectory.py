"""A nominal trajectory: what the aircraft would fly undisturbed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.aircraft.trim import trim
from aerotube.dynamics.step import step
from aerotube.errors import ComputationError, InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Nominal:
    """Nominal states and controls on a uniform time grid.

    Attributes
    ----------
    dt : float
        Length of a beat, s.
    states : ndarray (T + 1, 13 or more)
        Full states at the start of each beat, and at the end of the last.
    controls : ndarray (T, 4)
        Controls held during each beat.
    source : str
        Where it comes from, in words.
    """

    dt: float
    states: Array
    controls: Array
    source: str = ""

    def __post_init__(self) -> None:
        states, controls = np.asarray(self.states, dtype=float), np.asarray(self.controls, dtype=float)
        if not (np.isfinite(self.dt) and self.dt > 0):
            raise InputError(f"nominal: the length of a beat is {self.dt}; give a positive number of seconds.")
        if states.ndim != 2 or controls.ndim != 2 or len(states) != len(controls) + 1 or len(controls) == 0:
            raise InputError(
                f"nominal: states of shape {states.shape} and controls of shape {controls.shape} do not go "
                "together; give one more state than controls, and at least one beat."
            )
        if not (np.isfinite(states).all() and np.isfinite(controls).all()):
            raise InputError("nominal: states and controls must be finite numbers; find and mend the NaN.")
        object.__setattr__(self, "states", states)
        object.__setattr__(self, "controls", controls)

    @property
    def beats(self) -> int:
        """Number of beats T."""
        return len(self.controls)

    @property
    def times(self) -> Array:
        """Times of the states, s: ndarray (T + 1,)."""
        return np.asarray(self.dt * np.arange(self.beats + 1), dtype=np.float64)

    def check(self, aircraft: Aircraft) -> None:
        """Raise :class:`InputError` if the trajectory leaves the aircraft's model or its control limits."""
        tolerance = 1e-9
        for i, name in enumerate(aircraft.control_names):
            low, high = aircraft.control_lower[i], aircraft.control_upper[i]
            outside = (self.controls[:, i] < low - tolerance) | (self.controls[:, i] > high + tolerance)
            if outside.any():
                beat = int(np.argmax(outside))
                raise InputError(
                    f"nominal: the {name} is {self.controls[beat, i]:.6g} {aircraft.control_units[i]} at beat "
                    f"{beat}, beyond its limits of {low:.6g} to {high:.6g}; choose a control within them."
                )
        inside = aircraft.in_domain(self.states)
        if not inside.all():
            index = int(np.argmin(inside))
            reason = aircraft.domain_violation(self.states[index])
            raise InputError(
                f"nominal: at {self.times[index]:.6g} s the trajectory is outside the aircraft's model "
                f"({reason}); shorten the horizon or change the manoeuvre."
            )


def constant_controls(
    aircraft: Aircraft, state: Array, control: Array, dt: float, beats: int, source: str = "constant controls"
) -> Nominal:
    """Fly an aircraft from a state with its controls held (the paper's nominal, Section 4.2).

    Parameters
    ----------
    aircraft : Aircraft
    state : ndarray (13 or more,)
        Full state at the start.
    control : ndarray (4,) or (beats, 4)
        Controls, constant or one row a beat.
    dt : float
        Length of a beat, s.
    beats : int
    source : str

    Returns
    -------
    Nominal

    Raises
    ------
    InputError
        If the start or the controls are outside the aircraft's model.
    ComputationError
        If the trajectory stops being finite.
    """
    controls = np.broadcast_to(np.asarray(control, dtype=float), (beats, 4)).copy()
    states = np.empty((beats + 1, len(np.asarray(state))))
    states[0] = state
    if not aircraft.in_domain(states[0]):
        raise InputError(
            f"nominal: the initial state is outside the aircraft's model ({aircraft.domain_violation(states[0])}); "
            "choose one inside it."
        )
    for beat in range(beats):
        states[beat + 1] = step(aircraft, states[beat], controls[beat], dt)
        if not np.isfinite(states[beat + 1]).all():
            raise ComputationError(f"nominal: the trajectory diverges in beat {beat} ({beat * dt:.6g} s).")
    return Nominal(dt, states, controls, source)


def from_trim(
    aircraft: Aircraft,
    speed: float,
    altitude: float,
    turn_rate: float = 0.0,
    flight_path: float = 0.0,
    dt: float = 0.05,
    beats: int = 60,
) -> Nominal:
    """Fly an aircraft from a trimmed state, its trimmed controls held.

    Parameters
    ----------
    aircraft : Aircraft
    speed : float
        Airspeed, m/s.
    altitude : float
        m.
    turn_rate : float
        Rate of turn, rad/s; coordinated.
    flight_path : float
        Angle of climb, rad.
    dt : float
        Length of a beat, s.
    beats : int

    Returns
    -------
    Nominal
    """
    state, control = trim(aircraft, speed, altitude, turn_rate=turn_rate, flight_path=flight_path)
    source = f"trim at {speed:.6g} m/s, {altitude:.6g} m, turning at {np.degrees(turn_rate):.6g} deg/s"
    return constant_controls(aircraft, state, control, dt, beats, source)
