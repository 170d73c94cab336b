"""A baseline: laws computed beforehand for a sample of nominals, the nearest stored one flown.

The idea of tube libraries (A. Majumdar, R. Tedrake, "Funnel libraries for real-time robust feedback motion planning",
*Int. J. Robotics Research* 36 (2017) 947-982): everything expensive is done offline, and online only looked up. What
it costs is the distance to the nearest stored nominal, and that nothing can be made anew for other disturbances.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.compensation.law import LinearLaw
from aerotube.dynamics.errors import ErrorCoordinates
from aerotube.errors import ComputationError, InputError
from aerotube.nominal import Nominal, constant_controls

Array = NDArray[np.float64]

_ORIGIN = ErrorCoordinates("euler")


@dataclass(frozen=True, eq=False)
class LawLibrary:
    """Linear laws of beats, by the nominal state and control that they were made for.

    Attributes
    ----------
    points : ndarray (entry, 12)
        Nominal ``[V, alpha, q, theta, beta, p, r, phi]`` and controls at the start of the beat, over `scale`.
    gains : ndarray (entry, 4, 8)
    scale : ndarray (12,)
        What counts as a unit of distance.
    coordinates : ErrorCoordinates
        Of all laws.
    """

    points: Array
    gains: Array
    scale: Array
    coordinates: ErrorCoordinates

    def nearest(self, nominal: Nominal) -> tuple[NDArray[np.intp], Array]:
        """The stored entries next to the beats of a nominal.

        Parameters
        ----------
        nominal : Nominal
            Of T beats.

        Returns
        -------
        entry : ndarray (T,) of int
        distance : ndarray (T,)
            In units of `scale`.
        """
        wanted = _points(nominal) / self.scale
        distance = np.linalg.norm(wanted[:, None] - self.points[None], axis=-1)
        entry = np.argmin(distance, axis=1)
        return entry, distance[np.arange(len(entry)), entry]

    def law(self, nominal: Nominal) -> LinearLaw:
        """The law made of the nearest stored ones, beat by beat."""
        entry, _ = self.nearest(nominal)
        return LinearLaw(self.gains[entry], self.coordinates)


def build_library(
    nominals: Sequence[Nominal], make: Callable[[Nominal], LinearLaw], scale: Sequence[float] | Array
) -> LawLibrary:
    """Compute the laws of a library.

    Parameters
    ----------
    nominals : sequence of Nominal
    make : callable
        From a nominal to the law of all its beats.
    scale : sequence of 12 floats
        Positive; see :class:`LawLibrary`.

    Returns
    -------
    LawLibrary

    Raises
    ------
    InputError
        If there are no nominals, a scale is not positive, or the laws do not agree in their coordinates.
    """
    units = np.array(scale, dtype=float)
    if not nominals:
        raise InputError("library: there are no nominals to compute laws for; give at least one.")
    if units.shape != (12,) or not np.all(np.isfinite(units) & (units > 0)):
        raise InputError("library: the scale must be 12 positive numbers, of eight states and four controls.")
    laws = [make(nominal) for nominal in nominals]
    if len({law.coordinates for law in laws}) > 1:
        raise InputError("library: its laws are in different error coordinates; make all in the same.")
    points = np.concatenate([_points(nominal) for nominal in nominals]) / units
    return LawLibrary(points, np.concatenate([law.gains for law in laws]), units, laws[0].coordinates)


def nearby_nominals(
    aircraft: Aircraft, nominal: Nominal, half_widths: Sequence[float] | Array, count: int, seed: int
) -> list[Nominal]:
    """Manoeuvres around one: from other starts, with other controls, constant where those of the nominal are.

    Parameters
    ----------
    aircraft : Aircraft
    nominal : Nominal
        Is itself not among them.
    half_widths : sequence of 12 floats
        Of the box around the nominal's start and controls from which starts and changes of controls are drawn.
    count : int
    seed : int

    Returns
    -------
    list of Nominal
        As long as the nominal. Those that leave the aircraft's model or control limits are drawn again.

    Raises
    ------
    ComputationError
        If hardly any stays inside.
    """
    width = np.asarray(half_widths, dtype=float)
    generator = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed)))
    found: list[Nominal] = []
    for _ in range(50 * count):
        if len(found) == count:
            return found
        moved = generator.uniform(-1.0, 1.0, 12) * width
        start = _ORIGIN.retract(nominal.states[0], moved[:8])
        controls = np.clip(nominal.controls + moved[8:], aircraft.control_lower, aircraft.control_upper)
        try:
            # One that tumbles out of the model may overflow on its way; it is found out right after.
            with np.errstate(all="ignore"):
                one = constant_controls(aircraft, start, controls, nominal.dt, nominal.beats, "near the nominal")
            one.check(aircraft)
        except (InputError, ComputationError):
            continue
        found.append(one)
    if len(found) < count:
        raise ComputationError(
            f"library: of {50 * count} manoeuvres near the nominal only {len(found)} stay inside the aircraft's model; "
            "draw them from a smaller box."
        )
    return found


def _points(nominal: Nominal) -> Array:
    """Nominal states and controls at the start of the beats: ndarray (T, 12)."""
    level = np.zeros(nominal.states.shape[1])
    level[[0, 3]] = 1.0
    states = _ORIGIN.difference(nominal.states[:-1], level)
    states[:, 0] += 1.0  # the airspeed itself, not its difference from the origin's 1 m/s
    return np.concatenate([states, nominal.controls], axis=-1)
