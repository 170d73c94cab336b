"""Steady flight: the state and controls at which nothing but heading and position changes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft, state_derivatives
from aerotube.aircraft.rigid_body import velocity_from_flow
from aerotube.errors import ComputationError, InputError
from aerotube.numerics import quaternion_from_euler

Array = NDArray[np.float64]

_TOLERANCE = 1e-8  # m/s2 and rad/s2, of the accelerations left over
_ATTACKS = np.deg2rad([3.0, 10.0, 20.0, 0.0])


def trim(
    aircraft: Aircraft,
    speed: float,
    altitude: float,
    turn_rate: float = 0.0,
    flight_path: float = 0.0,
) -> tuple[Array, Array]:
    """Steady, coordinated flight: level, climbing or turning.

    Solves for the attitude and the controls at which the body accelerations vanish, the flight path has the given
    angle, and the side force across the body vanishes (ball centred; wings level when not turning).

    Parameters
    ----------
    aircraft : Aircraft
    speed : float
        Airspeed (m/s).
    altitude : float
        Altitude (m).
    turn_rate : float
        Rate of heading (rad/s), positive to the right.
    flight_path : float
        Angle of climb (rad).

    Returns
    -------
    state : array (n,)
        Heading north, at north = east = 0.
    control : array (m,)

    Raises
    ------
    InputError
        If the speed is not positive, an argument is not finite, or a climb is vertical.
    ComputationError
        If no such flight is found within the control limits and the range of the model.

    References
    ----------
    B. L. Stevens, F. L. Lewis, E. N. Johnson, *Aircraft Control and Simulation*, 3rd ed., section 3.6.
    """
    if not np.all(np.isfinite([speed, altitude, turn_rate, flight_path])) or speed <= 0.0:
        raise InputError("trim needs a positive speed (m/s) and finite altitude, turn rate and flight path")
    if abs(flight_path) >= 0.5 * np.pi:
        raise InputError(f"trim cannot climb at {np.rad2deg(flight_path):.6g} deg; ask for less than 90 deg")

    def assemble(unknown: Array) -> tuple[Array, Array]:
        attack, sideslip, pitch, roll = unknown[:4]
        control = unknown[4:]
        body = (
            *velocity_from_flow(speed, attack, sideslip),
            *quaternion_from_euler(roll, pitch, 0.0),
            -turn_rate * np.sin(pitch),
            turn_rate * np.cos(pitch) * np.sin(roll),
            turn_rate * np.cos(pitch) * np.cos(roll),
            0.0,
            0.0,
            altitude,
        )
        return np.array([*body, *aircraft.settled(tuple(control))]), control

    def residual(unknown: Array) -> Array:
        state, control = assemble(unknown)
        rates = state_derivatives(aircraft, state, control)
        u, _v, w, q0, q1, q2, q3, p, _q, r = state[:10]
        across = rates[1] - (p * w - r * u) - 2.0 * aircraft.gravity * (q2 * q3 + q0 * q1)
        climb = rates[12] / speed - np.sin(flight_path)
        return np.array([*rates[[0, 1, 2, 7, 8, 9]], across, climb])

    bank = np.arctan2(speed * turn_rate, aircraft.gravity)
    asked = (
        f"{speed:.6g} m/s at {altitude:.6g} m, turning {np.rad2deg(turn_rate):.6g} deg/s, "
        f"climbing {np.rad2deg(flight_path):.6g} deg"
    )
    state, control = assemble(_solve(residual, bank, flight_path, asked, aircraft.name))
    _check(aircraft, state, control, asked)
    return state, control


def _solve(residual: Callable[[Array], Array], bank: float, flight_path: float, asked: str, name: str) -> Array:
    """Attack, sideslip, pitch, roll and the controls that bring the residual to zero."""
    from scipy.optimize import root  # slow to import

    least = np.inf
    for attack in _ATTACKS:
        guess = np.array([attack, 0.0, flight_path + attack * np.cos(bank), bank, -0.02, 0.4, 0.0, 0.0])
        # tables read linearly have kinks, on which one method may stall where the other does not
        for method in ("hybr", "lm"):
            found = root(residual, guess, method=method, tol=1e-13)
            left = float(np.max(np.abs(found.fun)))
            if left <= _TOLERANCE:
                return np.asarray(found.x, dtype=np.float64)
            least = min(least, left)
    raise ComputationError(
        f"the aircraft {name} has no trim at {asked}: an acceleration of {least:.3g} (m/s2, rad/s2) is left "
        "over; try another speed or a gentler turn or climb"
    )


def _check(aircraft: Aircraft, state: Array, control: Array, asked: str) -> None:
    limits = zip(aircraft.control_names, control, aircraft.control_lower, aircraft.control_upper, strict=True)
    for name, value, low, high in limits:
        if not low <= value <= high:
            raise ComputationError(
                f"trim of the aircraft {aircraft.name} at {asked} needs {name} {value:.6g}, beyond its limits "
                f"{low:.6g} to {high:.6g}; try another speed or a gentler turn or climb"
            )
    violation = aircraft.domain_violation(state)
    if violation is not None:
        raise ComputationError(f"trim of the aircraft {aircraft.name} at {asked}: {violation}")
