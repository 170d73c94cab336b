"""The random part of a study: initial errors, uncertain parameters, measurement noise, gusts.

Every number is a function of its seed, its purpose and its run alone. So the same seed gives the same numbers
whatever other seeds, runs, horizon, options or workers are asked for, and every law flies on the same draws.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerotube.errors import InputError

Array = NDArray[np.float64]

# Part of every stream's identity: never renumber, or published figures change.
_INITIAL_ERROR, _PARAMETER, _MEASUREMENT, _GUST = range(4)


@dataclass(frozen=True, eq=False)
class Draws:
    """Random draws of a Monte Carlo study; the runs of all seeds are flattened into one axis, seed by seed.

    Attributes
    ----------
    seeds : tuple of int
    runs_per_seed : int
    half_widths : ndarray (8,)
        Half-widths of the disturbance box, ``[V, alpha, q, theta, beta, p, r, phi]``, SI and radians, as
        differences of Euler angles: initial errors and measurement noise are drawn from it.
    initial_error : ndarray (run, 8)
    parameters : ndarray (run, p)
        Uncertain parameters of the aircraft, constant during a run; the first is the inverse mass ratio.
    """

    seeds: tuple[int, ...]
    runs_per_seed: int
    half_widths: Array
    initial_error: Array
    parameters: Array

    @property
    def runs(self) -> int:
        """Number of runs of all seeds together."""
        return len(self.seeds) * self.runs_per_seed

    def name(self, run: int) -> str:
        """Name of a run in messages: its seed and its place among that seed's runs."""
        return f"run {run % self.runs_per_seed} of seed {self.seeds[run // self.runs_per_seed]}"

    def repeated(self, times: int, seeds: int) -> Draws:
        """The first seeds' draws, several times over: one set of runs for each of several laws, side by side.

        Parameters
        ----------
        times : int
        seeds : int
            Number of seeds to keep.

        Returns
        -------
        Draws
            Its ``seeds`` list is repeated too.
        """
        names = self.seeds[:seeds]
        runs = len(names) * self.runs_per_seed
        return Draws(
            names * times,
            self.runs_per_seed,
            self.half_widths,
            np.tile(self.initial_error[:runs], (times, 1)),
            np.tile(self.parameters[:runs], (times, 1)),
        )

    def measurement_noise(self, beats: int) -> Array:
        """Measurement errors of the full range, fresh at every beat.

        Parameters
        ----------
        beats : int

        Returns
        -------
        ndarray (run, beat, 8)
            Uniform in the disturbance box; scale it for a fraction of the range.
        """
        out = np.empty((self.runs, beats, 8))
        for run, generator in enumerate(self._generators(_MEASUREMENT)):
            generator.random(out=out[run])
        out *= 2.0
        out -= 1.0
        out *= self.half_widths
        return out

    def gust_noise(self, beats: int, channels: int) -> Array:
        """Independent standard normal numbers that drive a gust model.

        Parameters
        ----------
        beats, channels : int

        Returns
        -------
        ndarray (run, beat, channel)
        """
        out = np.empty((self.runs, beats, channels))
        for run, generator in enumerate(self._generators(_GUST)):
            generator.standard_normal(out=out[run])
        return out

    def _generators(self, purpose: int) -> Iterator[np.random.Generator]:
        """One generator, set to the stream of each run in turn."""
        for seed in self.seeds:
            # One key for each seed and purpose, and the run in the counter's upper half: streams that never meet.
            # Setting the counter of one generator costs a fifteenth of making a generator for every run.
            key = np.random.SeedSequence(seed, spawn_key=(purpose,)).generate_state(2, np.uint64)
            stream = np.random.Philox(key=key)
            generator = np.random.Generator(stream)
            fresh = stream.state
            for run in range(self.runs_per_seed):
                fresh["state"]["counter"][:] = 0, 0, run, 0
                stream.state = fresh
                yield generator


