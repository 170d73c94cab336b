"""Laws from the increment form, the paper's own; see :mod:`aerotube.compensation.increment`."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.compensation import increment, limits, monomials
from aerotube.compensation.groundwork import taken
from aerotube.compensation.increment import IncrementData, Shape
from aerotube.compensation.sets import initial_ellipsoid
from aerotube.compensation.task import PartLaws, Task, Tell, messages
from aerotube.compensation.terminal import Terminal
from aerotube.tube import parameter_ranges, riccati, tracking_weights

Array = NDArray[np.float64]
Beats = NDArray[np.intp]


@dataclass(frozen=True)
class _Frame:
    """How whitened quantities of a part relate to physical ones: ``x = T z``, and controls over half their range."""

    whitening: Array
    rho: Array
    span: Array


@dataclass(frozen=True)
class _Found:
    """Answers of a batch: laws (b, m, M), sizes and shapes in whitened errors."""

    K: Array
    rho: Array
    E: Array
    feasible: NDArray[np.bool_]
    stopped: NDArray[np.bool_]
    seconds: Array
    terminal_seconds: Array


def design_increments(task: Task, rows: Beats, tell: Tell) -> list[PartLaws]:
    """Laws of all parts for rows of one beat (b, 1); parts of the same kind are solved together.

    In two steps the terminal shape is found together with the law. In three it is held at its Riccati start while the
    law is found, and then, law and rho held, the volume is made as small as it can be above that start: for least rho
    alone the start itself is optimal. (The multipliers are free in both steps; the paper holds those of the second.)
    """
    settings, beats = task.settings, rows[:, 0]
    ranges = parameter_ranges(task.aircraft, task.disturbance.relative)
    uncertain = int((ranges[:, 0] != ranges[:, 1]).sum())
    shapes = [
        Shape(len(part.errors), len(part.controls), uncertain, settings.law_degree, settings.steps == "two-step")
        for part in settings.parts
    ]
    made = [_data(task, index, beats, ranges) for index in range(len(shapes))]
    out: dict[int, PartLaws] = {}
    for shape in dict.fromkeys(shapes):
        own = [index for index, other in enumerate(shapes) if other == shape]
        data = IncrementData(
            *(np.concatenate([getattr(made[i][0], field.name) for i in own]) for field in fields(IncrementData))
        )
        found, sentences = _solved(task, shape, data, [(index, row) for index in own for row in rows])
        for position, index in enumerate(own):
            at = np.arange(position * len(rows), (position + 1) * len(rows))
            out[index] = _physical(shape, rows, taken(found, at), made[index][1], sentences if position == 0 else [])
        tell(len(own) * len(rows))
    return [out[index] for index in range(len(shapes))]


def _data(task: Task, index: int, beats: Beats, ranges: Array) -> tuple[IncrementData, _Frame]:
    part, ground, nominal = task.settings.parts[index], task.ground, task.nominal
    e, c = np.array(part.errors), np.array(part.controls)
    weights = tracking_weights(nominal.states, ground.coordinates)[1:]
    which = np.unique(np.concatenate([beats, np.minimum(beats + 1, nominal.beats - 1)]))
    start = riccati(
        ground.linear.A[which][:, e[:, None], e],
        ground.linear.B[which][:, e[:, None], c],
        weights[which][:, e[:, None], e],
        ground.effort[which][:, c[:, None], c],
    )
    shape = start[np.searchsorted(which, beats)]
    terminal = start[np.searchsorted(which, np.minimum(beats + 1, nominal.beats - 1))]
    states = nominal.states[beats]
    initial = initial_ellipsoid(task.disturbance, ground.coordinates, states, part, shape)
    lower, upper = ground.parts[index].lower[beats], ground.parts[index].upper[beats]
    span = 0.5 * (upper - lower)
    T, rho = initial.whitening, initial.rho
    data = IncrementData(
        increment=increment.sampled(task.aircraft, nominal, beats, ground.coordinates, part, ranges, T),
        input_map=np.asarray(np.linalg.solve(T, ground.linear.B[beats][:, e[:, None], c] * span[:, None]), dtype=float),
        terminal=np.swapaxes(T, 1, 2) @ terminal @ T / rho[:, None, None],
        room_below=np.maximum(-lower / span, 0.0),
        room_above=np.maximum(upper / span, 0.0),
    )
    return data, _Frame(T, rho, span)


def _solved(task: Task, shape: Shape, data: IncrementData, names: list[tuple[int, Beats]]) -> tuple[_Found, list[str]]:
    options: dict[str, Any] = {"backend": task.settings.backend, "deadline": task.deadline, "workers": task.workers}
    solution = sos.solve(increment.structure(shape), increment.program_data(shape, data), **options)
    feasible = solution.status == sos.Status.OPTIMAL
    K, rho = solution["K"], solution["rho"]
    stopped = (solution.status == sos.Status.DEADLINE) & np.isfinite(K).all((1, 2))
    there = (feasible | stopped)[:, None, None]
    K = np.where(there, K * limits.proven(solution, -data.room_below, data.room_above)[:, :, None], 0.0)
    seconds = np.zeros(len(names))
    if shape.free:
        E = solution["E"]
    else:
        held = np.where(there[:, 0, 0], rho * (1.0 + 1e-6), 10.0)
        last = sos.solve(increment.terminal_structure(shape), increment.terminal_data(shape, data, K, held), **options)
        better = (last.status == sos.Status.OPTIMAL)[:, None, None]
        E, rho, seconds = np.where(better, last["E"], data.terminal), held, last.seconds
    found = _Found(
        K=K,
        rho=np.where(there[:, 0, 0], rho, np.nan),
        E=np.where(there, E, np.nan),
        feasible=feasible,
        stopped=stopped,
        seconds=solution.seconds,
        terminal_seconds=seconds,
    )
    return found, messages(task, names, solution, ~feasible & ~stopped)


def _physical(shape: Shape, rows: Beats, found: _Found, frame: _Frame, sentences: list[str]) -> PartLaws:
    unwhitening = np.asarray(np.linalg.inv(frame.whitening), dtype=np.float64)
    # rho0 units: z'E z <= rho is x' T^-T E T^-1 x rho0 <= rho rho0
    E = np.swapaxes(unwhitening, 1, 2) @ found.E @ unwhitening * frame.rho[:, None, None]
    return PartLaws(
        rows=rows,
        coefficients=monomials.substituted(found.K * frame.span[:, :, None], unwhitening, shape.law_degree),
        feasible=found.feasible,
        stopped=found.stopped,
        bound=np.where(found.feasible, found.rho * frame.rho, np.nan),
        seconds=found.seconds,
        messages=sentences,
        terminal=Terminal(E, found.rho * frame.rho, found.terminal_seconds),
    )
