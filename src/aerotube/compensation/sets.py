"""From a disturbance set to the initial ellipsoid of each part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerotube.compensation.settings import Part
from aerotube.dynamics import ErrorCoordinates
from aerotube.tube import DisturbanceBox, ellipsoid

Array = NDArray[np.float64]


@dataclass(frozen=True)
class InitialEllipsoid:
    """Initial ellipsoids ``x' shape x <= rho`` of a part, of a batch of beats.

    Attributes
    ----------
    widths : ndarray (b, n)
        Half-widths of the disturbance box in the law's error coordinates.
    shape, rho : ndarray (b, n, n), (b,)
    whitening : ndarray (b, n, n)
        ``x = whitening @ z`` is on the boundary for unit z.
    """

    widths: Array
    shape: Array
    rho: Array
    whitening: Array


def initial_ellipsoid(
    disturbance: DisturbanceBox, coordinates: ErrorCoordinates, states: Array, part: Part
) -> InitialEllipsoid:
    """Ellipsoids of least volume around a part's disturbances.

    Parameters
    ----------
    disturbance : DisturbanceBox
    coordinates : ErrorCoordinates
    states : ndarray (b, 13)
        Nominal states at the start of the beats.
    part : Part

    Returns
    -------
    InitialEllipsoid
    """
    widths = coordinates.box(states, disturbance.half_widths)[:, part.errors]
    shape, rho = ellipsoid.least_volume_around_box(widths)
    return InitialEllipsoid(widths, shape, rho, ellipsoid.whitening(shape, rho))
