"""Compensation laws and tubes for every beat of a nominal trajectory (the paper's Algorithms 1 and 2)."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.aircraft.base import Aircraft
from aerotube.compensation import exact_map
from aerotube.compensation.forecast import Forecast, forecast
from aerotube.compensation.law import LinearLaw
from aerotube.compensation.settings import Part, SynthesisSettings
from aerotube.compensation.tubes import Tubes, measure
from aerotube.dynamics import ErrorCoordinates, Linearisation, error_map, linearise
from aerotube.nominal import Nominal
from aerotube.tube import DisturbanceBox, ellipsoid, parameter_ranges, riccati, tracking_weights

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Compensation:
    """Laws, tubes, and how their computation went.

    Attributes
    ----------
    law : LinearLaw
        Zero gain (the nominal alone) for a part of a beat that has no feasible law.
    tubes : Tubes
    feasible : ndarray (T, parts) of bool
    messages : list of str
        One sentence for each failure.
    bound : ndarray (T, parts)
        The optimal value of each program, as the solver reports it: the majorant that was minimised, effort
        included. The certified sizes are those of the tubes.
    solve_seconds : ndarray (T, parts)
        Time in the solver, of one part of one beat.
    settings : SynthesisSettings
    linearisation : Linearisation
        Of the error map along the nominal, in the law's coordinates.
    evidence : tuple of sos.Certificate
        Of ``tubes.size``, one for each part with the beats as its batch; can be saved and checked offline.
    """

    law: LinearLaw
    tubes: Tubes
    feasible: NDArray[np.bool_]
    messages: list[str]
    bound: Array
    solve_seconds: Array
    settings: SynthesisSettings
    linearisation: Linearisation
    evidence: tuple[sos.Certificate, ...]


def synthesise(
    aircraft: Aircraft,
    nominal: Nominal,
    disturbance: DisturbanceBox,
    settings: SynthesisSettings | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> Compensation:
    """Compute compensation laws and tubes for all beats of a nominal trajectory.

    Parameters
    ----------
    aircraft : Aircraft
        Whose step map, sampled at nodes, the programs hold.
    nominal : Nominal
    disturbance : DisturbanceBox
        Errors at the start of a beat and uncertain parameters.
    settings : SynthesisSettings, optional
    workers : int
        Threads that solve; the numbers do not depend on it.
    progress : callable, optional
        Called with the number of programs solved and their total.

    Returns
    -------
    Compensation

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
    linear = linearise(aircraft, nominal, coordinates)
    expected = _forecast(aircraft, nominal, disturbance, settings, coordinates, linear)
    results = []
    for index, part in enumerate(settings.parts):
        tick = None
        if progress is not None:
            total = nominal.beats * len(settings.parts)
            tick = _offset(progress, index * nominal.beats, total)
        results.append(
            _synthesise_part(
                aircraft, nominal, disturbance, settings, coordinates, linear, expected, part, workers, tick
            )
        )
    gains = np.zeros((nominal.beats, 4, 8))
    for part, result in zip(settings.parts, results, strict=True):
        gains[np.ix_(range(nominal.beats), part.controls, part.errors)] = result.gains

    def gather(name: str) -> Array:
        return np.stack([getattr(result, name) for result in results], axis=1)

    tubes = {name: np.stack([result.tubes[name] for result in results], axis=1) for name in results[0].tubes}
    return Compensation(
        law=LinearLaw(gains, coordinates),
        tubes=Tubes(settings.parts, **tubes, certificate="polynomial only"),
        feasible=gather("feasible").astype(bool),
        messages=[message for result in results for message in result.messages],
        bound=gather("bound"),
        solve_seconds=gather("seconds"),
        settings=settings,
        linearisation=linear,
        evidence=tuple(result.evidence for result in results),
    )


@dataclass(frozen=True)
class _PartResult:
    gains: Array
    tubes: dict[str, Array]
    evidence: sos.Certificate
    feasible: NDArray[np.bool_]
    messages: list[str]
    bound: Array
    seconds: Array


def _offset(progress: Progress, start: int, total: int) -> Progress:
    return lambda done, _: progress(start + done, total)


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


def _metric(
    nominal: Nominal,
    settings: SynthesisSettings,
    coordinates: ErrorCoordinates,
    linear: Linearisation,
    expected: Forecast,
    effort: Array,
    part: Part,
) -> Array:
    """The metric E1 of every beat, for one part: ndarray (T, n, n)."""
    errors, controls = part.errors, part.controls
    if settings.shape == "cost-to-go":
        return expected.cost[1:, errors][:, :, errors]
    return riccati(
        linear.A[:, errors][:, :, errors],
        linear.B[:, errors][:, :, controls],
        tracking_weights(nominal.states, coordinates)[1:, errors][:, :, errors],
        effort[:, controls][:, :, controls],
    )


