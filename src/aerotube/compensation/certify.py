"""Bounds beyond the polynomials, for all beats: batches of beats, in threads."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.compensation import boundary, rigorous, sampled
from aerotube.compensation.bounds import Beyond, Bound, whole_set
from aerotube.compensation.closed_loop import BatchLaw
from aerotube.compensation.polynomial import Size
from aerotube.compensation.rigorous import Pieces
from aerotube.compensation.settings import Part, SynthesisSettings
from aerotube.compensation.worst_points import Sampling, Search
from aerotube.dynamics import (
    BeatSet,
    ErrorCoordinates,
    ErrorEnclosure,
    Excess,
    SizeSamples,
    enclose_error_map,
    flown_map,
    polynomial_law,
)
from aerotube.dynamics.enclosure import ComponentLaw
from aerotube.errors import ComputationError
from aerotube.nominal import Nominal
from aerotube.tube import DisturbanceSet

Array = NDArray[np.float64]
Beats = NDArray[np.intp]
T = TypeVar("T")

#: With the law and without it: size of the polynomials and whether its program is on the ball.
Sizes = tuple[tuple[Size, bool], tuple[Size, bool]]
#: With the law and without it: the bound, and the seconds of each beat.
Found = tuple[tuple[Bound, Array], tuple[Bound, Array]]

_SAMPLED, _ENCLOSED = 30, 10  # beats of a batch; the numbers depend on it in the last digit
_FEW = 12  # variables up to which enclosures are of order four; three beyond


@dataclass(frozen=True)
class Work:
    """What tubes are to be measured.

    Attributes
    ----------
    beats : ndarray (b,) of int
    parts : tuple of Part
    metric : tuple of ndarray (b, n, n)
    degree : int
        Of the programs.
    beyond : Beyond
    sampling : Sampling
    workers : int
    """

    aircraft: Aircraft
    nominal: Nominal
    disturbance: DisturbanceSet
    coordinates: ErrorCoordinates
    beats: Beats
    parts: tuple[Part, ...]
    metric: tuple[Array, ...]
    degree: int
    beyond: Beyond
    sampling: Sampling
    workers: int

    @classmethod
    def of(
        cls,
        aircraft: Aircraft,
        nominal: Nominal,
        disturbance: DisturbanceSet,
        coordinates: ErrorCoordinates,
        beats: Beats,
        parts: tuple[Part, ...],
        metric: tuple[Array, ...],
        settings: SynthesisSettings,
        workers: int,
    ) -> Work:
        """What the settings ask for."""
        return cls(
            aircraft=aircraft,
            nominal=nominal,
            disturbance=disturbance,
            coordinates=coordinates,
            beats=beats,
            parts=parts,
            metric=metric,
            degree=max(settings.degree, 2 * settings.law_degree),
            beyond=Beyond(settings.measurement_error, settings.gust, settings.gust_rotation),
            sampling=Sampling(settings.samples, settings.confidence, settings.sample_seed),
            workers=workers,
        )

    def set_of(self, beats: Beats, beyond: Beyond) -> BeatSet:
        """Everything that the tubes of some beats must withstand."""
        states = self.nominal.states[beats]
        return whole_set(self.aircraft, states, self.disturbance, self.coordinates, self.parts, beyond)

    @property
    def air(self) -> Beyond:
        """What acts without a law too."""
        return Beyond(0.0, self.beyond.gust, self.beyond.gust_rotation)

    def batches(self, task: Callable[[slice], T], size: int) -> list[T]:
        """Do a task for batches of beats, in threads, and collect the results in order."""
        rows = [slice(first, first + size) for first in range(0, len(self.beats), size)]
        if self.workers == 1:
            return [task(row) for row in rows]
        with ThreadPoolExecutor(self.workers) as pool:
            return list(pool.map(task, rows))


def sampled_bounds(work: Work, law: BatchLaw, sizes: Sequence[Sizes]) -> list[Found]:
    """Sampled bounds of every part, with the law and without it.

    Parameters
    ----------
    work : Work
    law : BatchLaw
    sizes : sequence of Sizes
        Of each part.

    Returns
    -------
    list of Found
        One for each part.
    """

    def search(beats: Beats, flown: BatchLaw | None) -> Search:
        over = work.set_of(beats, work.beyond if flown is not None else work.air)
        fly = partial(_fly, work, beats, over, flown)
        return Search(fly, over, work.sampling)

    def task(rows: slice) -> list[Found]:
        beats = work.beats[rows]
        flat = search(beats, None)
        started = time.perf_counter()
        loop = search(beats, law)
        shared = (time.perf_counter() - started) / len(work.parts)
        out = []
        for part, metric, ((closed, _), (free, _)) in zip(work.parts, work.metric, sizes, strict=True):
            started = time.perf_counter()
            bound = sampled.bound(loop, part, metric[rows], closed.rho[rows])
            seconds = np.full(len(beats), (time.perf_counter() - started + shared) / len(beats))
            bound = sampled.with_control(bound, loop, flat, part, metric[rows], closed.rho[rows])
            out.append(((bound, seconds), (sampled.bound(flat, part, metric[rows], free.rho[rows]), seconds)))
        return out

    return _joined(work.batches(task, _SAMPLED))


def sampled_sizes(work: Work, law: BatchLaw | None) -> Array:
    """Sampled sizes of every part, with a law or without it: ndarray (b, parts), infinite where there is no bound."""

    def task(rows: slice) -> Array:
        beats = work.beats[rows]
        over = work.set_of(beats, work.beyond if law is not None else work.air)
        search = Search(partial(_fly, work, beats, over, law), over, work.sampling)
        return sampled.sizes(search, work.parts, [metric[rows] for metric in work.metric])

    # each thread has one batch: the flights are many, and what is done once a batch is not
    return np.concatenate(work.batches(task, -(-len(work.beats) // work.workers)))


def _fly(work: Work, beats: Beats, over: BeatSet, law: BatchLaw | None, points: Array) -> Array:
    return flown_map(work.aircraft, work.nominal, beats, work.coordinates, over, points, law)


def _joined(batches: Sequence[list[Found]]) -> list[Found]:
    """From a list of batches of lists of parts to one list of parts."""

    def along(pairs: Sequence[tuple[Bound, Array]]) -> tuple[Bound, Array]:
        names = [field.name for field in fields(Bound) if field.name != "why"]
        together: dict[str, Any] = {name: np.concatenate([getattr(b, name) for b, _ in pairs]) for name in names}
        return Bound(**together, why=pairs[0][0].why), np.concatenate([seconds for _, seconds in pairs])

    parts = range(len(batches[0]))
    return [(along([batch[i][0] for batch in batches]), along([batch[i][1] for batch in batches])) for i in parts]


def rigorous_bounds(work: Work, law: BatchLaw, sizes: Sequence[Sizes]) -> list[Found]:
    """Rigorous bounds of every part, with the law and without it; parameters as of `sampled_bounds`."""
    batches = work.batches(lambda rows: _pieces(work, law, sizes, np.arange(len(work.beats))[rows]), _ENCLOSED)
    out = []
    for index, pair in enumerate(sizes):
        found = []
        for which, (size, _) in enumerate(pair):
            started = time.perf_counter()
            chunks = [batch[index].pieces[which] for batch in batches]
            bound = rigorous.bound(rigorous.joined(chunks), size, work.degree, work.workers)
            own = (time.perf_counter() - started) / len(work.beats)
            found.append((bound, own + np.concatenate([batch[index].seconds for batch in batches])))
        out.append((found[0], found[1]))
    return out


@dataclass(frozen=True)
class _PartPieces:
    """Of one part: with the law and without it, and the seconds of each beat with the law."""

    pieces: tuple[Pieces, Pieces]
    seconds: Array


def _pieces(work: Work, law: BatchLaw, sizes: Sequence[Sizes], rows: Beats) -> list[_PartPieces]:
    """Pieces of every part for a batch of beats, beat by beat where the batch has no enclosure."""
    try:
        return _enclosed(work, law, sizes, rows)
    except ComputationError:
        if len(rows) == 1:
            return [
                _PartPieces((_missing(work, closed, part), _missing(work, flat, part)), np.zeros(1))
                for part, (closed, flat) in zip(work.parts, sizes, strict=True)
            ]
    single = [_pieces(work, law, sizes, rows[i : i + 1]) for i in range(len(rows))]
    return [
        _PartPieces(
            (
                rigorous.joined([one[index].pieces[0] for one in single]),
                rigorous.joined([one[index].pieces[1] for one in single]),
            ),
            np.concatenate([one[index].seconds for one in single]),
        )
        for index in range(len(work.parts))
    ]


def _enclosed(work: Work, law: BatchLaw, sizes: Sequence[Sizes], rows: Beats) -> list[_PartPieces]:
    beats = work.beats[rows]

    def enclose(beyond: Beyond, flown: ComponentLaw | None) -> ErrorEnclosure:
        over = work.set_of(beats, beyond)
        order = 4 if sum(over.balls) <= _FEW else 3
        return enclose_error_map(work.aircraft, work.nominal, beats, work.coordinates, over, flown, order)

    flat = enclose(work.air, None)
    started = time.perf_counter()
    loop = enclose(work.beyond, component_law(law, beats))
    shared = (time.perf_counter() - started) / len(work.parts)
    comparable = flat if flat.set.names == loop.set.names else None
    names = [part.name for part in work.parts]
    uncertain = [name for name in loop.set.names if name in work.aircraft.parameter_names]
    out = []
    for part, metric, pair in zip(work.parts, work.metric, sizes, strict=True):
        others = [name for name in names if name != part.name]
        made = []
        for enclosure, (size, on_ball), other in zip((flat, loop), pair[::-1], (None, comparable), strict=True):
            started = time.perf_counter()
            made.append(
                rigorous.pieces(
                    enclosure, part, others, uncertain, metric[rows], size.nodes, on_ball, work.degree, other
                )
            )
        seconds = (time.perf_counter() - started + shared) / len(rows)
        out.append(_PartPieces((made[1], made[0]), np.full(len(rows), seconds)))
    return out


def component_law(law: BatchLaw, beats: Beats) -> ComponentLaw:
    """A law with polynomial components, as Taylor models take it.

    Raises
    ------
    ComputationError
        If it is none.
    """
    coefficients, exponents = getattr(law, "coefficients", None), getattr(law, "exponents", None)
    if coefficients is None or exponents is None:
        raise ComputationError(f"enclosure of the error map: a {type(law).__name__} has no polynomial components.")
    room = getattr(law, "room", None)
    return polynomial_law(coefficients[beats], exponents, None if room is None else room[beats])


def _missing(work: Work, of: tuple[Size, bool], part: Part) -> Pieces:
    """What stands in for the pieces of a beat that has none."""
    n, size = len(part.errors), of[0]
    vertices = len(work.disturbance.parameter_vertices(work.aircraft))
    none = np.zeros(1)
    inside = boundary.nodes(n, work.degree)
    return Pieces(
        holds=np.zeros(1, dtype=bool),
        samples=SizeSamples(np.ones((1, vertices, len(size.nodes))), none, none),
        left=Excess(none, none, none, none, none, none, none),
        own=np.broadcast_to(inside, (1, vertices, *inside.shape)).copy(),
        cover=np.eye(n)[None],
    )
