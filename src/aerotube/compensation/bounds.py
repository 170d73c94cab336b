"""What a tube's bound may rest on, what it is made of, and the whole set that it is for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.compensation.sets import initial_ellipsoid
from aerotube.compensation.settings import Part
from aerotube.dynamics import BeatSet, ErrorCoordinates, beat_set
from aerotube.tube import DisturbanceSet, parameter_ranges

Array = NDArray[np.float64]
Kind = Literal["solver's word", "polynomial only", "sampled", "rigorous"]

#: What may stand behind a tube, from the least to the most; a beat without any tube has the certificate "none".
KINDS: tuple[Kind, ...] = ("solver's word", "polynomial only", "sampled", "rigorous")
NONE = "none"

#: What a polynomial's bound leaves out of a tube, in the order in which the shares are added up.
SHARES = ("remainder", "parameters", "coupling", "measurement", "gusts")


@dataclass(frozen=True)
class Bound:
    """Tubes of one part of a batch of beats, bounded beyond their polynomials.

    Attributes
    ----------
    holds : ndarray (b,) of bool
        Where there is a bound; the rest is of no meaning elsewhere.
    size : ndarray (b,)
        Bound of the size in the metric asked for.
    shares : ndarray (b, 5)
        What each of `SHARES` adds to the polynomial's bound; together the difference.
    control : ndarray (b,)
        What the nonlinearity of the control's effect can have added to the polynomial's bound, in which it is.
    shape, rho : ndarray (b, n, n), (b,)
        Terminal ellipsoid.
    why : str
        A sentence's part for beats where it does not hold.
    """

    holds: NDArray[np.bool_]
    size: Array
    shares: Array
    control: Array
    shape: Array
    rho: Array
    why: str


@dataclass(frozen=True)
class Beyond:
    """What a tube must withstand beside the errors at the start of its beat and the parameters.

    Attributes
    ----------
    measurement_error : float
        Largest measurement error, as a fraction of the disturbance set.
    gust, gust_rotation : float
        Largest velocity (m/s) and rotation (rad/s) of the air over a beat, about each body axis.
    """

    measurement_error: float = 0.0
    gust: float = 0.0
    gust_rotation: float = 0.0


def whole_set(
    aircraft: Aircraft,
    states: Array,
    disturbance: DisturbanceSet,
    coordinates: ErrorCoordinates,
    parts: Sequence[Part],
    beyond: Beyond,
) -> BeatSet:
    """Everything that tubes of some parts must withstand together.

    Parameters
    ----------
    aircraft : Aircraft
    states : ndarray (b, 13)
        Nominal states at the start of the beats.
    disturbance : DisturbanceSet
    coordinates : ErrorCoordinates
    parts : sequence of Part
        Each part's errors range over its whole initial ellipsoid, independently of the others'.
    beyond : Beyond

    Returns
    -------
    BeatSet
    """
    balls = [
        (part.name, part.errors, initial_ellipsoid(disturbance, coordinates, states, part).whitening) for part in parts
    ]
    share, wind = beyond.measurement_error, np.repeat([beyond.gust, beyond.gust_rotation], 3)
    return beat_set(
        balls,
        aircraft.parameter_names,
        parameter_ranges(aircraft, disturbance.relative),
        measurement=coordinates.box(states, share * disturbance.half_widths) if share > 0 else None,
        wind=wind if wind.any() else None,
    )
