"""The search for the worst points of a set: random draws, extreme points, and ascents from the worst."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from aerotube.verify.adversity import ERRORS, BeatSpace

Array = NDArray[np.float64]
Targets = Sequence[tuple[list[int], Array]]

CHUNK = 10_000
_FIRST_STEP = 0.3
_DIFFERENCE = 1e-4
_PRINCIPAL = 3


class WorstPoints:
    """A search for the worst points of one set, for several targets at once.

    Parameters
    ----------
    space : BeatSpace
    targets : sequence of (errors, form)
        Error components, n of eight, and the matrix (n, n) of the quadratic form that is to be made large.
    """

    def __init__(self, space: BeatSpace, targets: Targets) -> None:
        self.space, self.targets = space, targets

    def ratios(self, points: Array, *, compiled: bool = True) -> Array:
        """Size at the end of the beat over each target's: ndarray (u, targets); infinite where it is not finite."""
        end = self.space.fly(points, compiled=compiled)
        sizes = [np.einsum("ui,ui->u", end[:, errors] @ form, end[:, errors]) for errors, form in self.targets]
        values = np.stack(sizes, axis=1)
        return np.where(np.isfinite(values), values, np.inf)

    def worst(self, samples: int, starts: int, ascents: int, generator: np.random.Generator) -> tuple[Array, Array]:
        """Worst points (targets, size) and their ratios (targets,), flown once more by the step of the flights."""
        pool, heights = self._keep(np.empty((len(self.targets), 0, self.space.size)), None, self._extremes(), starts)
        for first in range(0, samples, CHUNK):
            fresh = self.space.draw(min(CHUNK, samples - first), generator)
            pool, heights = self._keep(pool, heights, fresh, starts)
        pool, heights = self._climb(pool, heights, ascents)
        best = pool[np.arange(len(pool)), heights.argmax(axis=1)]
        return best, np.diagonal(self.ratios(best, compiled=False))

    def _keep(self, pool: Array, heights: Array | None, points: Array, count: int) -> tuple[Array, Array]:
        """Worst points (targets, count, size) and their ratios, of a pool and of more points (u, size)."""
        values = self.ratios(points).T
        top = np.argpartition(-values, min(count, values.shape[1]) - 1, axis=1)[:, :count]
        pool = np.concatenate([pool, points[top]], axis=1)
        fresh = np.take_along_axis(values, top, axis=1)
        heights = fresh if heights is None else np.concatenate([heights, fresh], axis=1)
        order = np.argsort(-heights, axis=1, kind="stable")[:, :count]
        return np.take_along_axis(pool, order[..., None], axis=1), np.take_along_axis(heights, order, axis=1)

    def _extremes(self) -> Array:
        """Ends of axes, corners of boxes inside the balls, principal directions; with parameters at their corners."""
        space = self.space
        points = [np.zeros((1, space.size))]
        for indices, _ in space.balls:
            n = len(indices)
            corners = np.array(list(itertools.product((-1.0, 1.0), repeat=n))) / np.sqrt(n)
            own = np.concatenate([np.eye(n), -np.eye(n), corners])
            rows = np.zeros((len(own), space.size))
            rows[:, list(indices)] = own
            points.append(rows)
        points.append(self._principal())
        errors = np.concatenate(points)
        uncertain = [i for i in space.free if ERRORS <= i < ERRORS + len(space.ranges)]
        # Corners of a few parameters; ends of many, one at a time.
        signs: list[tuple[float, ...]] = (
            list(itertools.product((-1.0, 1.0), repeat=len(uncertain)))
            if len(uncertain) <= 4
            else [tuple(sign * np.eye(len(uncertain))[i]) for i in range(len(uncertain)) for sign in (-1.0, 1.0)]
        )
        out = np.repeat(errors[None], len(signs), axis=0)
        for row, sign in zip(out, signs, strict=True):
            row[:, uncertain] = sign
        return out.reshape(-1, space.size)

    def _principal(self) -> Array:
        """Points farthest along the directions that the linearised beat makes largest, either way."""
        space = self.space
        axes = space.free
        steps = np.zeros((2 * len(axes), space.size))
        steps[np.arange(len(axes)), axes] = 0.1
        steps[np.arange(len(axes), 2 * len(axes)), axes] = -0.1
        ends = space.fly(steps)
        slopes = ((ends[: len(axes)] - ends[len(axes) :]) / 0.2).T
        points = []
        for errors, form in self.targets:
            gram = slopes[errors].T @ form @ slopes[errors]
            vectors = np.linalg.eigh(np.nan_to_num(gram))[1][:, -_PRINCIPAL:]
            rows = np.zeros((vectors.shape[1], space.size))
            rows[:, axes] = vectors.T
            points += [space.support(rows), space.support(-rows)]
        return np.concatenate(points)

    def _climb(self, points: Array, values: Array, ascents: int) -> tuple[Array, Array]:
        """Climb from points (targets, starts, size), all at once, along finite-difference gradients.

        Two ways are tried, and the better taken: a step along the gradient, that becomes shorter where it does not
        climb, and the farthest point of the set along it, to which a convex size climbs.
        """
        space, axes = self.space, self.space.free
        count = points.shape[:2]
        own = np.repeat(np.arange(count[0]), count[1])
        flat, heights = points.reshape(-1, space.size), values.reshape(-1).copy()
        length = np.full(len(flat), _FIRST_STEP)

        def at(trials: Array, each: int) -> Array:
            found = self.ratios(trials.reshape(-1, space.size))
            return found[np.arange(len(found)), np.repeat(own, each)].reshape(len(flat), each)

        for _ in range(ascents):
            # inwards from the boundary, so that every trial stays a point of the set
            side = np.where(flat[:, axes] > 0, -_DIFFERENCE, _DIFFERENCE)
            moved = np.repeat(flat[:, None], len(axes), axis=1)
            moved[:, np.arange(len(axes)), axes] += side
            slope = np.zeros_like(flat)
            slope[:, axes] = np.nan_to_num((at(moved, len(axes)) - heights[:, None]) / side, posinf=0.0, neginf=0.0)
            norm = np.linalg.norm(slope, axis=1, keepdims=True)
            stride = (length * np.sqrt(len(axes)))[:, None] / np.maximum(norm, np.finfo(float).tiny)
            ahead = np.stack([space.project(flat + stride * slope), space.support(slope)], axis=1)
            reached = at(ahead, 2)
            way = reached.argmax(axis=1)
            top = reached[np.arange(len(flat)), way]
            better = top > heights
            length = np.where(reached[:, 0] > heights, length, 0.4 * length)
            flat = np.where(better[:, None], ahead[np.arange(len(flat)), way], flat)
            heights = np.where(better, top, heights)
            if not better.any() and (length < 1e-5).all():
                break
        return flat.reshape(points.shape), heights.reshape(count)
