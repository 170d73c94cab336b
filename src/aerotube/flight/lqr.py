"""The baseline: a time-varying linear-quadratic regulator along the nominal, and the best of a sweep of them.

Its cost is the square of Eq. 18, by which it will be judged, plus a weight on the controls; the noise weight makes
it gentle where the measurements are noisy (:func:`aerotube.tube.shapes.cost_to_go`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.compensation.law import LinearLaw
from aerotube.dynamics.error_map import Linearisation
from aerotube.dynamics.errors import ErrorCoordinates
from aerotube.errors import InputError
from aerotube.flight.draws import Draws
from aerotube.flight.estimator import ExtendedKalmanFilter
from aerotube.flight.gusts import Dryden
from aerotube.flight.simulate import simulate
from aerotube.nominal import Nominal
from aerotube.tube.shapes import cost_to_go, tracking_weights

Array = NDArray[np.float64]

#: The sweep of :func:`best_lqr`: weights of the controls and of the noise.
CONTROL_WEIGHTS = (1e-4, 1e-3, 1e-2, 1e-1)
NOISE_WEIGHTS = (0.0, 1.0, 2.0, 4.0, 8.0)


def time_varying_lqr(
    aircraft: Aircraft,
    nominal: Nominal,
    linearisation: Linearisation,
    coordinates: ErrorCoordinates,
    control_weight: float = 1e-2,
    noise_weight: float = 0.0,
) -> LinearLaw:
    """Regulator along a nominal, for the cost of Eq. 18.

    Parameters
    ----------
    aircraft : Aircraft
        Gives the half-ranges by which the virtual controls are measured.
    nominal : Nominal
    linearisation : Linearisation
        Of the error map, in the same coordinates.
    coordinates : ErrorCoordinates
    control_weight : float
        Cost of a virtual control moved by half its range at one beat; positive.
    noise_weight : float
        See :func:`aerotube.tube.shapes.cost_to_go`; not negative.

    Returns
    -------
    LinearLaw

    Raises
    ------
    InputError
        If a weight is out of its range.
    """
    if not (np.isfinite(control_weight) and control_weight > 0):
        raise InputError(f"LQR: the control weight must be positive; got {control_weight!r}.")
    lower, upper = aircraft.virtual_limits(nominal.states[:-1], nominal.controls)
    half_range = 0.5 * (upper - lower)
    # In controls scaled by their range the weight is a multiple of the identity: newtons and radians never meet.
    weight = np.broadcast_to(control_weight * np.eye(half_range.shape[-1]), (nominal.beats, *2 * half_range.shape[-1:]))
    _, gains = cost_to_go(
        linearisation.A,
        linearisation.B * half_range[:, None, :],
        tracking_weights(nominal.states, coordinates),
        weight,
        noise_weight,
    )
    return LinearLaw(half_range[:, :, None] * gains, coordinates)


@dataclass(frozen=True)
class LqrSweep:
    """Outcome of a sweep of regulators.

    Attributes
    ----------
    law : LinearLaw
        The best one.
    control_weight, noise_weight : float
        Its weights.
    control_weights, noise_weights : tuple of float
        The sweep.
    scores : ndarray (control weight, noise weight)
        Mean upper error, mean over the seeds; infinite where a run diverged.
    seeds : tuple of int
    runs_per_seed : int
    noise : float
        The draws and the fraction of measurement noise that it was chosen on.
    """

    law: LinearLaw
    control_weight: float
    noise_weight: float
    control_weights: tuple[float, ...]
    noise_weights: tuple[float, ...]
    scores: Array
    seeds: tuple[int, ...]
    runs_per_seed: int
    noise: float


def best_lqr(
    aircraft: Aircraft,
    nominal: Nominal,
    linearisation: Linearisation,
    coordinates: ErrorCoordinates,
    draws: Draws,
    *,
    noise: float = 0.0,
    estimator: ExtendedKalmanFilter | None = None,
    gusts: Dryden | None = None,
    control_weights: Sequence[float] = CONTROL_WEIGHTS,
    noise_weights: Sequence[float] = NOISE_WEIGHTS,
    seeds: int = 3,
) -> LqrSweep:
    """Fly every regulator of a sweep and keep the one with the least mean upper error.

    Parameters
    ----------
    aircraft, nominal, linearisation, coordinates
        As for :func:`time_varying_lqr`; the aircraft is also the one that flies.
    draws : Draws
        Holds the draws on which it is chosen.
    noise : float
        Fraction of the disturbance box that the measurement noise fills.
    estimator : ExtendedKalmanFilter, optional
    gusts : Dryden, optional
    control_weights, noise_weights : sequences of float
        The sweep.
    seeds : int
        The choice is made on so many of the draws' seeds, the first ones; all regulators meet the same draws.

    Returns
    -------
    LqrSweep

    Raises
    ------
    InputError
        If the sweep is empty, or no seed is left.
    """
    if len(control_weights) == 0 or len(noise_weights) == 0:
        raise InputError("LQR: the sweep is empty; give at least one control weight and one noise weight.")
    if seeds < 1:
        raise InputError(f"LQR: the sweep needs at least one seed; got {seeds}.")
    laws = [
        time_varying_lqr(aircraft, nominal, linearisation, coordinates, control_weight, noise_weight)
        for control_weight in control_weights
        for noise_weight in noise_weights
    ]
    chosen = draws.repeated(len(laws), seeds)
    gains = np.stack([law.gains for law in laws])
    side_by_side = _SideBySide(gains, coordinates)
    flights = simulate(aircraft, nominal, side_by_side, chosen, noise=noise, estimator=estimator, gusts=gusts)
    errors = flights.mean_upper_error().reshape(len(laws), -1).mean(axis=1)
    for divergence in flights.diverged:
        errors[divergence.run * len(laws) // chosen.runs] = np.inf
    best = int(np.argmin(errors))
    i, j = divmod(best, len(noise_weights))
    return LqrSweep(
        laws[best],
        float(control_weights[i]),
        float(noise_weights[j]),
        tuple(map(float, control_weights)),
        tuple(map(float, noise_weights)),
        errors.reshape(len(control_weights), len(noise_weights)),
        draws.seeds[:seeds],
        draws.runs_per_seed,
        float(noise),
    )


@dataclass(frozen=True)
class _SideBySide:
    """Many linear laws flown side by side: the runs are split evenly among the gains (law, T, 4, 8)."""

    gains: Array
    coordinates: ErrorCoordinates

    def increment(self, beat: int, error: Array) -> Array:
        shared = error.reshape(len(self.gains), -1, 8)
        return np.asarray(shared @ np.swapaxes(self.gains[:, beat], -1, -2)).reshape(-1, 4)
