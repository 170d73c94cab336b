"""A search that tries to break tubes: points of the initial set that leave the terminal one.

For each beat, points are chosen to do harm (`aerotube.verify.adversity` flies them): random ones, the ends of every
axis and corners, the principal directions of the linearised beat, and from the worst of these by ascent along
finite-difference gradients, on the sets' boundaries. What is found is a lower bound of what there is: a tube it does
not break is not proved by it, but the ratio of the worst found to the bound says how tight the bound is at most.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.compensation import Compensation, Tubes
from aerotube.errors import InputError
from aerotube.flight import FORMS
from aerotube.nominal import Nominal
from aerotube.tube import DisturbanceSet, ellipsoid, parameter_ranges
from aerotube.verify.adversity import ERRORS, WIND, Adversity, BeatSpace
from aerotube.verify.search import WorstPoints

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

#: Certificates that promise something of the true map over a tube's whole set.
PROMISING = ("sampled", "rigorous")

#: Beyond this ratio a tube is broken; the rest is rounding.
TOLERANCE = 1e-9


@dataclass(frozen=True)
class Falsification:
    """The worst that was found.

    Attributes
    ----------
    parts : tuple of str
    ratio : ndarray (T, parts, 2)
        Largest size at the end of the beat over the tube's, for each of `FORMS`: above one, the tube is broken. NaN
        where there is no tube or it was not attacked.
    error : ndarray (T, parts, 2, 8)
        The error at the start that does it, in the law's coordinates.
    parameters : ndarray (T, parts, 2, p)
        The parameters that do it.
    measurement_error : ndarray (T, parts, 2, 8)
        The measurement error that does it.
    wind : ndarray (T, parts, 2, 6)
        The wind that does it.
    samples : int
        Random points tried for each tube, besides extreme points and ascents.
    seed : int
    interrupted : bool
        The search was cut short: beats that were not finished are missing.
    """

    parts: tuple[str, ...]
    ratio: Array
    error: Array
    parameters: Array
    measurement_error: Array
    wind: Array
    samples: int
    seed: int
    interrupted: bool = False

    @property
    def broken(self) -> NDArray[np.bool_]:
        """Which tubes are broken, beyond rounding: ndarray (T, parts, 2)."""
        return np.asarray(self.ratio > 1.0 + TOLERANCE)


def falsify(
    aircraft: Aircraft,
    nominal: Nominal,
    disturbance: DisturbanceSet,
    made: Compensation,
    *,
    adversity: Adversity | None = None,
    beats: Sequence[int] | None = None,
    samples: int = 1000,
    starts: int = 8,
    ascents: int = 40,
    seed: int = 0,
    workers: int = 1,
    progress: Progress | None = None,
) -> Falsification:
    """Try to break the tubes of a synthesis.

    Parameters
    ----------
    aircraft : Aircraft
        The one that flies.
    nominal : Nominal
    disturbance : DisturbanceSet
        Its uncertain parameters; the errors at the start are those of the tubes' initial ellipsoids.
    made : Compensation
        Or anything with its ``law`` and ``tubes``.
    adversity : Adversity, optional
        What the tubes must withstand besides; by default what they say they do.
    beats : sequence of int, optional
        All by default.
    samples : int
        Random points for each tube, half of them on the boundary.
    starts, ascents : int
        Worst points from which the search climbs, and steps of each climb.
    seed : int
    workers : int
        Threads; the numbers do not depend on it.
    progress : callable, optional
        Told the beats done and their number.

    Returns
    -------
    Falsification
        After Ctrl-C what was finished by then, marked as interrupted.

    Raises
    ------
    InputError
        If a number is out of range.
    """
    if samples < 1 or starts < 1 or ascents < 0:
        raise InputError(f"falsify: samples {samples}, starts {starts} and ascents {ascents}: give at least one.")
    chosen = list(range(nominal.beats)) if beats is None else [int(beat) for beat in beats]
    for beat in chosen:
        if not 0 <= beat < nominal.beats:
            raise InputError(f"falsify: there is no beat {beat}; the nominal has beats 0 to {nominal.beats - 1}.")
    ranges = parameter_ranges(aircraft, disturbance.relative)
    counts = (nominal.beats, len(made.tubes.parts), len(FORMS))
    found = Falsification(
        parts=tuple(part.name for part in made.tubes.parts),
        ratio=np.full(counts, np.nan),
        error=np.zeros((*counts, ERRORS)),
        parameters=np.zeros((*counts, len(ranges))),
        measurement_error=np.zeros((*counts, ERRORS)),
        wind=np.zeros((*counts, WIND)),
        samples=samples,
        seed=seed,
    )
    forms = _forms(made.tubes)
    promised = claims_of(made, nominal, disturbance)
    task = (aircraft, nominal, made, ranges)

    def attack(beat: int) -> None:
        generator = np.random.default_rng([seed, beat])
        claims = promised[beat] if adversity is None else [(list(range(counts[1])), adversity)]
        spaces = [space for group, each in claims for space in _spaces(task, beat, group, each)]
        for group, space in spaces:
            pairs = [(i, k) for i in group for k in range(len(FORMS))]
            targets = [(i, k) for i, k in pairs if np.isfinite(forms[i][k][beat]).all()]
            if not targets:
                continue
            sizes = [(list(made.tubes.parts[i].errors), forms[i][k][beat]) for i, k in targets]
            for target, point, ratio in zip(
                targets, *WorstPoints(space, sizes).worst(samples, starts, ascents, generator), strict=True
            ):
                at = (beat, *target)
                found.ratio[at] = ratio
                found.error[at], found.parameters[at], found.measurement_error[at], found.wind[at] = (
                    values[0] for values in space.disturbances(point[None])
                )

    interrupted = _in_threads(attack, chosen, workers, progress)
    return replace(found, interrupted=interrupted)


def kinds(tubes: Tubes) -> NDArray[np.str_]:
    """What stands behind each tube: ndarray (T, parts) of str."""
    return np.broadcast_to(np.asarray(tubes.certificate, dtype=str), tubes.size.shape)


def claims_of(
    made: Compensation, nominal: Nominal, disturbance: DisturbanceSet
) -> list[list[tuple[list[int], Adversity]]]:
    """What the tubes of each beat say they withstand: parts, and their adversity.

    Those that are sampled or rigorous withstand the errors of all parts, and the measurement errors and gusts that
    were asked of them; others their own errors alone, measured exactly, in still air.
    """
    settings, states = made.settings, nominal.states[:-1]
    measurement = np.zeros((len(states), ERRORS))
    if settings.measurement_error > 0:
        widths = settings.measurement_error * disturbance.half_widths
        measurement = made.law.coordinates.box(states, widths)
    wind = np.repeat([settings.gust, settings.gust_rotation], 3)
    whole, alone = Adversity(1.0, measurement, wind), Adversity()
    out = []
    for row in np.isin(kinds(made.tubes), PROMISING):
        groups = ((np.flatnonzero(row), whole), (np.flatnonzero(~row), alone))
        out.append([([int(i) for i in group], each) for group, each in groups if len(group)])
    return out


def _forms(tubes: Tubes) -> list[list[Array]]:
    """Matrices whose quadratic form is one on a tube's boundary, for each part and each of `FORMS`."""
    pairs = ((tubes.metric, tubes.size), (tubes.terminal_shape, tubes.terminal_rho))
    return [[shape[:, i] / rho[:, i, None, None] for shape, rho in pairs] for i in range(len(tubes.parts))]


