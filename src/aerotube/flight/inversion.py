r"""A baseline: nonlinear dynamic inversion about the nominal, in two time scales.

Inside, the body rates and the airspeed: controls are sought that give the accelerations

.. math:: \dot\omega = \dot{\bar\omega} + k_\omega(\omega_c - \omega), \qquad
          \dot V = \dot{\bar V} + k_V(\bar V - V)

at the measured state, by Newton's method on the aircraft's own equations of motion (the control effectiveness is
their slope there). Outside, the slow angles y (roll, angle of attack or pitch, sideslip), whose rates are
kinematically :math:`\dot y = g + G(y)\omega`: the rates asked for are those that would give
:math:`\dot y = \dot{\bar y} + k_y(\bar y - y)`. Without an error the nominal controls result.

S. A. Snell, D. F. Enns, W. L. Garrard, "Nonlinear inversion flight control for a supermaneuverable aircraft",
*J. Guidance, Control, and Dynamics* 15 (1992) 976-984.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.aircraft.rigid_body import flow_angles
from aerotube.dynamics.components import split
from aerotube.dynamics.errors import ErrorCoordinates
from aerotube.errors import InputError
from aerotube.nominal import Nominal
from aerotube.numerics import euler_from_quaternion

Array = NDArray[np.float64]
Held = Literal["attack", "pitch"]

_FAST = (7, 8, 9)
_NEWTON_STEPS = 4


@dataclass(frozen=True)
class DynamicInversion:
    """Nonlinear dynamic inversion about a nominal.

    Attributes
    ----------
    aircraft : Aircraft
        Whose equations of motion are inverted, of thirteen states and nominal parameters.
    nominal : Nominal
    rate_gain, angle_gain, speed_gain : float or ndarray (run,)
        Bandwidths of body rates, slow angles and airspeed, 1/s; not negative.
    held : {"attack", "pitch"}
        The slow angle that pitching holds.
    coordinates : ErrorCoordinates
        In which it is given the error.
    newton_steps : int
        Most steps of Newton's method; one is exact where the accelerations are affine in the controls.

    Raises
    ------
    InputError
        For a negative gain or an unknown angle.
    """

    aircraft: Aircraft
    nominal: Nominal
    rate_gain: float | Array = 8.0
    angle_gain: float | Array = 1.0
    speed_gain: float | Array = 0.3
    held: Held = "attack"
    coordinates: ErrorCoordinates = field(default_factory=ErrorCoordinates)
    newton_steps: int = _NEWTON_STEPS

    def __post_init__(self) -> None:
        if self.held not in ("attack", "pitch"):
            raise InputError(f"dynamic inversion: unknown slow angle {self.held!r}; choose 'attack' or 'pitch'.")
        for name in ("rate_gain", "angle_gain", "speed_gain"):
            if not np.all(np.asarray(getattr(self, name)) >= 0):
                raise InputError(f"dynamic inversion: {name} is {getattr(self, name)!r}; it must not be negative.")

    def increment(self, beat: int, error: Array) -> Array:
        """Increments of the virtual controls at a beat.

        Parameters
        ----------
        beat : int
        error : ndarray (run, 8)
            Measured error in `coordinates`.

        Returns
        -------
        ndarray (run, 4)
            Not cut to the control limits; not finite where the inversion fails.
        """
        control = self.nominal.controls[beat]
        reference = self.nominal.states[beat, None, :13]
        state = self.coordinates.retract(reference, np.asarray(error, dtype=float))
        with np.errstate(all="ignore"):
            return self.invert(state, control, self._asked(state, reference, control))

    def accelerations(self, state: Array, control: Array, increment: Array) -> Array:
        """Accelerations that the controls are to give: body rates' (rad/s2) and airspeed's (m/s2).

        Parameters
        ----------
        state : ndarray (run, 13)
        control : ndarray (4,)
        increment : ndarray (run, 4)
            Of the virtual controls.

        Returns
        -------
        ndarray (run, 4)
            Rates of p, q, r, V.
        """
        return _fast(state, self._rates(state, control, increment))

    def invert(self, state: Array, control: Array, asked: Array) -> Array:
        """Increments of the virtual controls that give accelerations at states.

        Parameters
        ----------
        state : ndarray (run, 13)
        control : ndarray (4,)
            The nominal control.
        asked : ndarray (run, 4)
            As from :meth:`accelerations`.

        Returns
        -------
        ndarray (run, 4)
        """
        increment = np.zeros((len(state), 4))
        probe = self._probe(control)
        for _ in range(self.newton_steps):
            left = asked - self.accelerations(state, control, increment)
            slopes = np.empty((len(state), 4, 4))
            for i, width in enumerate(probe):
                moved = increment.copy()
                moved[:, i] += width
                slopes[:, :, i] = (self.accelerations(state, control, moved) - asked + left) / width
            usable = np.asarray(np.isfinite(slopes).all((1, 2)) & np.isfinite(left).all(-1))
            slopes[~usable] = np.eye(4)
            step = np.linalg.solve(slopes, left[..., None])[..., 0]
            increment += np.where(usable[:, None], step, np.nan)
            if np.all(np.abs(step) <= 1e-6 * probe):
                break
        return increment

    def _probe(self, control: Array) -> Array:
        """Widths of the differences that give the control effectiveness: a thousandth of each range."""
        lower, upper = self.aircraft.virtual_limits(self.nominal.states[0], control)
        return np.asarray(1e-3 * np.maximum(upper - lower, 1e-9))

    def _rates(self, state: Array, control: Array, increment: Array) -> list[Array]:
        parts = self.aircraft.rates_virtual(split(state), tuple(control), split(increment))
        return [np.broadcast_to(part, state.shape[:1]) for part in parts]

    def _asked(self, state: Array, reference: Array, control: Array) -> Array:
        """Accelerations to ask for."""
        rates = self._rates(state, control, np.zeros((len(state), 4)))
        planned = self._rates(reference, control, np.zeros((1, 4)))
        slow, slow_rate, kinematics = _slow(state, rates, self.held)
        slow_planned, slow_rate_planned, _ = _slow(reference, planned, self.held)
        off = (slow_planned - slow + np.pi) % (2.0 * np.pi) - np.pi
        wanted = slow_rate_planned + np.asarray(self.angle_gain)[..., None] * off - slow_rate
        # The rates asked for are the present ones and a change that turns the slow rates into the wanted ones.
        change = np.linalg.solve(kinematics, wanted[..., None])[..., 0]
        airspeed, airspeed_planned = (np.linalg.norm(x[:, :3], axis=-1) for x in (state, reference))
        asked = np.array(np.broadcast_to(_fast(reference, planned), (len(state), 4)))
        asked[:, :3] += np.asarray(self.rate_gain)[..., None] * change
        asked[:, 3] += self.speed_gain * (airspeed_planned - airspeed)
        return asked


def _fast(state: Array, rates: Sequence[Array]) -> Array:
    """Rates of p, q, r, V."""
    u, v, w = state[:, 0], state[:, 1], state[:, 2]
    airspeed = np.sqrt(u * u + v * v + w * w)
    along = (u * rates[0] + v * rates[1] + w * rates[2]) / airspeed
    return np.stack([*(rates[i] for i in _FAST), along], axis=-1)


def _slow(state: Array, rates: Sequence[Array], held: Held) -> tuple[Array, Array, Array]:
    """Slow angles (run, 3), their rates, and the derivative of these with respect to the body rates (run, 3, 3)."""
    u, v, w, p, q, r = (state[:, i] for i in (0, 1, 2, 7, 8, 9))
    airspeed, attack, sideslip = flow_angles((u, v, w))
    roll, pitch, _ = euler_from_quaternion(tuple(state[:, i] for i in range(3, 7)))
    one, zero = np.ones_like(u), np.zeros_like(u)
    about_roll = np.stack([one, np.sin(roll) * np.tan(pitch), np.cos(roll) * np.tan(pitch)], axis=-1)
    about_pitch = np.stack([zero, np.cos(roll), -np.sin(roll)], axis=-1)
    body = np.stack([p, q, r], axis=-1)
    along = (u * rates[0] + v * rates[1] + w * rates[2]) / airspeed
    attack_rate = (u * rates[2] - w * rates[0]) / (u * u + w * w)
    sideslip_rate = (rates[1] - np.sin(sideslip) * along) / (airspeed * np.cos(sideslip))
    about_attack = np.stack([-np.cos(attack) * np.tan(sideslip), one, -np.sin(attack) * np.tan(sideslip)], axis=-1)
    about_sideslip = np.stack([np.sin(attack), zero, -np.cos(attack)], axis=-1)
    if held == "attack":
        middle, middle_rate, about_middle = attack, attack_rate, about_attack
    else:
        middle, middle_rate, about_middle = pitch, np.sum(about_pitch * body, axis=-1), about_pitch
    return (
        np.stack([roll, middle, sideslip], axis=-1),
        np.stack([np.sum(about_roll * body, axis=-1), middle_rate, sideslip_rate], axis=-1),
        np.stack([about_roll, about_middle, about_sideslip], axis=-2),
    )