def _synthesise_part(
    aircraft: Aircraft,
    nominal: Nominal,
    disturbance: DisturbanceBox,
    settings: SynthesisSettings,
    coordinates: ErrorCoordinates,
    linear: Linearisation,
    expected: Forecast,
    part: Part,
    workers: int,
    progress: Progress | None,
) -> _PartResult:
    beats, n, m = nominal.beats, len(part.errors), len(part.controls)
    widths = coordinates.box(nominal.states[:-1], disturbance.half_widths)[:, part.errors]
    initial_shape, initial_rho = ellipsoid.least_volume_around_box(widths)
    whitening = ellipsoid.whitening(initial_shape, initial_rho)
    vertices = disturbance.parameter_vertices(aircraft)
    structure = exact_map.structure(n, m, len(vertices), settings.degree, settings.size, settings.limits)
    nodes = structure.nodes("tube/0")
    effort = effort_weights(aircraft, nominal, settings.control_weight)
    seen = coordinates.box(nominal.states[:-1], (1.0 + settings.measurement_error) * disturbance.half_widths)
    growth = (seen[:, part.errors] / widths).max(-1)
    reach = seen * (np.sqrt(n) if settings.limits == "ellipsoid" else 1.0)
    lower, upper = _available(aircraft, nominal, coordinates, reach)
    limit = np.minimum(-lower, upper)[:, part.controls]
    span = (upper - lower)[:, part.controls]
    usable = limit > 1e-6 * span
    input_map = np.stack([linearise(aircraft, nominal, coordinates, vertex).B for vertex in vertices], axis=1)
    input_map = input_map[:, :, part.errors][..., part.controls] * usable[:, None, None, :]
    sample = partial(_sample, aircraft, nominal, coordinates, part, nodes, whitening, vertices)
    data = exact_map.BeatData(
        map_values=sample(),
        input_map=input_map,
        whitening=whitening,
        shape=_metric(nominal, settings, coordinates, linear, expected, effort, part),
        seen=seen[:, part.errors],
        growth=growth,
        limit=np.where(usable, limit, span),
        expected=_whitened(expected.moment[:-1], part, whitening, settings.least_expected),
        noise=_whitened(expected.noise, part, whitening, 0.0),
        control_weight=effort[:, part.controls][:, :, part.controls],
    )
    scaling = exact_map.scale(data)
    problem = exact_map.program_data(structure, data, scaling, settings.size, settings.limits)
    solution = sos.solve(structure, problem, backend=settings.backend, workers=workers)
    feasible = solution.status == sos.Status.OPTIMAL
    gains = np.where(feasible[:, None, None], exact_map.gains(solution["K"], data, scaling), 0.0)
    gains *= usable[:, :, None]
    gains *= _into_limits(gains, data, settings.limits)[:, :, None]
    messages = [
        f"beat {beat}, {part.name}: no law ({sos.Status(solution.status[beat]).name.lower().replace('_', ' ')}); "
        "the nominal alone is flown."
        for beat in np.flatnonzero(~feasible)
    ]
    if progress is not None:
        progress(beats, beats)
    tubes, evidence = measure(sample(gains), data.map_values, data.shape, settings, workers)
    return _PartResult(
        gains=gains,
        tubes={"initial_shape": initial_shape, "initial_rho": initial_rho} | tubes,
        evidence=evidence,
        feasible=feasible,
        messages=messages,
        bound=np.where(feasible, solution.objective * scaling.size, np.nan),
        seconds=solution.seconds,
    )


def _available(
    aircraft: Aircraft, nominal: Nominal, coordinates: ErrorCoordinates, reach: Array
) -> tuple[Array, Array]:
    """Least increments of the virtual controls that are available at the nominal and the corners of a box around it.

    Returns
    -------
    lower, upper : ndarray (T, 4)
    """
    corners = np.array([*itertools.product((-1.0, 1.0), repeat=8), (0.0,) * 8])
    states = coordinates.retract(nominal.states[:-1, None], corners * reach[:, None])
    controls = np.broadcast_to(nominal.controls[:, None], (*states.shape[:2], 4))
    lower, upper = aircraft.virtual_limits(states, controls)
    return lower.max(1), upper.min(1)


def _whitened(moment: Array, part: Part, whitening: Array, least: float) -> Array:
    """Second moments of a part's errors in whitened coordinates, with a floor: ndarray (T, n, n)."""
    inverse = np.linalg.inv(whitening)
    own = inverse @ moment[:, part.errors][:, :, part.errors] @ np.swapaxes(inverse, 1, 2)
    return np.asarray(own + least / len(part.errors) * np.eye(len(part.errors)))


def _sample(
    aircraft: Aircraft,
    nominal: Nominal,
    coordinates: ErrorCoordinates,
    part: Part,
    nodes: Array,
    whitening: Array,
    vertices: Array,
    gains: Array | None = None,
) -> Array:
    """The error map at the nodes, law included if one is given, other parts' errors zero: ndarray (T, k, U, n)."""
    start = np.einsum("bij,uj->bui", whitening, nodes)[:, None]
    error = np.zeros((nominal.beats, 1, len(nodes), 8))
    error[..., part.errors] = start
    increment = None
    if gains is not None:
        increment = np.zeros((nominal.beats, 1, len(nodes), 4))
        increment[..., part.controls] = np.einsum("bmj,bkuj->bkum", gains, start)
    end = error_map(
        aircraft,
        nominal,
        np.arange(nominal.beats),
        coordinates,
        error,
        increment=increment,
        parameters=np.broadcast_to(vertices[None, :, None, :], (nominal.beats, len(vertices), 1, vertices.shape[1])),
    )
    return np.ascontiguousarray(end[..., part.errors])


def _into_limits(gains: Array, data: exact_map.BeatData, limits: str) -> Array:
    """Factors, at most one, that take out what the solver's tolerance left beyond the limits: ndarray (b, m)."""
    if limits == "box":
        most = np.sum(np.abs(gains) * data.seen[:, None, :], axis=-1)
    else:
        most = data.growth[:, None] * np.linalg.norm(gains @ data.whitening, axis=-1)
    return np.asarray(data.limit / np.maximum(most, data.limit))
