"""What the aircraft's process is given, and what it sends home."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.flight.draws import Draws
from aerotube.flight.gusts import Dryden
from aerotube.runtime.actuators import Actuators

Array = NDArray[np.float64]


@dataclass(frozen=True)
class World:
    """What the aircraft meets; can be sent to another process.

    Attributes
    ----------
    aircraft : Aircraft
        Flies; it may have states of its own after the nominal's.
    start : ndarray (n,)
        Its state at the start of every manoeuvre, undisturbed.
    controls : ndarray (T, 4)
        Of the nominal: flown until the first command is through the delay.
    dt : float
        Length of a beat, s.
    draws : Draws
        One run a manoeuvre.
    noise : float
        Sensor noise as a share of the disturbance box.
    gusts : Dryden or None
    actuators : Actuators or None
    delay : int
        Whole beats from a command to its effect.
    substeps : int
        Steps of the aircraft in a beat.
    speed : float
        Seconds of flight for one of the clock; infinite: no clock, every command is waited for.
    token : int
        Of the session.
    """

    aircraft: Aircraft
    start: Array
    controls: Array
    dt: float
    draws: Draws
    noise: float = 0.0
    gusts: Dryden | None = None
    actuators: Actuators | None = None
    delay: int = 0
    substeps: int = 5
    speed: float = 1.0
    token: int = 1

    @property
    def beats(self) -> int:
        """Beats of a manoeuvre."""
        return len(self.controls)

    @property
    def manoeuvres(self) -> int:
        """How often the manoeuvre is flown."""
        return self.draws.runs


@dataclass(frozen=True)
class Truth:
    """What really happened.

    Attributes
    ----------
    states : ndarray (manoeuvre, T + 1, n)
    flown : ndarray (manoeuvre, T, substep, 4)
        Positions of the controls.
    wind : ndarray (manoeuvre, T, 6)
    parameters : ndarray (manoeuvre, p)
    taken : ndarray (manoeuvre, T) of int
        Substep from which the beat's own command was there; -1: never.
    illegal : int
        Commands that were not finite or beyond the limits: not flown.
    flown_manoeuvres : int
        Less than were asked for where the session ended early.
    """

    states: Array
    flown: Array
    wind: Array
    parameters: Array
    taken: NDArray[np.int64]
    illegal: int
    flown_manoeuvres: int