def draw(
    half_widths: Sequence[float] | Array,
    seeds: Iterable[int],
    runs_per_seed: int,
    *,
    initial: Callable[[int, np.random.Generator], Array] | None = None,
    mass_error: float = 0.0,
    other_parameters: Sequence[tuple[float, float]] = (),
    inverse: Sequence[int] = (0,),
) -> Draws:
    """Draw initial errors and parameters for every run of every seed.

    Parameters
    ----------
    half_widths : sequence of 8 floats
        Half-widths of the box of initial errors, ``[V, alpha, q, theta, beta, p, r, phi]``, SI and radians
        (Table 2 of the paper). Zero switches a state's disturbance off.
    seeds : iterable of int
        Distinct and not negative.
    runs_per_seed : int
        At least one.
    initial : callable, optional
        Draws a number of initial errors (count, 8) from another set than the box, in which the measurement noise
        remains. All of a seed are drawn at once, so that these depend on the number of runs.
    mass_error : float
        Half-width of the relative mass error, uniform in mass, from 0 to less than 1; the aircraft is given
        the inverse mass ratio ``1 / (1 + error)``.
    other_parameters : sequence of (lower, upper)
        Ranges of the aircraft's further uncertain parameters, uniform, in the order of its
        ``parameter_names`` after ``inverse_mass``.
    inverse : sequence of int
        Places, the mass being 0, of what is drawn as a ratio of quantities and given to the aircraft as its inverse.

    Returns
    -------
    Draws

    Raises
    ------
    InputError
        For a box, a list of seeds, a number of runs or a range that makes no sense.
    """
    box = np.array(half_widths, dtype=float)
    if box.shape != (8,) or not np.all(np.isfinite(box)) or np.any(box < 0):
        raise InputError(
            "disturbance box: expected 8 finite half-widths [V, alpha, q, theta, beta, p, r, phi], none negative; "
            f"got {half_widths!r}."
        )
    names = _checked_seeds(seeds)
    if isinstance(runs_per_seed, bool) or not isinstance(runs_per_seed, int | np.integer) or runs_per_seed < 1:
        raise InputError(f"runs per seed: expected a whole number, at least 1; got {runs_per_seed!r}.")
    if not 0.0 <= mass_error < 1.0:
        raise InputError(f"mass error: expected a fraction from 0 to less than 1; got {mass_error!r}.")
    ranges = [(1.0 - mass_error, 1.0 + mass_error), *other_parameters]
    for lower, upper in ranges:
        if not (np.isfinite(lower) and np.isfinite(upper) and lower <= upper):
            raise InputError(f"parameter range: expected lower <= upper, both finite; got ({lower}, {upper}).")

    errors, parameters = [], []
    for seed in names:
        generator = _generator(seed, _INITIAL_ERROR)
        if initial is None:
            errors.append(box * generator.uniform(-1.0, 1.0, (int(runs_per_seed), 8)))
        else:
            errors.append(initial(int(runs_per_seed), generator))
        columns = [
            _generator(seed, _PARAMETER, place).uniform(lower, upper, int(runs_per_seed))
            for place, (lower, upper) in enumerate(ranges)
        ]
        parameters.append(np.stack(columns, axis=-1))
    sigma = np.concatenate(parameters)
    sigma[:, list(inverse)] = 1.0 / sigma[:, list(inverse)]
    start = np.concatenate(errors)
    for array in (box, start, sigma):
        array.setflags(write=False)
    return Draws(names, int(runs_per_seed), box, start, sigma)


def _checked_seeds(seeds: Iterable[Any]) -> tuple[int, ...]:
    names = tuple(seeds)
    if not names:
        raise InputError("seeds: the list is empty; give at least one.")
    for seed in names:
        if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
            raise InputError(f"seeds: expected whole numbers, none negative; got {seed!r}.")
    if len(set(names)) < len(names):
        raise InputError("seeds: one is listed twice, and its runs would count twice; list each once.")
    return tuple(int(seed) for seed in names)


def _generator(seed: int, *purpose: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=purpose)))
