"""A search that tries to break tubes: states inside the initial set that leave the terminal ellipsoid.

Shares nothing with the synthesis but the aircraft and the error coordinates: the aircraft is flown for one beat as in
flight (measured error, law, increments realised as controls within their limits, one step), from points chosen to do
harm: random ones, the extreme points of every axis and of the disturbance box, and from the worst of these by ascent
along finite-difference gradients, on the sets' boundaries.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.compensation import Compensation, Part
from aerotube.dynamics import ErrorCoordinates, step
from aerotube.errors import InputError
from aerotube.nominal import Nominal
from aerotube.tube import DisturbanceBox, ellipsoid, parameter_ranges

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

CHUNK = 20_000
FIRST_STEP = 0.3


@dataclass(frozen=True)
class Falsification:
    """The worst that was found.

    Attributes
    ----------
    ratio : ndarray (T, parts)
        Largest size at the end of the beat over the tube's ``rho``: above one, the tube is broken. NaN where
        there is no tube.
    error : ndarray (T, parts, 8)
        The error at the start that does it, in the law's coordinates.
    parameters : ndarray (T, parts, p)
        The parameters that do it.
    measurement_error : ndarray (T, parts, 8)
        The measurement error that does it.
    samples : int
        Random points tried for each tube, besides extreme points and ascents.
    seed : int
    """

    ratio: Array
    error: Array
    parameters: Array
    measurement_error: Array
    samples: int
    seed: int

    @property
    def broken(self) -> NDArray[np.bool_]:
        """Which tubes are broken, beyond rounding: ndarray (T, parts)."""
        return np.asarray(self.ratio > 1.0 + 1e-9)


@dataclass(frozen=True)
class _Space:
    """How a point of the search, numbers in [-1, 1], becomes a flight of one beat."""

    aircraft: Aircraft
    nominal: Nominal
    made: Compensation
    beat: int
    part: Part
    whitening: Array
    half_widths: Array
    ranges: Array
    coupling: float
    measurement: float
    form: Array

    @property
    def size(self) -> int:
        """Numbers of a point: whitened errors of the part, the others', parameters, measurement errors."""
        return 8 + len(self.ranges) + 8

    @property
    def free(self) -> Array:
        """Which of the numbers do anything: bool (size,)."""
        out = np.zeros(self.size, dtype=bool)
        out[: len(self.part.errors)] = True
        out[len(self.part.errors) : 8] = self.coupling > 0
        out[8 : 8 + len(self.ranges)] = self.ranges[:, 0] < self.ranges[:, 1]
        out[8 + len(self.ranges) :] = self.measurement > 0
        return out

    def project(self, points: Array) -> Array:
        """Nearest points of the set: the ball for the part's errors, the box for everything else."""
        n = len(self.part.errors)
        points = np.clip(points, -1.0, 1.0, where=np.arange(self.size) >= n, out=np.array(points))
        norm = np.linalg.norm(points[:, :n], axis=1, keepdims=True)
        points[:, :n] /= np.maximum(norm, 1.0)
        return points

    def disturbances(self, points: Array) -> tuple[Array, Array, Array]:
        """Errors (u, 8), parameters (u, p) and measurement errors (u, 8) of points."""
        n, p = len(self.part.errors), len(self.ranges)
        error = np.zeros((len(points), 8))
        others = [i for i in range(8) if i not in self.part.errors]
        error[:, self.part.errors] = points[:, :n] @ self.whitening.T
        error[:, others] = self.coupling * points[:, n:8] * self.half_widths[others]
        middle, half = self.ranges.mean(1), 0.5 * (self.ranges[:, 1] - self.ranges[:, 0])
        parameters = middle + half * points[:, 8 : 8 + p]
        return error, parameters, self.measurement * points[:, 8 + p :] * self.half_widths

    def ratio(self, points: Array) -> Array:
        """Size at the end of the beat over the tube's: ndarray (u,)."""
        error, parameters, measured = self.disturbances(points)
        coordinates, t = self.made.law.coordinates, self.beat
        start = coordinates.retract(self.nominal.states[t], error)
        seen = coordinates.retract(self.nominal.states[t], error + measured) if measured.any() else start
        push = self.made.law.increment(t, error + measured)
        held = self.aircraft.realise(seen, np.broadcast_to(self.nominal.controls[t], push.shape), push)
        end = step(self.aircraft, start, held, self.nominal.dt, parameters=parameters)
        arrived = coordinates.difference(end, self.nominal.states[t + 1])[:, self.part.errors]
        return np.asarray(np.einsum("ui,ij,uj->u", arrived, self.form, arrived))


