"""Compensation laws for beats of a nominal trajectory (the paper's Algorithms 1 to 3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.aircraft.base import Aircraft
from aerotube.compensation import law_program, limits
from aerotube.compensation.closed_loop import end_errors
from aerotube.compensation.groundwork import Groundwork, groundwork, taken
from aerotube.compensation.groundwork import available_increments as available_increments
from aerotube.compensation.law import LinearLaw, PolynomialLaw, assembled
from aerotube.compensation.law_program import GroupData, Shape
from aerotube.compensation.settings import Part, SynthesisSettings
from aerotube.dynamics import Linearisation
from aerotube.nominal import Nominal
from aerotube.tube import DisturbanceBox, DisturbanceSet

Array = NDArray[np.float64]
Beats = NDArray[np.intp]
Progress = Callable[[int, int], None]

# Programs are solved together as far as their data fit into this many bytes.
_MEMORY = 2e8


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
        The optimal value of each program, as the solver reports it: the majorant that was minimised, effort
        included. With reuse, that of all beats which share the law.
    solve_seconds : ndarray (b, parts)
        Time in the solver, of one part of one beat. With reuse, the beats which share a law share its time equally.
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
    solve_seconds: Array
    settings: SynthesisSettings
    linearisation: Linearisation


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
    task = _Task(
        aircraft,
        nominal,
        disturbance,
        settings,
        groundwork(aircraft, nominal, disturbance, settings),
        workers,
        deadline,
    )
    groups = _groups(chosen, nominal.beats, settings.reuse + 1)
    total = len(settings.parts) * sum(len(rows) for rows in groups)
    done = 0

    def tell(solved: int) -> None:
        nonlocal done
        done += solved
        if progress is not None:
            progress(done, total)

    found: list[list[_PartLaws]] = [[] for _ in settings.parts]
    for rows in groups:
        for one, made in zip(found, _design_groups(task, rows, tell), strict=True):
            one.append(made)
    parts = [_joined(one, chosen) for one in found]

    def gather(name: str) -> Array:
        return np.stack([getattr(part, name) for part in parts], axis=1)

    return Design(
        law=assembled(
            [(part.errors, part.controls, laws.coefficients) for part, laws in zip(settings.parts, parts, strict=True)],
            settings.law_degree,
            nominal.beats,
            chosen,
            task.ground.coordinates,
        ),
        beats=chosen,
        metric=tuple(ground.metric[chosen] for ground in task.ground.parts),
        feasible=gather("feasible").astype(bool),
        stopped=gather("stopped").astype(bool),
        messages=[message for one in found for made in one for message in made.messages],
        bound=gather("bound"),
        solve_seconds=gather("seconds"),
        settings=settings,
        linearisation=task.ground.linear,
    )


@dataclass(frozen=True)
class _Task:
    """What all programs share."""

    aircraft: Aircraft
    nominal: Nominal
    disturbance: DisturbanceSet
    settings: SynthesisSettings
    ground: Groundwork
    workers: int
    deadline: float | None


@dataclass(frozen=True)
class _PartLaws:
    """The laws of one part, for the beats of ``rows`` (b, g), or one by one (b,)."""

    rows: Beats
    coefficients: Array
    feasible: NDArray[np.bool_]
    stopped: NDArray[np.bool_]
    bound: Array
    seconds: Array
    messages: list[str]


def _groups(chosen: Beats, beats: int, length: int) -> list[Beats]:
    """Rows of beats that share a law: first the whole ones, then a shorter one at the nominal's end."""
    rows = np.unique(chosen // length)[:, None] * length + np.arange(length)
    whole = rows[rows[:, -1] < beats]
    rest = rows[rows[:, -1] >= beats]
    return [part for part in (whole, rest[:, : beats - rest[0, 0]] if len(rest) else rest) if len(part)]


def _joined(laws: list[_PartLaws], chosen: Beats) -> _PartLaws:
    """The laws of the chosen beats, one by one."""
    beats = np.concatenate([one.rows.ravel() for one in laws])
    place = np.argsort(beats)[np.searchsorted(np.sort(beats), chosen)]

    def of_each_beat(name: str) -> Array:
        values = [np.repeat(getattr(one, name), one.rows.shape[1], axis=0) for one in laws]
        return np.asarray(np.concatenate(values)[place])

    return _PartLaws(
        beats[place],
        of_each_beat("coefficients"),
        of_each_beat("feasible").astype(bool),
        of_each_beat("stopped").astype(bool),
        of_each_beat("bound"),
        of_each_beat("seconds"),
        [],
    )


def _design_groups(task: _Task, rows: Beats, tell: Callable[[int], None]) -> list[_PartLaws]:
    """Laws of all parts for rows of beats (b, g); parts of the same kind are solved together."""
    shapes = [_shape(task, index, rows.shape[1]) for index in range(len(task.settings.parts))]
    data = [_group_data(task, index, shape, rows) for index, shape in enumerate(shapes)]
    made: dict[int, _PartLaws] = {}
    for shape in dict.fromkeys(shapes):
        own = [index for index, other in enumerate(shapes) if other == shape]
        both = GroupData(
            *(np.concatenate([getattr(data[index], field.name) for index in own]) for field in fields(GroupData))
        )
        names = [(task.settings.parts[index].name, row) for index in own for row in rows]
        laws = _solved(task, shape, both, names, tell)
        for position, index in enumerate(own):
            at = slice(position * len(rows), (position + 1) * len(rows))
            made[index] = _PartLaws(
                rows=rows,
                coefficients=laws.coefficients[at],
                feasible=laws.feasible[at],
                stopped=laws.stopped[at],
                bound=laws.bound[at],
                seconds=laws.seconds[at],
                messages=laws.messages if position == 0 else [],
            )
    return [made[index] for index in range(len(shapes))]


def _shape(task: _Task, index: int, steps: int) -> Shape:
    settings, part = task.settings, task.settings.parts[index]
    where, corners = settings.limits, 0
    if where == "box" and settings.law_degree == 1 and not isinstance(task.disturbance, DisturbanceBox):
        # on a set with corners the limits hold there; on any other, on the ellipsoid around it
        corners = steps * len(_corners(task, index, np.zeros(1, dtype=np.intp))[0])
        where = "box" if corners else "ellipsoid"
    return Shape(
        states=len(part.errors),
        controls=len(part.controls),
        vertices=len(task.ground.vertices),
        steps=steps,
        law_degree=settings.law_degree,
        degree=max(settings.degree, 2 * settings.law_degree),
        weights=settings.weights,
        limits=where,
        corners=corners,
    )


def _measurement(task: _Task, part: Part, beats: Beats) -> Array:
    """Half-widths of the box of a part's measurement errors: ndarray (b, n)."""
    share, errors = task.settings.measurement_error, list(part.errors)
    if share == 0.0:
        return np.zeros((len(beats), len(errors)))
    widths = share * task.disturbance.half_widths
    return task.ground.coordinates.box(task.nominal.states[beats], widths)[:, errors]


def _corners(task: _Task, index: int, beats: Beats) -> Array:
    """Corners of the set of a part's measured errors: ndarray (b, k, n)."""
    initial = taken(task.ground.parts[index].initial, beats)
    return initial.seen_corners(_measurement(task, task.settings.parts[index], beats))


def _group_data(task: _Task, index: int, shape: Shape, rows: Beats) -> GroupData:
    """Data of one part's programs for rows of beats (b, g)."""
    part, ground = task.settings.parts[index], task.ground
    own, beats, lead = ground.parts[index], rows.ravel(), rows.shape
    e, c = np.array(part.errors), np.array(part.controls)
    initial = taken(own.initial, beats)
    inverse = np.linalg.inv(initial.whitening)

    def whitened(moment: Array, least: float) -> Array:
        inside = inverse @ moment[beats][:, e[:, None], e] @ np.swapaxes(inverse, 1, 2)
        return np.asarray(inside + least / len(e) * np.eye(len(e))).reshape(*lead, len(e), len(e))

    points = np.einsum("bij,uj->bui", initial.whitening, law_program.nodes(shape))
    values = end_errors(task.aircraft, task.nominal, beats, ground.coordinates, part, points, ground.vertices)
    whitening = initial.whitening.reshape(*lead, *initial.whitening.shape[1:])
    seen = ground.seen[rows][..., e]
    lower, upper = own.lower[rows].max(1), own.upper[rows].min(1)
    span = upper - lower
    # a linear law needs both sides of a control; one that cannot have them is taken out of the program
    usable = (np.minimum(-lower, upper) if shape.law_degree == 1 else span) > 1e-6 * span
    widths = initial.widths.reshape(*lead, len(e))
    turn = np.linalg.norm(np.linalg.inv(whitening[:, :1]) @ whitening, 2, axis=(-2, -1))
    growth = (seen / widths).max(-1)
    if not isinstance(task.disturbance, DisturbanceBox):
        growth = initial.seen_growth(_measurement(task, part, beats)).reshape(lead)
    corners = np.zeros((len(rows), 0, len(e)))
    if shape.corners:
        corners = _corners(task, index, beats).reshape(len(rows), -1, len(e))
    return GroupData(
        map_values=values.reshape(*lead, *values.shape[1:]),
        input_map=ground.input_map[rows][:, :, :, e[:, None], c] * usable[:, None, None, None, :],
        whitening=whitening,
        metric=own.metric[rows],
        seen=seen.max(1),
        corners=corners,
        growth=(growth * turn).max(1),
        lower=np.where(usable, lower, -span),
        upper=np.where(usable, upper, span),
        usable=usable,
        expected=whitened(ground.expected.moment, task.settings.least_expected),
        noise=whitened(ground.expected.noise, 0.0),
        effort=ground.effort[rows][:, :, c[:, None], c],
    )


def _solved(
    task: _Task, shape: Shape, data: GroupData, names: list[tuple[str, Beats]], tell: Callable[[int], None]
) -> _PartLaws:
    """Solve a batch of programs, as many at a time as fit into memory."""
    settings, structure = task.settings, law_program.structure(shape)
    each = 8.0 * sum(
        sum(float(np.prod(size)) for size in c.shapes(structure.size).values()) for c in structure.constraints
    )
    count = max(2 * task.workers, int(_MEMORY / each))
    found: list[_PartLaws] = []
    for start in range(0, len(names), count):
        some = taken(data, np.arange(start, min(start + count, len(names))))
        scaling = law_program.scale(some)
        problem = law_program.program_data(shape, some, scaling)
        solution = sos.solve(structure, problem, backend=settings.backend, deadline=task.deadline, workers=task.workers)
        feasible = solution.status == sos.Status.OPTIMAL
        coefficients = law_program.coefficients(shape, solution["K"], some, scaling)
        stopped = (solution.status == sos.Status.DEADLINE) & np.isfinite(coefficients).all((1, 2))
        coefficients = np.where((feasible | stopped)[:, None, None], coefficients, 0.0)
        coefficients *= (some.usable * limits.into(shape, some, scaling, solution))[:, :, None]
        steps = len(names[0][1])
        found.append(
            _PartLaws(
                np.empty(0, dtype=np.intp),
                coefficients,
                feasible,
                stopped,
                np.where(feasible, solution.objective * scaling.size, np.nan),
                solution.seconds / steps,
                [_sentence(*names[start + i], solution, int(i)) for i in np.flatnonzero(~feasible & ~stopped)],
            )
        )
        tell(len(feasible))

    def joined(name: str) -> Array:
        return np.concatenate([getattr(one, name) for one in found])

    return _PartLaws(
        np.empty(0, dtype=np.intp),
        joined("coefficients"),
        joined("feasible").astype(bool),
        joined("stopped").astype(bool),
        joined("bound"),
        joined("seconds"),
        [message for one in found for message in one.messages],
    )


def _sentence(part: str, row: Beats, solution: sos.Solution, position: int) -> str:
    """Why a part of a beat, or of the beats that share a law, has none."""
    beats = f"beat {row[0]}" if len(row) == 1 else f"beats {row[0]} to {row[-1]}"
    status = str(sos.Status(int(solution.status[position])))
    return f"{beats}, {part}: no law ({status}); the nominal alone is flown."
