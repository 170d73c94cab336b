"""What a tube must withstand, as points of a box of numbers, and the flight of one beat from such points.

Shares nothing with the synthesis but the aircraft and the error coordinates: the aircraft is flown as in flight, the
error measured with its error, increments asked of the law, realised as controls within their limits, one step flown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.dynamics import step
from aerotube.errors import InputError
from aerotube.flight.simulate import Law
from aerotube.nominal import Nominal

Array = NDArray[np.float64]

ERRORS, WIND = 8, 6


@dataclass(frozen=True)
class Adversity:
    """What a tube must withstand besides the errors of its own part and the uncertain parameters.

    Attributes
    ----------
    others : float
        Share of the other parts' initial ellipsoids over which their errors range.
    measurement : ndarray (8,) or (T, 8)
        Largest measurement error of each error component, in the law's coordinates.
    wind : ndarray (6,) or (T, 6)
        Largest wind over the beat, velocity (m/s) and rotation (rad/s), body axes.

    Raises
    ------
    InputError
        For a number that is negative or not finite, or an array of the wrong size.
    """

    others: float = 0.0
    measurement: Array = field(default_factory=lambda: np.zeros(ERRORS))
    wind: Array = field(default_factory=lambda: np.zeros(WIND))

    def __post_init__(self) -> None:
        if not (np.isfinite(self.others) and self.others >= 0):
            raise InputError(f"falsify: the other parts' share is {self.others}; it must not be negative.")
        for name, size in (("measurement", ERRORS), ("wind", WIND)):
            values = np.asarray(getattr(self, name), dtype=float)
            if values.shape[-1:] != (size,) or not (np.isfinite(values) & (values >= 0)).all():
                raise InputError(f"falsify: {name} must be {size} finite numbers, none negative.")
            object.__setattr__(self, name, values)

    def at(self, beat: int) -> tuple[Array, Array]:
        """Largest measurement errors (8,) and wind (6,) of a beat."""
        measurement, wind = (x if x.ndim == 1 else x[beat] for x in (self.measurement, self.wind))
        return measurement, wind


@dataclass(frozen=True)
class BeatSpace:
    """The set of one beat: points are numbers in [-1, 1], the errors' in a ball for each part.

    Attributes
    ----------
    aircraft, nominal, law, beat
        What is flown.
    balls : sequence of (indices, whitening)
        Error components of each part that has errors, and the map (n, n) of the unit ball onto its set.
    ranges : ndarray (p, 2)
        Of the uncertain parameters.
    measurement, wind : ndarray (8,), (6,)
        Largest values.
    """

    aircraft: Aircraft
    nominal: Nominal
    law: Law
    beat: int
    balls: Sequence[tuple[tuple[int, ...], Array]]
    ranges: Array
    measurement: Array
    wind: Array

    @property
    def size(self) -> int:
        """Numbers of a point: whitened errors, parameters, measurement errors, wind."""
        return ERRORS + len(self.ranges) + ERRORS + WIND

    @cached_property
    def free(self) -> NDArray[np.intp]:
        """The numbers that do anything."""
        used = np.zeros(self.size, dtype=bool)
        for indices, _ in self.balls:
            used[list(indices)] = True
        used[ERRORS:] = np.concatenate([self.ranges[:, 0] < self.ranges[:, 1], self.measurement > 0, self.wind > 0])
        return np.flatnonzero(used)

    def project(self, points: Array) -> Array:
        """Nearest points of the set to points (u, size)."""
        points = np.clip(points, -1.0, 1.0, where=np.arange(self.size) >= ERRORS, out=np.array(points))
        for indices, _ in self.balls:
            own = points[:, list(indices)]
            points[:, list(indices)] = own / np.maximum(np.linalg.norm(own, axis=1, keepdims=True), 1.0)
        return points

    def support(self, gradient: Array) -> Array:
        """Points of the set that are farthest along gradients (u, size)."""
        points = np.sign(gradient)
        for indices, _ in self.balls:
            own = gradient[:, list(indices)]
            points[:, list(indices)] = own / np.maximum(np.linalg.norm(own, axis=1, keepdims=True), 1e-300)
        return points

    def draw(self, count: int, generator: np.random.Generator) -> Array:
        """Random points: on the balls' boundaries and inside, at the boxes' corners and inside, half and half."""
        points = np.zeros((count, self.size))
        boxed = self.free[self.free >= ERRORS]
        inside = generator.uniform(-1.0, 1.0, (count, len(boxed)))
        corner = generator.random(count) < 0.5
        points[:, boxed] = np.where(corner[:, None], np.sign(inside), inside)
        for indices, _ in self.balls:
            direction = generator.standard_normal((count, len(indices)))
            radius = np.where(generator.random(count) < 0.5, 1.0, generator.random(count) ** (1.0 / len(indices)))
            points[:, list(indices)] = direction * (radius / np.linalg.norm(direction, axis=1))[:, None]
        return points

    def disturbances(self, points: Array) -> tuple[Array, Array, Array, Array]:
        """Errors (u, 8), parameters (u, p), measurement errors (u, 8) and wind (u, 6) of points."""
        p = len(self.ranges)
        error = np.zeros((len(points), ERRORS))
        for indices, whitening in self.balls:
            error[:, list(indices)] = points[:, list(indices)] @ whitening.T
        middle, half = self.ranges.mean(1), 0.5 * (self.ranges[:, 1] - self.ranges[:, 0])
        parameters = np.clip(middle + half * points[:, ERRORS : ERRORS + p], self.ranges[:, 0], self.ranges[:, 1])
        measured = points[:, ERRORS + p : 2 * ERRORS + p] * self.measurement
        return error, parameters, measured, points[:, 2 * ERRORS + p :] * self.wind

    def fly(self, points: Array, *, compiled: bool = True) -> Array:
        """Errors at the end of the beat, in the law's coordinates: ndarray (u, 8).

        Parameters
        ----------
        points : ndarray (u, size)
        compiled : bool
            By the aircraft's compiled step, where it has one; else by the one that flights take.
        """
        error, parameters, measured, wind = self.disturbances(points)
        coordinates, nominal, t = self.law.coordinates, self.nominal, self.beat
        start = coordinates.retract(nominal.states[t], error)
        seen = coordinates.retract(nominal.states[t], error + measured) if self.measurement.any() else start
        push = np.asarray(self.law.increment(t, error + measured), dtype=float)
        held = self.aircraft.realise(seen, np.broadcast_to(nominal.controls[t], push.shape), push)
        quick = self.aircraft.compiled_step() if compiled else None
        if quick is None:
            end = step(self.aircraft, start, held, nominal.dt, parameters=parameters, wind=wind)
        else:
            start, held, parameters, wind = (np.ascontiguousarray(x) for x in (start, held, parameters, wind))
            end = quick(start, held, parameters, wind, nominal.dt, 1)
        return coordinates.difference(end, nominal.states[t + 1])