def falsify(
    aircraft: Aircraft,
    nominal: Nominal,
    disturbance: DisturbanceBox,
    made: Compensation,
    *,
    samples: int = 1000,
    coupling: float = 0.0,
    measurement_error: float = 0.0,
    metric: bool = False,
    starts: int = 8,
    ascents: int = 40,
    seed: int = 0,
    progress: Progress | None = None,
) -> Falsification:
    """Try to break the tubes of a synthesis.

    Parameters
    ----------
    aircraft : Aircraft
        The one that flies.
    nominal : Nominal
    disturbance : DisturbanceBox
    made : Compensation
    samples : int
        Random points for each tube, half of them on the boundary.
    coupling : float
        Share of the disturbance box over which the errors of the other half range; zero leaves them at zero.
    measurement_error : float
        Share of the disturbance box over which measurement errors range.
    metric : bool
        Test the size in the synthesis's own metric instead of the terminal ellipsoid.
    starts, ascents : int
        Worst points from which the search climbs, and steps of each climb.
    seed : int
    progress : callable, optional
        Told the tubes done and their number.

    Returns
    -------
    Falsification

    Raises
    ------
    InputError
        If a number is out of range.
    """
    if samples < 1 or starts < 1 or ascents < 0:
        raise InputError(f"falsify: samples {samples}, starts {starts} and ascents {ascents}: give at least one.")
    if coupling < 0 or measurement_error < 0:
        raise InputError("falsify: coupling and measurement error are shares of the box and must not be negative.")
    tubes = made.tubes
    shape, rho = (tubes.metric, tubes.size) if metric else (tubes.terminal_shape, tubes.terminal_rho)
    forms = shape / rho[..., None, None]
    ranges = parameter_ranges(aircraft, disturbance.relative)
    coordinates: ErrorCoordinates = made.law.coordinates
    widths = coordinates.box(nominal.states[:-1], disturbance.half_widths)
    counts = (nominal.beats, len(tubes.parts))
    ratio = np.full(counts, np.nan)
    error, noise = np.zeros((*counts, 8)), np.zeros((*counts, 8))
    parameters = np.zeros((*counts, len(ranges)))
    for done, (beat, index) in enumerate(itertools.product(*map(range, counts))):
        if progress is not None:
            progress(done, counts[0] * counts[1])
        if not np.isfinite(forms[beat, index]).all():
            continue
        whitening = ellipsoid.whitening(tubes.initial_shape[beat, index], tubes.initial_rho[beat, index])
        part = tubes.parts[index]
        space = _Space(
            aircraft, nominal, made, beat, part, whitening, widths[beat], ranges, coupling, measurement_error,
            forms[beat, index],
        )  # fmt: skip
        best, worst = _search(space, samples, starts, ascents, np.random.default_rng([seed, beat, index]))
        ratio[beat, index] = worst
        found = space.disturbances(best[None])
        error[beat, index], parameters[beat, index], noise[beat, index] = (x[0] for x in found)
    return Falsification(ratio, error, parameters, noise, samples, seed)


def _search(space: _Space, samples: int, starts: int, ascents: int, rng: np.random.Generator) -> tuple[Array, float]:
    """The worst point found and its ratio."""
    pool, values = _keep_worst(space, _extreme_points(space), starts)
    for first in range(0, samples, CHUNK):
        fresh = _random_points(space, min(CHUNK, samples - first), rng)
        found, heights = _keep_worst(space, fresh, starts)
        order = np.argsort(-np.concatenate([values, heights]))[:starts]
        pool = np.concatenate([pool, found])[order]
        values = np.concatenate([values, heights])[order]
    return _climb(space, pool, values, ascents)


def _keep_worst(space: _Space, points: Array, count: int) -> tuple[Array, Array]:
    values = np.nan_to_num(space.ratio(points), nan=np.inf)
    order = np.argsort(-values)[:count]
    return points[order], values[order]


def _random_points(space: _Space, count: int, rng: np.random.Generator) -> Array:
    """Points of the set: the ball's boundary and its inside, the box's inside and its corners, half and half."""
    n = len(space.part.errors)
    points = rng.uniform(-1, 1, (count, space.size))
    corner = rng.random(count) < 0.5
    points[corner, n:] = np.sign(points[corner, n:])
    direction = rng.normal(size=(count, n))
    radius = np.where(rng.random(count) < 0.5, 1.0, rng.random(count) ** (1.0 / n))
    points[:, :n] = direction / np.linalg.norm(direction, axis=1, keepdims=True) * radius[:, None]
    return points * space.free


def _extreme_points(space: _Space) -> Array:
    """Ends of every axis of the ball and corners of the disturbance box, at every corner of the parameters."""
    n, p = len(space.part.errors), len(space.ranges)
    axes = np.concatenate([np.eye(n), -np.eye(n)])
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=n))) / np.sqrt(n)
    ball = np.concatenate([axes, corners])
    parameters = np.array(list(itertools.product((-1.0, 1.0), repeat=p)))
    points = np.zeros((len(ball), len(parameters), space.size))
    points[..., :n] = ball[:, None]
    points[..., 8 : 8 + p] = parameters
    return points.reshape(-1, space.size) * space.free


def _climb(space: _Space, points: Array, values: Array, ascents: int) -> tuple[Array, float]:
    """Climb from several points at once along finite-difference gradients, with shrinking steps."""
    axes = np.flatnonzero(space.free)
    h = 1e-4
    length = np.full(len(points), FIRST_STEP)
    for _ in range(ascents):
        moved = np.repeat(points[:, None], len(axes), axis=1)
        # inwards from the boundary, so that every trial stays a point of the set
        side = np.where(points[:, axes] > 0, -h, h)
        moved[:, np.arange(len(axes)), axes] += side
        slope = (space.ratio(moved.reshape(-1, space.size)).reshape(len(points), -1) - values[:, None]) / side
        norm = np.linalg.norm(slope, axis=1, keepdims=True)
        if not (norm > 0).any():
            break
        ahead = points.copy()
        ahead[:, axes] += length[:, None] * slope / np.maximum(norm, np.finfo(float).tiny) * np.sqrt(len(axes))
        ahead = space.project(ahead)
        reached = np.nan_to_num(space.ratio(ahead), nan=np.inf)
        better = reached > values
        points = np.where(better[:, None], ahead, points)
        values = np.where(better, reached, values)
        length = np.where(better, length, 0.4 * length)
        if (length < 1e-5).all():
            break
    best = int(np.argmax(values))
    return points[best], float(values[best])
