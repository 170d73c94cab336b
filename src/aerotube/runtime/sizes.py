"""What laws are worth on a nominal: sizes of their tubes, whether they help, and whether they keep the limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerotube.compensation import KINDS, flown_size
from aerotube.compensation.bounds import Beyond, whole_set
from aerotube.compensation.design import available_increments
from aerotube.compensation.groundwork import groundwork
from aerotube.dynamics import flown_map
from aerotube.nominal import Nominal
from aerotube.runtime.law import Laws
from aerotube.runtime.task import Task

Array = NDArray[np.float64]

_SMALL = 0.05  # share of the initial ellipsoids over which slopes are taken


@dataclass(frozen=True)
class Sized:
    """Certified sizes and what stands behind them, each (b, parts)."""

    size: Array
    kinds: NDArray[np.int64]


def sizes(task: Task, nominal: Nominal, beats: NDArray[np.intp], laws: Laws | None, metric: tuple[Array, ...]) -> Sized:
    """Sizes of the tubes of some beats, with laws of the whole nominal or without any."""
    law = None if laws is None else laws.batch(task.form, task.coordinates)
    size, names = flown_size(
        task.aircraft, nominal, task.disturbance, law, metric, task.settings, beats=beats, workers=task.workers
    )
    kinds = np.full(names.shape, -1)
    for number, kind in enumerate(KINDS):
        kinds[names == kind] = number
    return Sized(size, kinds)


def useful(
    task: Task, nominal: Nominal, beats: NDArray[np.intp], laws: Laws, metric: tuple[Array, ...]
) -> NDArray[np.bool_]:
    """Where laws leave errors no larger than the nominal alone, to first order and measured exactly: (b, parts)."""
    parts = task.settings.parts
    over = whole_set(task.aircraft, nominal.states[beats], task.disturbance, task.coordinates, parts, Beyond())
    side = np.zeros((2, 8, sum(over.balls)))
    side[0, :, :8] = _SMALL * np.eye(8)
    side[1] = -side[0]
    points = np.broadcast_to(side.reshape(16, -1), (len(beats), 16, side.shape[2]))
    largest = []
    for law in (laws.batch(task.form, task.coordinates), None):
        ends = flown_map(task.aircraft, nominal, beats, task.coordinates, over, points, law)
        slopes = (ends[:, :8] - ends[:, 8:]) / (2.0 * _SMALL)
        own = [slopes[:, over.columns(part.name)][:, :, list(part.errors)] for part in parts]
        sizes = [
            np.linalg.eigvalsh(x @ form @ np.swapaxes(x, 1, 2))[:, -1] for x, form in zip(own, metric, strict=True)
        ]
        largest.append(np.stack(sizes, axis=1))
    return np.asarray(largest[0] <= largest[1])


def whole(task: Task, nominal: Nominal, beats: NDArray[np.intp], some: Laws | None) -> Laws:
    """Laws of all beats of the nominal: some given ones, zero elsewhere, with the room that the nominal leaves."""
    out = Laws.none(task.form, nominal.beats)
    if some is not None:
        out.coefficients[beats], out.reach[beats] = some.coefficients, some.reach
    if task.settings.saturation > 1.0:
        ground = groundwork(task.aircraft, nominal, task.disturbance, task.settings)
        for part, own in zip(task.settings.parts, ground.parts, strict=True):
            out.room[:, part.controls] = np.stack([own.lower, own.upper], axis=-1)
    return out


def within_limits(task: Task, nominal: Nominal, beats: NDArray[np.intp], laws: Laws) -> NDArray[np.bool_]:
    """Whether each part's law keeps its controls within their limits on the disturbance box: (b, parts)."""
    settings, coordinates = task.settings, task.coordinates
    if settings.saturation > 1.0:
        return np.ones((len(beats), len(settings.parts)), bool)
    seen = coordinates.box(nominal.states[beats], (1.0 + settings.measurement_error) * task.disturbance.half_widths)
    lower, upper = available_increments(
        task.aircraft, nominal.states[beats], nominal.controls[beats], coordinates, seen
    )
    limit = np.minimum(-lower, upper)
    # no monomial is larger on the box than at its corner
    largest = np.prod(seen[:, None] ** task.form.exponents, axis=2)
    inside = np.sum(np.abs(laws.coefficients[beats]) * largest[:, None, :], axis=-1) <= (1.0 + 1e-6) * limit + 1e-12
    return np.stack([inside[:, part.controls].all(1) for part in settings.parts], axis=1)
