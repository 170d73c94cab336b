"""Laws from the exact map: the default formulation."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.compensation import carried, expectation, joint_shape, law_program, limits, mean_square, monomials
from aerotube.compensation.groundwork import taken
from aerotube.compensation.law_program import GroupData, Shape
from aerotube.compensation.settings import Part
from aerotube.compensation.task import PartLaws, Task, Tell, messages
from aerotube.tube import DisturbanceBox

Array = NDArray[np.float64]
Beats = NDArray[np.intp]

# Programs are solved together as far as their data fit into this many bytes.
_MEMORY = 2e8
# Rounds in which the weights of a trace follow the ellipsoid found, so that the last is of the volume.
_ROUNDS = 3
_NO_ROWS = np.empty(0, dtype=np.intp)


def design_groups(task: Task, rows: Beats, tell: Tell) -> list[PartLaws]:
    """Laws of all parts for rows of beats (b, g); parts of the same kind are solved together."""
    shapes = [_shape(task, index, rows) for index in range(len(task.settings.parts))]
    data = [_group_data(task, index, shape, rows) for index, shape in enumerate(shapes)]
    made: dict[int, PartLaws] = {}
    for shape in dict.fromkeys(shapes):
        own = [index for index, other in enumerate(shapes) if other == shape]
        both = GroupData(
            *(np.concatenate([getattr(data[index], field.name) for index in own]) for field in fields(GroupData))
        )
        names = [(index, row) for index in own for row in rows]
        laws = _solved(task, shape, both, names, tell)
        for position, index in enumerate(own):
            at = slice(position * len(rows), (position + 1) * len(rows))
            made[index] = PartLaws(
                rows=rows,
                coefficients=laws.coefficients[at],
                feasible=laws.feasible[at],
                stopped=laws.stopped[at],
                bound=laws.bound[at],
                seconds=laws.seconds[at],
                messages=laws.messages if position == 0 else [],
            )
    return [made[index] for index in range(len(shapes))]


def _shape(task: Task, index: int, rows: Beats) -> Shape:
    settings, part, steps = task.settings, task.settings.parts[index], rows.shape[1]
    where, corners = settings.limits, 0
    worst = "worst-case" in dict(settings.weights)
    if where == "box" and settings.law_degree == 1 and not isinstance(task.disturbance, DisturbanceBox):
        # on a set with corners the limits hold there; on any other, on the ellipsoid around it
        corners = steps * _corners(task, index, rows.ravel()).shape[1]
        where = "box" if corners else "ellipsoid"
    return Shape(
        states=len(part.errors),
        controls=len(part.controls),
        vertices=len(task.ground.vertices) * carried.count(task),
        carried=carried.count(task),
        means=carried.count(task) * (len(task.ground.vertices) if settings.extremes == "each" else 1),
        steps=steps,
        law_degree=settings.law_degree,
        degree=max(settings.degree, 2 * (settings.law_degree if worst else (settings.law_degree + 1) // 2)),
        weights=settings.weights,
        limits=where,
        corners=corners,
        noisy=settings.noise_weight > 0,
    )


def measurement_box(task: Task, part: Part, beats: Beats) -> Array:
    """Half-widths of the box of a part's measurement errors: ndarray (b, n)."""
    share, errors = task.settings.measurement_error, list(part.errors)
    if share == 0.0:
        return np.zeros((len(beats), len(errors)))
    widths = share * task.disturbance.half_widths
    return task.ground.coordinates.box(task.nominal.states[beats], widths)[:, errors]


def _corners(task: Task, index: int, beats: Beats) -> Array:
    """Corners of the set of a part's measured errors: ndarray (b, k, n)."""
    initial = taken(task.ground.parts[index].initial, beats)
    return initial.seen_corners(measurement_box(task, task.settings.parts[index], beats))