def _spaces(
    task: tuple[Aircraft, Nominal, Compensation, Array], beat: int, parts: list[int], adversity: Adversity
) -> list[tuple[list[int], BeatSpace]]:
    """Sets of a beat, with the parts whose tubes each is for: one for all, if each withstands the others' errors."""
    aircraft, nominal, made, ranges = task
    tubes = made.tubes
    balls = [
        (part.errors, ellipsoid.whitening(tubes.initial_shape[beat, i], tubes.initial_rho[beat, i]))
        for i, part in enumerate(tubes.parts)
    ]
    measurement, wind = adversity.at(beat)

    def space(chosen: Sequence[tuple[tuple[int, ...], Array]]) -> BeatSpace:
        return BeatSpace(aircraft, nominal, made.law, beat, chosen, ranges, measurement, wind)

    if adversity.others == 1.0 or len(balls) == 1:
        return [(parts, space(balls))]
    spaces = []
    for i in parts:
        shares = [1.0 if i == j else adversity.others for j in range(len(balls))]
        chosen = [(indices, share * map_) for (indices, map_), share in zip(balls, shares, strict=True) if share > 0]
        spaces.append(([i], space(chosen)))
    return spaces


def _in_threads(work: Callable[[int], None], beats: Sequence[int], workers: int, progress: Progress | None) -> bool:
    """Do the work of every beat; says whether it was interrupted."""
    pool = ThreadPoolExecutor(max(1, workers))
    try:
        waiting = [pool.submit(work, beat) for beat in beats]
        for done, future in enumerate(as_completed(waiting)):
            future.result()
            if progress is not None:
                progress(done + 1, len(beats))
    except KeyboardInterrupt:
        return True
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    return False
