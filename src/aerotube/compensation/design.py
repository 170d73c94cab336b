"""Compensation laws for beats of a nominal trajectory (the paper's Algorithms 1 to 3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.compensation import exact_map
from aerotube.compensation.closed_loop import end_errors
from aerotube.compensation.exact_design import design_groups, measurement_box
from aerotube.compensation.groundwork import Groundwork, groundwork, taken
from aerotube.compensation.increment_design import design_increments
from aerotube.compensation.law import LinearLaw, PolynomialLaw, assembled
from aerotube.compensation.settings import SynthesisSettings
from aerotube.compensation.task import PartLaws, Task
from aerotube.compensation.terminal import Terminal, terminal_ellipsoid
from aerotube.dynamics import Linearisation
from aerotube.nominal import Nominal
from aerotube.tube import DisturbanceSet

Array = NDArray[np.float64]
Beats = NDArray[np.intp]
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Design:
    """Compensation laws, and how their computation went.

    Attributes
    ----------
    law : LinearLaw or PolynomialLaw
        Of the whole nominal; zero (the nominal alone) for a part of a beat that has no feasible law, and at
        beats that were not asked for.
    beats : ndarray (b,) of int
        The beats that were asked for: the first axis of what follows.
    metric : tuple of ndarray (b, n, n)
        The metric E1 in which each part's size was made small.
    feasible : ndarray (b, parts) of bool
    stopped : ndarray (b, parts) of bool
        Laws as they stood at the solver's deadline, brought into their limits: what they are worth, their measured
        size says. They do not count as feasible.
    messages : list of str
        One sentence for each failure.
    bound : ndarray (b, parts)
        The optimal value of each program, as the solver reports it, effort included: the majorant that was minimised,
        or the expectation of a law of higher degree with what its curvature was charged (so that values compare
        between laws of the same degree). With reuse, that of all beats which share the law.
    step_seconds : ndarray (b, parts, steps)
        Time in the solver, of one part of one beat: for the law and, in three steps, for the terminal ellipsoid. With
        reuse, the beats which share a law share its time equally.
    terminal : tuple of Terminal, or None
        Ellipsoids of each part at the end of the beats, where the algorithm finds them itself: in three steps, and in
        the increment form (there as claimed by its program, to first order in the step).
    settings : SynthesisSettings
    linearisation : Linearisation
        Of the error map along the whole nominal, in the law's coordinates.
    """

    law: LinearLaw | PolynomialLaw
    beats: Beats
    metric: tuple[Array, ...]
    feasible: NDArray[np.bool_]
    stopped: NDArray[np.bool_]
    messages: list[str]
    bound: Array
    step_seconds: Array
    terminal: tuple[Terminal, ...] | None
    settings: SynthesisSettings
    linearisation: Linearisation

    @property
    def solve_seconds(self) -> Array:
        """Time in the solver, of one part of one beat: ndarray (b, parts)."""
        return np.asarray(self.step_seconds.sum(-1))


def design(
    aircraft: Aircraft,
    nominal: Nominal,
    disturbance: DisturbanceSet,
    settings: SynthesisSettings | None = None,
    *,
    beats: range | Beats | None = None,
    workers: int = 1,
    deadline: float | None = None,
    progress: Progress | None = None,
    ground: Groundwork | None = None,
) -> Design:
    """Compute compensation laws for beats of a nominal trajectory.

    Parameters
    ----------
    aircraft : Aircraft
        Whose step map, sampled at nodes, the programs hold.
    nominal : Nominal
    disturbance : DisturbanceSet
        Errors at the start of a beat and uncertain parameters.
    settings : SynthesisSettings, optional
    beats : range or ndarray of int, rising, optional
        Beats to compute laws for; all by default. With reuse, beat t shares its law with those of the same
        ``t // (reuse + 1)``, whichever are asked for.
    workers : int
        Threads that solve; the numbers do not depend on it.
    deadline : float, optional
        Seconds allowed for each program; see ``stopped`` of :class:`Design`.
    progress : callable, optional
        Called with the number of programs solved and their total.
    ground : Groundwork, optional
        What the programs rest on, where it is already there.

    Returns
    -------
    Design

    Raises
    ------
    InputError
        If the nominal is outside the aircraft's model or limits.
    ComputationError
        If a Riccati shape does not exist.
    """
    settings = settings or SynthesisSettings()
    chosen = np.arange(nominal.beats) if beats is None else np.asarray(beats)
    ground = groundwork(aircraft, nominal, disturbance, settings) if ground is None else ground
    task = Task(aircraft, nominal, disturbance, settings, ground, workers, deadline)
    found = _solved(task, chosen, progress)
    parts = [_joined(one, chosen) for one in found]
    law = _law(task, parts, chosen)
    terminal = _terminal(task, law, parts, chosen)
    seconds = [np.stack([laws.seconds for laws in parts], axis=1)]
    if settings.steps == "three-step":
        seconds.append(np.stack([one.seconds for one in terminal], axis=1))

    def gather(name: str) -> Array:
        return np.stack([getattr(part, name) for part in parts], axis=1)

    return Design(
        law=law,
        beats=chosen,
        metric=tuple(own.metric[chosen] for own in ground.parts),
        feasible=gather("feasible").astype(bool),
        stopped=gather("stopped").astype(bool),
        messages=[message for one in found for made in one for message in made.messages],
        bound=gather("bound"),
        step_seconds=np.stack(seconds, axis=-1),
        terminal=tuple(terminal) or None,
        settings=settings,
        linearisation=ground.linear,
    )


def _solved(task: Task, chosen: Beats, progress: Progress | None) -> list[list[PartLaws]]:
    """Solve all programs: for each part, the laws of each group of beats."""
    settings = task.settings
    groups = _groups(chosen, task.nominal.beats, settings.reuse + 1)
    total = len(settings.parts) * sum(len(rows) for rows in groups)
    done = 0

    def tell(solved: int) -> None:
        nonlocal done
        done += solved
        if progress is not None:
            progress(done, total)

    found: list[list[PartLaws]] = [[] for _ in settings.parts]
    solve = design_groups if settings.formulation == "exact-map" else design_increments
    for rows in groups:
        for one, made in zip(found, solve(task, rows, tell), strict=True):
            one.append(made)
    return found


def _groups(chosen: Beats, beats: int, length: int) -> list[Beats]:
    """Rows of beats that share a law: first the whole ones, then a shorter one at the nominal's end."""
    rows = np.unique(chosen // length)[:, None] * length + np.arange(length)
    whole = rows[rows[:, -1] < beats]
    rest = rows[rows[:, -1] >= beats]
    return [part for part in (whole, rest[:, : beats - rest[0, 0]] if len(rest) else rest) if len(part)]


def _joined(laws: list[PartLaws], chosen: Beats) -> PartLaws:
    """The laws of the chosen beats, one by one."""
    beats = np.concatenate([one.rows.ravel() for one in laws])
    place = np.argsort(beats)[np.searchsorted(np.sort(beats), chosen)]

    def of_each_beat(name: str) -> Array:
        values = [np.repeat(getattr(one, name), one.rows.shape[1], axis=0) for one in laws]
        return np.asarray(np.concatenate(values)[place])

    return PartLaws(
        rows=beats[place],
        coefficients=of_each_beat("coefficients"),
        feasible=of_each_beat("feasible").astype(bool),
        stopped=of_each_beat("stopped").astype(bool),
        bound=of_each_beat("bound"),
        seconds=np.concatenate([np.repeat(one.seconds / one.rows.shape[1], one.rows.shape[1]) for one in laws])[place],
        messages=[],
        terminal=None if laws[0].terminal is None else taken(laws[0].terminal, place),
    )


def _law(task: Task, parts: list[PartLaws], chosen: Beats) -> LinearLaw | PolynomialLaw:
    """The law of the whole nominal, of those of its parts."""
    settings = task.settings
    return assembled(
        [(part.errors, part.controls, laws.coefficients) for part, laws in zip(settings.parts, parts, strict=True)],
        settings.law_degree,
        task.nominal.beats,
        chosen,
        task.ground.coordinates,
        _room(task) if settings.saturation > 1.0 else None,
        _reach(task) if settings.law_degree > 1 else None,
    )


def _terminal(task: Task, law: LinearLaw | PolynomialLaw, parts: list[PartLaws], chosen: Beats) -> list[Terminal]:
    """Terminal ellipsoids of each part: of the third step, the smallest with the law held, or of the law's programs."""
    if task.settings.steps != "three-step" or task.settings.formulation != "exact-map":
        return [laws.terminal for laws in parts if laws.terminal is not None]
    out = []
    for part, ground in zip(task.settings.parts, task.ground.parts, strict=True):
        degree, vertices = task.settings.degree, task.ground.vertices
        nodes = exact_map.size_structure(len(part.errors), len(vertices), degree).nodes("tube/0")
        points = np.einsum("bij,uj->bui", ground.initial.whitening[chosen], nodes)
        end = end_errors(task.aircraft, task.nominal, chosen, task.ground.coordinates, part, points, vertices, law)
        out.append(
            terminal_ellipsoid(
                end,
                ground.metric[chosen],
                task.settings.terminal,
                degree=degree,
                backend=task.settings.backend,
                workers=task.workers,
            )
        )
    return out


def _room(task: Task) -> Array:
    """Where a law saturates of its own accord: the increments that the limits leave, ndarray (T, 4, 2)."""
    room = np.zeros((task.nominal.beats, 4, 2))
    for part, ground in zip(task.settings.parts, task.ground.parts, strict=True):
        room[:, part.controls] = np.stack([ground.lower, ground.upper], axis=-1)
    return room


def _reach(task: Task) -> Array:
    """Brings measured errors of every part to the unit ball: ndarray (T, 8, 8)."""
    out = np.zeros((task.nominal.beats, 8, 8))
    for part, ground in zip(task.settings.parts, task.ground.parts, strict=True):
        e = np.array(part.errors)
        box = measurement_box(task, part, np.arange(task.nominal.beats))
        growth = np.maximum((task.ground.seen[:, e] / ground.initial.widths).max(-1), ground.initial.seen_growth(box))
        out[:, e[:, None], e] = np.linalg.inv(ground.initial.whitening) / growth[:, None, None]
    return out
