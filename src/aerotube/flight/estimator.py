"""An extended Kalman filter for the error from the nominal, the parameters of a run, and the gusts it meets.

The estimate is predicted through the full nonlinear model, with the control that was flown. Its covariance is
predicted with the error map linearised along the nominal; so gains are the same for every run and are computed
before the flight, and a beat costs one step of the model. Parameters (the mass) are states that do not change,
gusts are the states of their filters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.dynamics.errors import ErrorCoordinates
from aerotube.dynamics.step import step
from aerotube.errors import InputError
from aerotube.flight.gusts import Dryden, GustModel
from aerotube.nominal import Nominal

Array = NDArray[np.float64]

# A sensor without any error would make the innovation covariance singular; in m/s, rad and rad/s.
_LEAST_NOISE = 1e-6
# What linearising along the nominal leaves out in a beat, as a share of the disturbance box: enough to keep the
# filter from believing in directions that it has not seen, too little to cost accuracy.
_REMAINDER = 1e-3
_NO_GUST = GustModel(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((6, 0)))


@dataclass(frozen=True)
class Estimate:
    """What the filter believes.

    Attributes
    ----------
    error : ndarray (run, 8)
        In the filter's coordinates.
    parameters : ndarray (run, p)
    gust : ndarray (run, g)
        States of the gust's filters; none without gusts.
    """

    error: Array
    parameters: Array
    gust: Array


@dataclass(frozen=True)
class ExtendedKalmanFilter:
    """The filter; it holds no state of a flight, so many flights can share it.

    Attributes
    ----------
    model : Aircraft
    nominal : Nominal
    coordinates : ErrorCoordinates
    gains : ndarray (T, 8 + p + g, 8)
        From innovations to corrections of errors, parameters and gust, at each beat.
    covariances : ndarray (T, 8 + p + g, 8 + p + g)
        Of the estimate after the correction, as the filter believes.
    gusts : GustModel
        Its matrices are empty without gusts.
    """

    model: Aircraft
    nominal: Nominal
    coordinates: ErrorCoordinates
    gains: Array
    covariances: Array
    gusts: GustModel

    def start(self, runs: int) -> Estimate:
        """Estimate before the first measurement: on the nominal, nominal parameters, no gust."""
        parameters = np.tile(np.asarray(self.model.parameter_nominal, dtype=float), (runs, 1))
        return Estimate(np.zeros((runs, 8)), parameters, np.zeros((runs, len(self.gusts.transition))))

    def restart(self, estimate: Estimate, runs: NDArray[np.bool_]) -> Estimate:
        """Put the estimates of some runs (a mask) back to where a flight starts."""
        fresh = self.start(len(runs))
        where = runs[:, None]
        return Estimate(
            np.where(where, fresh.error, estimate.error),
            np.where(where, fresh.parameters, estimate.parameters),
            np.where(where, fresh.gust, estimate.gust),
        )

    def correct(self, beat: int, estimate: Estimate, measurement: Array) -> Estimate:
        """Take in a measurement.

        Parameters
        ----------
        beat : int
        estimate : Estimate
            Predicted for this beat.
        measurement : ndarray (run, 8)
            Measured errors in the filter's coordinates.

        Returns
        -------
        Estimate
        """
        correction = np.einsum("ij,rj->ri", self.gains[beat], measurement - estimate.error)
        first, last = 8, 8 + estimate.parameters.shape[1]
        return Estimate(
            estimate.error + correction[:, :first],
            estimate.parameters + correction[:, first:last],
            estimate.gust + correction[:, last:],
        )

    def predict(self, beat: int, estimate: Estimate, control: Array) -> Estimate:
        """Advance an estimate over a beat.

        Parameters
        ----------
        beat : int
        estimate : Estimate
            Corrected at this beat.
        control : ndarray (run, 4)
            The control flown during the beat.

        Returns
        -------
        Estimate
            For the next beat.
        """
        nominal = self.nominal
        state = self.coordinates.retract(nominal.states[beat], estimate.error)
        wind = None
        if self.gusts.transition.size:
            wind = np.einsum("ij,rj->ri", self.gusts.output, estimate.gust)
        state = step(self.model, state, control, nominal.dt, parameters=estimate.parameters, wind=wind)
        return Estimate(
            self.coordinates.difference(state, nominal.states[beat + 1]),
            estimate.parameters,
            np.einsum("ij,rj->ri", self.gusts.transition, estimate.gust),
        )


def extended_kalman_filter(
    model: Aircraft,
    nominal: Nominal,
    half_widths: Sequence[float] | Array,
    noise: float,
    *,
    mass_error: float = 0.0,
    other_parameters: Sequence[tuple[float, float]] = (),
    gusts: Dryden | None = None,
    coordinates: ErrorCoordinates | None = None,
) -> ExtendedKalmanFilter:
    """Design the filter for uniform initial errors, parameters and measurement noise.

    Parameters
    ----------
    model : Aircraft
        What the filter predicts with.
    nominal : Nominal
    half_widths : sequence of 8 floats
        The disturbance box, as for :func:`aerotube.flight.draw`.
    noise : float
        Fraction of the box that the measurement noise fills; not negative.
    mass_error, other_parameters
        As for :func:`aerotube.flight.draw`.
    gusts : Dryden, optional
        Turbulence to reckon with.
    coordinates : ErrorCoordinates, optional
        Of the estimate; relative by default.

    Returns
    -------
    ExtendedKalmanFilter

    Raises
    ------
    InputError
        If the noise is negative or more parameters are given than the model has.
    """
    if not (np.isfinite(noise) and noise >= 0):
        raise InputError(f"estimator: the noise must be a fraction, not negative; got {noise!r}.")
    coordinates = coordinates or ErrorCoordinates()
    box = np.asarray(half_widths, dtype=float)
    # 1 / (1 + e) has the variance of e up to its square.
    ranges = [(-mass_error, mass_error), *other_parameters]
    p = len(model.parameter_nominal)
    if len(ranges) > p:
        raise InputError(f"estimator: {len(ranges)} uncertain parameters given, the model has {p}.")
    variance = np.zeros(p)
    variance[: len(ranges)] = [(upper - lower) ** 2 / 12 for lower, upper in ranges]

    air = _NO_GUST if gusts is None else gusts.discretise(nominal.dt)
    transition = _transition(model, nominal, coordinates, np.maximum(box, 1e-3), air)
    to_coordinates = _euler_jacobian(nominal, coordinates)
    sensor = np.maximum(noise * box, _LEAST_NOISE) ** 2 / 3
    last = 8 + p
    size = last + len(air.transition)
    added, covariance = np.zeros((size, size)), np.zeros((size, size))
    added[:8, :8] = np.diag((_REMAINDER * box) ** 2)
    added[last:, last:] = air.gathered
    covariance[:8, :8] = (to_coordinates[0] * (box**2 / 3)) @ to_coordinates[0].T
    covariance[8:last, 8:last] = np.diag(variance)
    covariance[last:, last:] = air.stationary
    gains, covariances = np.empty((nominal.beats, size, 8)), np.empty((nominal.beats, size, size))
    observe = np.eye(8, size)
    for t in range(nominal.beats):
        measured = (to_coordinates[t] * sensor) @ to_coordinates[t].T
        gains[t] = np.linalg.solve(covariance[:8, :8] + measured, covariance[:8]).T
        # Joseph's form: positive semidefinite whatever the rounding.
        keep = np.eye(size) - gains[t] @ observe
        covariances[t] = keep @ covariance @ keep.T + gains[t] @ measured @ gains[t].T
        covariance = transition[t] @ covariances[t] @ transition[t].T + added
    return ExtendedKalmanFilter(model, nominal, coordinates, gains, covariances, air)


def _transition(
    model: Aircraft, nominal: Nominal, coordinates: ErrorCoordinates, scale: Array, air: GustModel
) -> Array:
    """Transition matrices of errors, parameters and gust, one a beat, by central differences.

    Differences over a tenth of the disturbance, not derivatives: across the kinks of linear tables a slope over
    the range where the estimate moves says more than the slope of one piece.
    """
    p = len(model.parameter_nominal)
    steps = 0.1 * np.concatenate([scale, np.full(p, 0.1), [10.0, 10.0, 10.0, 0.1, 0.1, 0.1]])
    last, count = 8 + p, len(steps)
    points = np.concatenate([np.diag(steps), -np.diag(steps)])
    after = coordinates.difference(
        step(
            model,
            coordinates.retract(nominal.states[:-1, None, :], points[:, :8]),
            nominal.controls[:, None, :],
            nominal.dt,
            parameters=points[:, 8:last] + np.asarray(model.parameter_nominal),
            wind=points[:, last:],
        ),
        nominal.states[1:, None, :],
    )
    slopes = np.swapaxes((after[:, :count] - after[:, count:]) / (2 * steps[:, None]), -1, -2)
    size = last + len(air.transition)
    out = np.zeros((nominal.beats, size, size))
    out[:, :8, :last] = slopes[..., :last]
    out[:, :8, last:] = slopes[..., last:] @ air.output
    out[:, 8:last, 8:last] = np.eye(p)
    out[:, last:, last:] = air.transition
    return out


def _euler_jacobian(nominal: Nominal, coordinates: ErrorCoordinates) -> Array:
    """Derivative of the coordinates with respect to differences of Euler angles, at every beat (T, 8, 8)."""
    width = 1e-5
    states = nominal.states[:-1, None, :]
    offsets = width * np.concatenate([np.eye(8), -np.eye(8)])
    moved = coordinates.difference(ErrorCoordinates("euler").retract(states, offsets), states)
    return np.asarray(np.swapaxes(moved[:, :8] - moved[:, 8:], -1, -2) / (2 * width))
