"""The worst points of sets of beats: independent samples, and climbs from the worst of them.

Each step of a climb goes to where the set supports the gradient, as suits the maximum of a nearly convex function over
a product of balls (the Frank-Wolfe method with whole steps; a power method where the map is linear).
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from aerotube.compensation.climb import climb_fits
from aerotube.dynamics import BeatSet

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Task = Generator[Array, Array, tuple[Array, Array]]

_LOCAL = 0.05  # length of a finite difference
_LOCAL_STEPS = 2
_OTHERS = 1 << 32  # of seeds, which users count from zero


@dataclass(frozen=True)
class Effort:
    """What a search for a worst point does.

    Attributes
    ----------
    samples, directions : int
        Samples and principal directions to climb the fitted maps from.
    steps : int
        Of a climb.
    flown : int
        Ends of climbs that are flown.
    refinements : int
        Climbs along local slopes of the true map, from the worst of these.
    climbers : int
        Points that climb so at the same time; a map with kinks has several local maxima.
    """

    samples: int
    directions: int
    steps: int
    flown: int
    refinements: int
    climbers: int


#: For the shares, which only say how a bound is made up; for the bound; for the bound in gusts, in which a map is bent
#: where it is taken for straight; and for terminal ellipsoids.
QUICK, USUAL = Effort(4, 2, 6, 2, 0, 1), Effort(6, 3, 8, 8, 2, 1)
WINDY, THOROUGH = Effort(20, 3, 16, 16, 4, 4), Effort(20, 3, 16, 16, 6, 6)


@dataclass(frozen=True)
class Sampling:
    """How many samples, and what they are worth.

    Attributes
    ----------
    samples : int
        Independent draws for each beat; the two halves share them.
    confidence : float
        Between 0 and 1.
    seed : int
    """

    samples: int
    confidence: float
    seed: int

    @property
    def share(self) -> float:
        """Largest share of the set, in the distribution of the samples, that may exceed a bound."""
        return float(-np.expm1(np.log1p(-self.confidence) / self.samples))


@lru_cache(maxsize=16)
def draw(balls: tuple[int, ...], count: int, seed: int) -> Array:
    """Independent samples (count, k) of a product of balls, distributed as `aerotube.compensation.sampled` says."""
    generator = np.random.default_rng(seed)
    parts = []
    for size in balls:
        x = generator.standard_normal((count, size))
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        radius = generator.random((count, 1)) ** (1.0 / size)
        parts.append(x * np.where(generator.random((count, 1)) < 0.5, 1.0, radius))
    return np.concatenate(parts, axis=1)


def support(over: BeatSet, gradient: Array) -> Array:
    """Points of the product of balls that are farthest along gradients (..., k); zero along a zero gradient."""
    out, start = np.sign(gradient), 0
    for size in over.balls:
        if size == 1:
            start += 1
            continue
        own = gradient[..., start : start + size]
        length = np.linalg.norm(own, axis=-1, keepdims=True)
        out[..., start : start + size] = own / np.where(length > 0.0, length, 1.0)
        start += size
    return out


def _curved(names: tuple[str, ...], balls: tuple[int, ...]) -> Mask:
    """Variables that are neither measurement errors nor wind, in which maps are all but linear: bool (k,)."""
    kinds = np.repeat([name.split(" ")[0] for name in names], balls)
    return np.asarray(~np.isin(kinds, ("measurement", "wind")))


@lru_cache(maxsize=16)
def _fitting(
    names: tuple[str, ...], balls: tuple[int, ...], count: int, seed: int
) -> tuple[Array, NDArray[np.intp], NDArray[np.intp]]:
    """From values at the samples to coefficients of a quadratic map, and which products of variables it has.

    Measurement errors and wind, of which there are many, enter linearly.
    """
    curved = np.flatnonzero(_curved(names, balls))
    rows, columns = (curved[i] for i in np.tril_indices(len(curved)))
    z = draw(balls, count, seed)
    features = np.concatenate([np.ones((count, 1)), z, z[:, rows] * z[:, columns]], axis=1)
    return np.linalg.pinv(features, rcond=1e-9), rows, columns


class Search:
    """A search for the worst points of the sets of a batch of beats.

    Parameters
    ----------
    fly : callable
        From points (b, u, k) to errors (b, u, 8) at the end of the beat.
    over : BeatSet
    sampling : Sampling

    Attributes
    ----------
    points : ndarray (N, k)
        The independent samples, the same for all beats.
    ends : ndarray (b, N, 8)
        Where they end.
    usual : Effort
        Of a search for a bound.
    """

    def __init__(self, fly: Callable[[Array], Array], over: BeatSet, sampling: Sampling) -> None:
        self.fly, self.over = fly, over
        self.beats, _, self.size = over.error.shape
        self.seed = sampling.seed
        self.points = draw(over.balls, sampling.samples, sampling.seed)
        self.ends = fly(np.broadcast_to(self.points, (self.beats, *self.points.shape)))
        self.sound = np.isfinite(self.ends).all(axis=(1, 2))
        self.curved = _curved(over.names, over.balls)
        self.usual = USUAL if over.wind is None else WINDY
        self.centre, self.slopes, self.bends = self._fit()

    @cached_property
    def others(self) -> Array:
        """Where as many other independent samples end: ndarray (b, N, 8)."""
        points = draw(self.over.balls, len(self.points), self.seed + _OTHERS)
        return self.fly(np.broadcast_to(points, (self.beats, *points.shape)))

    def _fit(self) -> tuple[Array, Array, Array]:
        """Quadratic maps through the samples by least squares: (b, 8), (b, 8, k) and symmetric (b, 8, kc, kc).

        The first kc variables are the curved ones.
        """
        inverse, rows, columns = _fitting(self.over.names, self.over.balls, len(self.points), self.seed)
        ends = np.where(np.isfinite(self.ends), self.ends, 0.0)
        found = np.swapaxes(inverse @ ends, 1, 2)
        curved = int(self.curved.sum())
        bends = np.zeros((self.beats, 8, curved, curved))
        bends[:, :, rows, columns] = found[..., 1 + self.size :]
        return found[..., 0], found[..., 1 : 1 + self.size], bends + np.swapaxes(bends, 2, 3)

    def largest(self, errors: Sequence[int], form: Array, free: Mask, effort: Effort) -> tuple[Array, Array]:
        """Largest ``x' form x`` found with some of the variables free, the others zero.

        Parameters
        ----------
        errors : sequence of int, length n
        form : ndarray (b, n, n)
        free : bool (k,)
        effort : Effort

        Returns
        -------
        value : ndarray (b,)
            Infinite where some flight was not finite. If all variables are free, at least that of every sample.
        point : ndarray (b, k)
        """
        return self.together([self.task(errors, form, free, effort)])[0]

    def together(self, tasks: Sequence[Task]) -> list[tuple[Array, Array]]:
        """Do several tasks of the same effort at once, so that what each of them flies is flown in one go."""
        asked, found = [next(task) for task in tasks], list[tuple[Array, Array]]()
        while not found:
            ends = self.fly(np.concatenate(asked, axis=1))
            own = np.split(ends, np.cumsum([points.shape[1] for points in asked])[:-1], axis=1)
            asked = []
            for task, part in zip(tasks, own, strict=True):
                try:
                    asked.append(task.send(part))
                except StopIteration as done:
                    found.append(done.value)
        return found

    def task(self, errors: Sequence[int], form: Array, free: Mask, effort: Effort) -> Task:
        """What :meth:`largest` does, as a task that asks for points (b, u, k) to be flown and is sent their ends."""
        own = list(errors)
        sizes = sizes_of(self.ends[..., own], form)
        best = np.argsort(-sizes, axis=1)[:, : effort.samples]
        worst = self.points[best] * free
        found = Best(np.full(self.beats, -np.inf), np.zeros((self.beats, self.size)))
        if free.all():
            found.take(np.take_along_axis(sizes, best, axis=1), worst)
        points = self._worst_of_fit(worst, own, free, form, effort)
        values = sizes_of((yield points)[..., own], form)
        found.take(values, points)
        if effort.refinements:
            starts = np.concatenate([found.point[:, None], points, worst], axis=1)[:, : 2 * effort.climbers - 1]
            yield from self._climb(found, starts, own, free, form, effort)
        value = np.where(self.sound, found.value, np.inf)
        return value, found.point

    def _worst_of_fit(self, starts: Array, own: list[int], free: Mask, form: Array, effort: Effort) -> Array:
        """Worst points of the fitted maps, climbed to from given points and from principal directions: (b, s, k)."""
        # measurement errors and wind, which are not curved, come last
        slopes = self.slopes[:, own] * free
        values, vectors = np.linalg.eigh(form)
        # the largest singular vectors of the linear map, by the small side of its Gram matrix
        seen = np.sqrt(np.maximum(values, 0.0))[..., None] * (np.swapaxes(vectors, 1, 2) @ slopes)
        left = np.linalg.eigh(seen @ np.swapaxes(seen, 1, 2))[1][..., : -1 - effort.directions : -1]
        principal = support(self.over, np.swapaxes(left, 1, 2) @ seen)
        points = np.concatenate([starts, principal, -principal], axis=1)
        sizes = climb_fits(
            points,
            np.ascontiguousarray(self.centre[:, own]),
            slopes,
            np.ascontiguousarray(self.bends[:, own]),
            np.ascontiguousarray(form),
            free,
            np.array(self.over.balls),
            effort.steps,
        )
        best = np.argsort(-sizes, axis=1)[:, : effort.flown]
        return np.asarray(np.take_along_axis(points, best[..., None], axis=1))

    def _climb(
        self, found: Best, points: Array, own: list[int], free: Mask, form: Array, effort: Effort
    ) -> Generator[Array, Array, None]:
        """Climb from points (b, s, k) along local slopes of the true map."""
        for _ in range(effort.refinements):
            end, slopes = yield from self._local(points, own, free, free if effort.climbers > 1 else free & self.curved)
            best = sizes_of(end, form)
            for _ in range(_LOCAL_STEPS):
                ahead = support(self.over, ((end @ form)[:, :, None] @ slopes)[:, :, 0])
                end = (yield ahead)[..., own]
                values = sizes_of(end, form)
                found.take(values, ahead)
                points = np.where((values > best)[..., None], ahead, points)
                best = np.maximum(values, best)

    def _local(
        self, points: Array, own: list[int], free: Mask, differenced: Mask
    ) -> Generator[Array, Array, tuple[Array, Array]]:
        """Values (b, s, n) and slopes (b, s, n, k), over short steps inwards, of the map at points (b, s, k).

        In variables that are not differenced they are the fitted ones.
        """
        axes = np.flatnonzero(differenced)
        reach = np.where(points > 0.0, -_LOCAL, _LOCAL)[..., axes]
        moved = np.repeat(points[:, :, None], len(axes) + 1, axis=2)
        moved[:, :, np.arange(len(axes)), axes] += reach
        ends = (yield moved.reshape(self.beats, -1, self.size)).reshape(*moved.shape[:3], 8)[..., own]
        slopes = np.repeat((self.slopes[:, own] * free)[:, None], points.shape[1], axis=1)
        slopes[..., axes] = np.swapaxes((ends[:, :, :-1] - ends[:, :, -1:]) / reach[..., None], 2, 3)
        return ends[:, :, -1], slopes


class Best:
    """The worst point so far of each beat."""

    def __init__(self, value: Array, point: Array) -> None:
        self.value, self.point = value, point

    def take(self, values: Array, points: Array) -> None:
        """Keep what is worse among points (b, u, k); a value that is not finite is the worst."""
        values = np.where(np.isfinite(values), values, np.inf)
        best = np.argmax(values, axis=1)
        rows = np.arange(len(values))
        better = values[rows, best] > self.value
        self.value = np.where(better, values[rows, best], self.value)
        self.point = np.where(better[:, None], points[rows, best], self.point)


def sizes_of(ends: Array, form: Array) -> Array:
    """Sizes (b, u) of errors (b, u, n) in metrics (b, n, n)."""
    return np.asarray(np.sum((ends @ form) * ends, axis=-1))
