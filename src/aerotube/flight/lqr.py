"""A baseline: a time-varying linear-quadratic regulator along the nominal.

Its cost is the square of Eq. 18, by which it will be judged, plus a weight on the controls; the noise weight makes
it gentle where the measurements are noisy (:func:`aerotube.tube.shapes.cost_to_go`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.compensation.law import LinearLaw
from aerotube.dynamics.error_map import Linearisation
from aerotube.dynamics.errors import ErrorCoordinates
from aerotube.errors import InputError
from aerotube.nominal import Nominal
from aerotube.tube.shapes import cost_to_go, tracking_weights

Array = NDArray[np.float64]


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
