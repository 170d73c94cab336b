"""Sweeps of the baselines: many laws of a kind flown side by side on the same draws, and the best of them kept."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

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
from aerotube.flight.inversion import DynamicInversion, Held
from aerotube.flight.lqr import time_varying_lqr
from aerotube.flight.simulate import Flights, Law, simulate
from aerotube.nominal import Nominal

Array = NDArray[np.float64]

#: The sweep of :func:`best_lqr`: weights of the controls and of the noise.
CONTROL_WEIGHTS = (1e-4, 1e-3, 1e-2, 1e-1)
NOISE_WEIGHTS = (0.0, 1.0, 2.0, 4.0, 8.0)

#: The sweep of :func:`best_inversion`, 1/s: bandwidths of the body rates, of the slow angles, and of the airspeed.
RATE_GAINS = (1.0, 2.0, 4.0, 8.0, 14.0, 20.0)
ANGLE_GAINS = (0.25, 0.5, 1.0, 2.0, 4.0)
SPEED_GAINS = (1.0,)


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
    substeps: int = 1,
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
    substeps : int
        Integration steps of the flown aircraft in one beat.
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
    laws = [
        time_varying_lqr(aircraft, nominal, linearisation, coordinates, control_weight, noise_weight)
        for control_weight in control_weights
        for noise_weight in noise_weights
    ]
    side_by_side = _SideBySide(np.stack([law.gains for law in laws]), coordinates)
    fly = partial(simulate, aircraft, nominal, noise=noise, estimator=estimator, gusts=gusts, substeps=substeps)
    errors = _scores("LQR", fly, lambda _: side_by_side, len(laws), draws, seeds)
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
class InversionSweep:
    """Outcome of a sweep of inversions.

    Attributes
    ----------
    law : DynamicInversion
        The best one.
    tried : tuple of (str, float, float, float)
        Slow angle and gains of rates, angles and airspeed.
    scores : ndarray (tried,)
        Mean upper error, mean over the seeds; infinite where a run diverged.
    seeds : tuple of int
        On whose draws it was chosen.
    """

    law: DynamicInversion
    tried: tuple[tuple[Held, float, float, float], ...]
    scores: Array
    seeds: tuple[int, ...]

    @property
    def words(self) -> str:
        """The gains that were chosen, in words."""
        held, rate, angle, speed = self.tried[int(np.argmin(self.scores))]
        return (
            f"pitching holds the {'angle of attack' if held == 'attack' else 'pitch angle'}, gains {rate:g} (rates), "
            f"{angle:g} (angles), {speed:g} (airspeed) 1/s: the best of {len(self.tried)} on the draws of "
            f"{len(self.seeds)} seed(s)"
        )


def best_inversion(
    aircraft: Aircraft,
    nominal: Nominal,
    draws: Draws,
    *,
    noise: float = 0.0,
    estimator: ExtendedKalmanFilter | None = None,
    gusts: Dryden | None = None,
    rate_gains: Sequence[float] = RATE_GAINS,
    angle_gains: Sequence[float] = ANGLE_GAINS,
    speed_gains: Sequence[float] = SPEED_GAINS,
    held: Sequence[Held] = ("attack", "pitch"),
    seeds: int = 3,
) -> InversionSweep:
    """Fly every inversion of a sweep and keep the one with the least mean upper error.

    Parameters
    ----------
    aircraft : Aircraft
        Is inverted, and flies.
    nominal : Nominal
    draws, noise, estimator, gusts, seeds
        As for :func:`best_lqr`.
    rate_gains, angle_gains, speed_gains, held
        The sweep; see :class:`DynamicInversion`.

    Returns
    -------
    InversionSweep

    Raises
    ------
    InputError
        If the sweep is empty, or no seed is left.
    """
    gains = list(itertools.product(rate_gains, angle_gains, speed_gains))
    tried = tuple((angle, *each) for angle in held for each in gains)
    if not tried:
        raise InputError("dynamic inversion: the sweep is empty; give at least one gain of each kind.")
    fly = partial(simulate, aircraft, nominal, noise=noise, estimator=estimator, gusts=gusts)

    def side_by_side(angle: Held, runs: int) -> DynamicInversion:
        rate, slow, speed = (np.repeat(each, runs) for each in zip(*gains, strict=True))
        return DynamicInversion(aircraft, nominal, rate, slow, speed, angle)

    errors = [
        _scores("dynamic inversion", fly, partial(side_by_side, angle), len(gains), draws, seeds) for angle in held
    ]
    scores = np.concatenate(errors)
    best = tried[int(np.argmin(scores))]
    law = DynamicInversion(aircraft, nominal, *best[1:], best[0])
    return InversionSweep(law, tried, scores, draws.seeds[:seeds])


def _scores(
    name: str, fly: Callable[[Law, Draws], Flights], laws: Callable[[int], Law], count: int, draws: Draws, seeds: int
) -> Array:
    """Mean upper errors (count,) of so many laws on the same draws; infinite where a run diverged.

    Given the runs of each, the laws come side by side as one: the runs of the first, then those of the second.
    """
    if seeds < 1:
        raise InputError(f"{name}: the sweep needs at least one seed; got {seeds}.")
    shared = draws.repeated(count, seeds)
    runs = shared.runs // count
    flights = fly(laws(runs), shared)
    errors = flights.mean_upper_error().reshape(count, -1).mean(axis=1)
    errors[[divergence.run // runs for divergence in flights.diverged]] = np.inf
    return np.asarray(errors)


@dataclass(frozen=True)
class _SideBySide:
    """Many linear laws flown side by side: the runs are split evenly among the gains (law, T, 4, 8)."""

    gains: Array
    coordinates: ErrorCoordinates

    def increment(self, beat: int, error: Array) -> Array:
        shared = error.reshape(len(self.gains), -1, 8)
        return np.asarray(shared @ np.swapaxes(self.gains[:, beat], -1, -2)).reshape(-1, 4)