def _group_data(task: Task, index: int, shape: Shape, rows: Beats) -> GroupData:
    """Data of one part's programs for rows of beats (b, g)."""
    part, ground = task.settings.parts[index], task.ground
    own, beats, lead = ground.parts[index], rows.ravel(), rows.shape
    e, c = np.array(part.errors), np.array(part.controls)
    initial = taken(own.initial, beats)
    inverse = np.linalg.inv(initial.whitening)

    def whitened(moment: Array) -> Array:
        inside = inverse @ moment[beats][:, e[:, None], e] @ np.swapaxes(inverse, 1, 2)
        return np.asarray(inside.reshape(*lead, len(e), len(e)))

    points = np.einsum("bij,uj->bui", initial.whitening, law_program.nodes(shape))
    end = carried.map_values(task, index, beats, points)
    values = np.ascontiguousarray(end[..., e])
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
        growth = initial.seen_growth(measurement_box(task, part, beats)).reshape(lead)
    pushed = ground.input_map[beats][..., c] * np.repeat(usable, rows.shape[1], axis=0)[:, None, None]
    weights = np.zeros(len(points[0]))
    if shape.law_degree > 1:
        points, weights = _cubature(task, index, shape, beats)
        end = carried.map_values(task, index, beats, points)
    cost = expectation.mean_square(task, index, beats, points, end, pushed)
    unwhitening = np.linalg.inv(whitening[:, 0])
    corners = np.zeros((len(rows), 0, len(e)))
    if shape.corners:
        corners = _corners(task, index, beats).reshape(len(rows), -1, len(e))
    return GroupData(
        map_values=values.reshape(*lead, *values.shape[1:]),
        input_map=np.tile(pushed[:, :, e], (1, shape.carried, 1, 1)).reshape(*lead, -1, len(e), len(c)),
        whitening=whitening,
        metric=own.metric[rows],
        seen=seen.max(1),
        corners=corners,
        growth=(growth * turn).max(1),
        lower=np.where(usable, task.settings.saturation * lower, -span),
        upper=np.where(usable, task.settings.saturation * upper, span),
        usable=usable,
        expected=whitened(ground.expected.moment),
        least=np.full(len(rows), task.settings.least_expected),
        mean_points=points.reshape(*lead, *points.shape[1:]) @ np.swapaxes(unwhitening, 1, 2)[:, None],
        mean_weights=np.broadcast_to(weights, (len(rows), len(weights))),
        mean_size=cost.size.reshape(*lead, *cost.size.shape[1:]),
        mean_cross=cost.cross.reshape(*lead, *cost.cross.shape[1:]),
        own=cost.own.reshape(*lead, *cost.own.shape[1:]),
        noise=whitened(ground.expected.noise),
        direction=np.broadcast_to(np.eye(len(e)), whitening.shape),
        effort=ground.effort[rows][:, :, c[:, None], c],
    )


def _cubature(task: Task, index: int, shape: Shape, beats: Beats) -> tuple[Array, Array]:
    """Points (b, U, n) and weights (U,) for means over the errors to be expected, and a share of the set's."""
    e = np.array(task.settings.parts[index].errors)
    whitening = task.ground.parts[index].initial.whitening[beats]
    moment = task.ground.expected.moment[beats][:, e[:, None], e]
    even = whitening @ np.swapaxes(whitening, 1, 2) / (3.0 * shape.states)
    clouds = [monomials.cubature(covariance, shape.law_degree) for covariance in (moment, even)]
    weights = [clouds[0][1], task.settings.least_expected * clouds[1][1]]
    return np.concatenate([points for points, _ in clouds], axis=1), np.concatenate(weights)


def _solved(task: Task, shape: Shape, data: GroupData, names: list[tuple[int, Beats]], tell: Tell) -> PartLaws:
    """Solve a batch of programs, as many at a time as fit into memory."""
    structure = law_program.structure(shape)
    each = 8.0 * sum(
        sum(float(np.prod(size)) for size in c.shapes(structure.size).values()) for c in structure.constraints
    )
    count = max(2 * task.workers, int(_MEMORY / each))
    found: list[PartLaws] = []
    for start in range(0, len(names), count):
        some = np.arange(start, min(start + count, len(names)))
        found.append(_solved_together(task, shape, taken(data, some), [names[i] for i in some]))
        tell(len(some))

    def joined(name: str) -> Array:
        return np.concatenate([getattr(one, name) for one in found])

    return PartLaws(
        _NO_ROWS,
        joined("coefficients"),
        joined("feasible").astype(bool),
        joined("stopped").astype(bool),
        joined("bound"),
        joined("seconds"),
        [message for one in found for message in one.messages],
    )


def _solved_together(task: Task, shape: Shape, data: GroupData, names: list[tuple[int, Beats]]) -> PartLaws:
    structure, scaling = law_program.structure(shape), law_program.scale(data)
    seconds = np.zeros(len(names))
    rounds = _ROUNDS if "volume" in dict(shape.weights) else 1
    for turn in range(rounds):
        problem = law_program.program_data(shape, data, scaling)
        solution = sos.solve(
            structure, problem, backend=task.settings.backend, deadline=task.deadline, workers=task.workers
        )
        seconds += solution.seconds
        if turn + 1 < rounds:
            data = replace(data, direction=joint_shape.direction(shape, solution, data, scaling))
    feasible = solution.status == sos.Status.OPTIMAL
    coefficients = law_program.coefficients(shape, solution["K"], data, scaling)
    stopped = (solution.status == sos.Status.DEADLINE) & np.isfinite(coefficients).all((1, 2))
    coefficients = np.where((feasible | stopped)[:, None, None], coefficients, 0.0)
    coefficients *= (data.usable * limits.into(shape, data, scaling, solution))[:, :, None]
    return PartLaws(
        _NO_ROWS,
        coefficients,
        feasible,
        stopped,
        np.where(feasible, solution.objective * scaling.size + mean_square.constant(shape, data), np.nan),
        seconds,
        messages(task, names, solution, ~feasible & ~stopped),
    )
