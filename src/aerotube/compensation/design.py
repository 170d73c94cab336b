"""Compensation laws for beats of a nominal trajectory (the paper's Algorithms 1 and 2)."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.aircraft.base import Aircraft
from aerotube.compensation import exact_map
from aerotube.compensation.closed_loop import end_errors
from aerotube.compensation.forecast import Forecast, forecast
from aerotube.compensation.law import LinearLaw
from aerotube.compensation.sets import initial_ellipsoid
from aerotube.compensation.settings import Part, SynthesisSettings
from aerotube.dynamics import ErrorCoordinates, Linearisation, error_map, linearise, taylor_map
from aerotube.nominal import Nominal
from aerotube.tube import DisturbanceBox, parameter_ranges, riccati, tracking_weights

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Design:
    """Compensation laws, and how their computation went.

    Attributes
    ----------
    law : LinearLaw
        Of the whole nominal; zero gain (the nominal alone) for a part of a beat that has no feasible law, and at
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
        included.
    solve_seconds : ndarray (b, parts)
        Time in the solver, of one part of one beat.
    settings : SynthesisSettings
    linearisation : Linearisation
        Of the error map along the whole nominal, in the law's coordinates.
    """

    law: LinearLaw
    beats: NDArray[np.intp]
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
    disturbance: DisturbanceBox,
    settings: SynthesisSettings | None = None,
    *,
    beats: range | None = None,
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
    disturbance : DisturbanceBox
        Errors at the start of a beat and uncertain parameters.
    settings : SynthesisSettings, optional
    beats : range, optional
        Beats to compute laws for; all by default.
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
    nominal.check(aircraft)
    coordinates = ErrorCoordinates(settings.attitude)
    chosen = np.arange(nominal.beats) if beats is None else np.asarray(beats)
    linear = linearise(aircraft, nominal, coordinates)
    task = _Task(
        aircraft=aircraft,
        nominal=nominal,
        disturbance=disturbance,
        settings=settings,
        coordinates=coordinates,
        beats=chosen,
        linear=linear,
        expected=_forecast(aircraft, nominal, disturbance, settings, coordinates, linear),
        effort=effort_weights(aircraft, nominal, settings.control_weight),
        input_map=_input_maps(aircraft, nominal, coordinates, chosen, disturbance.parameter_vertices(aircraft)),
    )
    results = []
    for index, part in enumerate(settings.parts):
        results.append(_design_part(task, part, workers, deadline))
        if progress is not None:
            progress((index + 1) * len(chosen), len(settings.parts) * len(chosen))
    gains = np.zeros((nominal.beats, 4, 8))
    for part, result in zip(settings.parts, results, strict=True):
        controls, errors = np.array(part.controls), np.array(part.errors)
        gains[chosen[:, None, None], controls[:, None], errors] = result.gains

    def gather(name: str) -> Array:
        return np.stack([getattr(result, name) for result in results], axis=1)

    return Design(
        law=LinearLaw(gains, coordinates),
        beats=chosen,
        metric=tuple(result.metric for result in results),
        feasible=gather("feasible").astype(bool),
        stopped=gather("stopped").astype(bool),
        messages=[message for result in results for message in result.messages],
        bound=gather("bound"),
        solve_seconds=gather("seconds"),
        settings=settings,
        linearisation=linear,
    )


@dataclass(frozen=True)
class _Task:
    """What all parts share; ``input_map`` is of the chosen beats, the rest of all."""

    aircraft: Aircraft
    nominal: Nominal
    disturbance: DisturbanceBox
    settings: SynthesisSettings
    coordinates: ErrorCoordinates
    beats: NDArray[np.intp]
    linear: Linearisation
    expected: Forecast
    effort: Array
    input_map: Array


@dataclass(frozen=True)
class _PartDesign:
    gains: Array
    metric: Array
    feasible: NDArray[np.bool_]
    stopped: NDArray[np.bool_]
    messages: list[str]
    bound: Array
    seconds: Array


def effort_weights(aircraft: Aircraft, nominal: Nominal, control_weight: float) -> Array:
    """Weights R of the virtual controls: ``control_weight / half range^2`` on the diagonal.

    The half range is that of the increments available along the nominal, so that it has the units of the
    virtual control.

    Returns
    -------
    ndarray (T, 4, 4)
    """
    lower, upper = aircraft.virtual_limits(nominal.states[:-1], nominal.controls)
    half_range = 0.5 * (upper - lower)
    out = np.zeros((nominal.beats, 4, 4))
    out[:, np.arange(4), np.arange(4)] = control_weight / half_range**2
    return out


def _forecast(
    aircraft: Aircraft,
    nominal: Nominal,
    disturbance: DisturbanceBox,
    settings: SynthesisSettings,
    coordinates: ErrorCoordinates,
    linear: Linearisation,
) -> Forecast:
    """Errors and costs to be expected along the nominal."""
    ranges = parameter_ranges(aircraft, disturbance.relative)
    ends = np.repeat(np.asarray(aircraft.parameter_nominal, dtype=float)[None], 2 * len(ranges), axis=0)
    for i, (low, high) in enumerate(ranges):
        ends[2 * i : 2 * i + 2, i] = low, high
    moved = error_map(
        aircraft,
        nominal,
        np.arange(nominal.beats),
        coordinates,
        np.zeros((nominal.beats, 1, 8)),
        parameters=np.broadcast_to(ends, (nominal.beats, *ends.shape)),
    )
    return forecast(
        linear,
        tracking_weights(nominal.states, coordinates),
        effort_weights(aircraft, nominal, settings.control_weight),
        coordinates.box(nominal.states[:-1], disturbance.half_widths),
        0.5 * (moved[:, 1::2] - moved[:, ::2]),
        settings.noise_weight,
        settings.parts,
    )


def _input_maps(
    aircraft: Aircraft, nominal: Nominal, coordinates: ErrorCoordinates, beats: NDArray[np.intp], vertices: Array
) -> Array:
    """Derivatives with respect to the virtual controls, at each extreme parameter value: ndarray (b, k, 8, 4)."""
    # The expansion costs the same for one beat as for many, so all are one batch; errors are no variables of it.
    polynomial = taylor_map(
        aircraft,
        nominal,
        np.repeat(beats, len(vertices)),
        coordinates,
        order=1,
        errors=(),
        at=np.tile(vertices, (len(beats), 1)).T,
    )
    first = [int(np.flatnonzero(row)[0]) if row.any() else -1 for row in polynomial.space.exponents]
    columns = [first.index(i) for i in range(4)]
    return polynomial.coefficients[:, :, columns].reshape(len(beats), len(vertices), 8, 4)


def _metric(task: _Task, part: Part) -> Array:
    """The metric E1 of the chosen beats, for one part: ndarray (b, n, n)."""
    errors, controls, beats = part.errors, part.controls, task.beats
    if task.settings.shape == "cost-to-go":
        return np.asarray(task.expected.cost[beats + 1][:, errors][:, :, errors])
    return riccati(
        task.linear.A[beats][:, errors][:, :, errors],
        task.linear.B[beats][:, errors][:, :, controls],
        tracking_weights(task.nominal.states, task.coordinates)[beats + 1][:, errors][:, :, errors],
        task.effort[beats][:, controls][:, :, controls],
    )


def _design_part(task: _Task, part: Part, workers: int, deadline: float | None) -> _PartDesign:
    settings, beats, n = task.settings, task.beats, len(part.errors)
    states = task.nominal.states[beats]
    initial = initial_ellipsoid(task.disturbance, task.coordinates, states, part)
    vertices = task.disturbance.parameter_vertices(task.aircraft)
    structure = exact_map.structure(
        n, len(part.controls), len(vertices), settings.degree, settings.size, settings.limits
    )
    points = np.einsum("bij,uj->bui", initial.whitening, structure.nodes("tube/0"))
    seen = task.coordinates.box(states, (1.0 + settings.measurement_error) * task.disturbance.half_widths)
    reach = seen * (np.sqrt(n) if settings.limits == "ellipsoid" else 1.0)
    lower, upper = available_increments(task.aircraft, states, task.nominal.controls[beats], task.coordinates, reach)
    limit = np.minimum(-lower, upper)[:, part.controls]
    span = (upper - lower)[:, part.controls]
    usable = limit > 1e-6 * span
    data = exact_map.BeatData(
        map_values=end_errors(task.aircraft, task.nominal, beats, task.coordinates, part, points, vertices),
        input_map=task.input_map[:, :, part.errors][..., part.controls] * usable[:, None, None, :],
        whitening=initial.whitening,
        shape=_metric(task, part),
        seen=seen[:, part.errors],
        growth=(seen[:, part.errors] / initial.widths).max(-1),
        limit=np.where(usable, limit, span),
        expected=_whitened(task.expected.moment[beats], part, initial.whitening, settings.least_expected),
        noise=_whitened(task.expected.noise[beats], part, initial.whitening, 0.0),
        control_weight=task.effort[beats][:, part.controls][:, :, part.controls],
    )
    scaling = exact_map.scale(data)
    problem = exact_map.program_data(structure, data, scaling, settings.size, settings.limits)
    solution = sos.solve(structure, problem, backend=settings.backend, deadline=deadline, workers=workers)
    feasible = solution.status == sos.Status.OPTIMAL
    gains = exact_map.gains(solution["K"], data, scaling)
    stopped = (solution.status == sos.Status.DEADLINE) & np.isfinite(gains).all((1, 2))
    gains = np.where((feasible | stopped)[:, None, None], gains, 0.0)
    gains *= usable[:, :, None]
    gains *= _into_limits(gains, data, settings.limits)[:, :, None]
    messages = [
        f"beat {beats[i]}, {part.name}: no law ({sos.Status(solution.status[i]).name.lower().replace('_', ' ')}); "
        "the nominal alone is flown."
        for i in np.flatnonzero(~feasible & ~stopped)
    ]
    return _PartDesign(
        gains=gains,
        metric=data.shape,
        feasible=feasible,
        stopped=stopped,
        messages=messages,
        bound=np.where(feasible, solution.objective * scaling.size, np.nan),
        seconds=solution.seconds,
    )


def available_increments(
    aircraft: Aircraft, states: Array, controls: Array, coordinates: ErrorCoordinates, reach: Array
) -> tuple[Array, Array]:
    """Least increments of the virtual controls that are available at the nominal and the corners of a box around it.

    Parameters
    ----------
    aircraft : Aircraft
    states : ndarray (b, 13)
        Nominal states.
    controls : ndarray (b, 4)
        Nominal controls.
    coordinates : ErrorCoordinates
    reach : ndarray (b, 8)
        Half-widths of the box, in these coordinates.

    Returns
    -------
    lower, upper : ndarray (b, 4)
    """
    corners = np.array([*itertools.product((-1.0, 1.0), repeat=8), (0.0,) * 8])
    around = coordinates.retract(states[:, None], corners * reach[:, None])
    lower, upper = aircraft.virtual_limits(around, np.broadcast_to(controls[:, None], (*around.shape[:2], 4)))
    return lower.max(1), upper.min(1)


def _whitened(moment: Array, part: Part, whitening: Array, least: float) -> Array:
    """Second moments of a part's errors in whitened coordinates, with a floor: ndarray (b, n, n)."""
    inverse = np.linalg.inv(whitening)
    own = inverse @ moment[:, part.errors][:, :, part.errors] @ np.swapaxes(inverse, 1, 2)
    return np.asarray(own + least / len(part.errors) * np.eye(len(part.errors)))


def _into_limits(gains: Array, data: exact_map.BeatData, limits: str) -> Array:
    """Factors, at most one, that take out what the solver's tolerance left beyond the limits: ndarray (b, m)."""
    if limits == "box":
        most = np.sum(np.abs(gains) * data.seen[:, None, :], axis=-1)
    else:
        most = data.growth[:, None] * np.linalg.norm(gains @ data.whitening, axis=-1)
    return np.asarray(data.limit / np.maximum(most, data.limit))
