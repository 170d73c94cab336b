"""What all programs of a nominal rest on: linearised map, forecast, initial ellipsoids, room of the controls.

It is made for the whole nominal at once, since what an error will cost depends on all that follows, and kept: a
design of a few beats of the same nominal, in flight, finds it done.
"""

from __future__ import annotations

import itertools
import pickle
import threading
from collections import OrderedDict
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.compensation.forecast import Forecast, forecast
from aerotube.compensation.sets import InitialEllipsoid, initial_ellipsoid
from aerotube.compensation.settings import Part, SynthesisSettings
from aerotube.dynamics import ErrorCoordinates, Linearisation, error_map, taylor_map
from aerotube.errors import InputError
from aerotube.nominal import Nominal
from aerotube.tube import (
    DisturbanceBox,
    DisturbanceSet,
    ellipsoid,
    parameter_ranges,
    riccati,
    tracking_weights,
)

Array = NDArray[np.float64]
Arrays = TypeVar("Arrays")

_KEPT = 8
_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=8)))
_made: OrderedDict[Any, tuple[Aircraft, Groundwork]] = OrderedDict()
_lock = threading.Lock()


@dataclass(frozen=True)
class Groundwork:
    """What all programs of a nominal of T beats rest on.

    Attributes
    ----------
    coordinates : ErrorCoordinates
    vertices : ndarray (k, p)
        Extreme values of the parameters.
    linear : Linearisation
        At nominal parameters.
    input_map : ndarray (T, k, 8, 4)
        Derivatives of the error map with respect to the virtual controls, at each extreme.
    effort : ndarray (T, 4, 4)
        Weights R of the virtual controls.
    expected : Forecast
    seen : ndarray (T, 8)
        Half-widths of the box of errors as the law sees them, measurement error included.
    parts : tuple of PartGround
        In the order of the settings' parts.
    """

    coordinates: ErrorCoordinates
    vertices: Array
    linear: Linearisation
    input_map: Array
    effort: Array
    expected: Forecast
    seen: Array
    parts: tuple[PartGround, ...]


@dataclass(frozen=True)
class PartGround:
    """The same of one part.

    Attributes
    ----------
    initial : InitialEllipsoid
        Of T beats.
    metric : ndarray (T, n, n)
        The metric E1 in which the error at the end of a beat is measured.
    joint_metric : ndarray (T, N, N)
        What the whole state of the forecast at the end of a beat costs, as far as the part's programs of mean squares
        look at it; E1 in the part's own errors.
    lower, upper : ndarray (T, m)
        Increments that the limits leave to the part's controls wherever they must hold.
    """

    initial: InitialEllipsoid
    metric: Array
    joint_metric: Array
    lower: Array
    upper: Array


def groundwork(
    aircraft: Aircraft, nominal: Nominal, disturbance: DisturbanceSet, settings: SynthesisSettings
) -> Groundwork:
    """Make what all programs of a nominal rest on, or find it made.

    Parameters
    ----------
    aircraft : Aircraft
        Must not change once it has been used.
    nominal : Nominal
    disturbance : DisturbanceSet
    settings : SynthesisSettings

    Returns
    -------
    Groundwork

    Raises
    ------
    InputError
        If the nominal is outside the aircraft's model or limits.
    ComputationError
        If a Riccati shape does not exist.
    """
    key = (id(aircraft), pickle.dumps((nominal, disturbance)), settings)
    with _lock:
        if key in _made:
            _made.move_to_end(key)
            return _made[key][1]
    nominal.check(aircraft)
    check_reach(aircraft, nominal.states[:-1], ErrorCoordinates(settings.attitude), disturbance, settings)
    made = _make(aircraft, nominal, disturbance, settings)
    with _lock:
        _made[key] = aircraft, made  # kept alive with it, so that its id stays its own
        while len(_made) > _KEPT:
            _made.popitem(last=False)
    return made


def _make(aircraft: Aircraft, nominal: Nominal, disturbance: DisturbanceSet, settings: SynthesisSettings) -> Groundwork:
    coordinates = ErrorCoordinates(settings.attitude)
    vertices = disturbance.parameter_vertices(aircraft)
    linear, input_map = _linearised(aircraft, nominal, coordinates, vertices)
    effort = effort_weights(aircraft, nominal, settings.control_weight)
    expected = expectations(aircraft, nominal, disturbance, settings, linear)
    seen = coordinates.box(nominal.states[:-1], (1.0 + settings.measurement_error) * disturbance.half_widths)
    parts = []
    for part, (lower, upper) in zip(
        settings.parts,
        control_room(aircraft, nominal, settings, coordinates, seen, np.arange(nominal.beats)),
        strict=True,
    ):
        metric, joint = _metrics(nominal, settings, part, linear, expected, effort)
        parts.append(
            PartGround(
                initial=initial_ellipsoid(disturbance, coordinates, nominal.states[:-1], part),
                metric=metric,
                joint_metric=joint,
                lower=lower,
                upper=upper,
            )
        )
    return Groundwork(coordinates, vertices, linear, input_map, effort, expected, seen, tuple(parts))


def control_room(
    aircraft: Aircraft,
    nominal: Nominal,
    settings: SynthesisSettings,
    coordinates: ErrorCoordinates,
    seen: Array,
    beats: NDArray[np.intp],
) -> list[tuple[Array, Array]]:
    """How far the laws of each part may move its virtual controls, on the set on which limits hold.

    Parameters
    ----------
    aircraft : Aircraft
    nominal : Nominal
    settings : SynthesisSettings
        Their parts, limits, and limits of rate.
    coordinates : ErrorCoordinates
    seen : ndarray (b, 8)
        Half-widths of the box of errors as they are measured.
    beats : ndarray (b,) of int

    Returns
    -------
    list of (ndarray (b, m), ndarray (b, m))
        Least and largest increments.
    """
    states, controls = nominal.states[beats], nominal.controls[beats]
    # halves of the same number of errors ask for the same
    room = {}
    for size in {len(part.errors) for part in settings.parts}:
        reach = seen * (np.sqrt(size) if settings.limits == "ellipsoid" else 1.0)
        lower, upper = available_increments(aircraft, states, controls, coordinates, reach)
        if settings.rate_limits is not None:
            half = _share_of_rate(aircraft, nominal, np.array(settings.rate_limits))[beats]
            lower, upper = np.maximum(lower, -half), np.minimum(upper, half)
        room[size] = lower, upper
    own = [(room[len(part.errors)], list(part.controls)) for part in settings.parts]
    return [(lower[:, controls], upper[:, controls]) for (lower, upper), controls in own]


def taken(arrays: Arrays, beats: NDArray[np.intp]) -> Arrays:
    """Some beats of a dataclass whose fields are arrays (T, ...)."""
    return replace(arrays, **{field.name: getattr(arrays, field.name)[beats] for field in fields(arrays)})  # type: ignore[type-var, arg-type]


def _linearised(
    aircraft: Aircraft, nominal: Nominal, coordinates: ErrorCoordinates, vertices: Array
) -> tuple[Linearisation, Array]:
    """Linearisation at nominal parameters, and input maps (T, k, 8, 4) at the extremes, in one expansion."""
    # An expansion costs much the same for one beat as for many, so all beats and all parameters are one batch.
    beats, sets = nominal.beats, np.concatenate([[aircraft.parameter_nominal], vertices])
    polynomial = taylor_map(
        aircraft,
        nominal,
        np.tile(np.arange(beats), len(sets)),
        coordinates,
        order=1,
        at=np.repeat(sets, beats, axis=0).T,
    )
    table = polynomial.coefficients.reshape(len(sets), beats, 8, -1)  # the constant, then the variables in order
    linear = Linearisation(A=table[0, :, :, 1:9].copy(), B=table[0, :, :, 9:13].copy(), offset=table[0, :, :, 0].copy())
    return linear, np.ascontiguousarray(np.swapaxes(table[1:, :, :, 9:13], 0, 1))


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


def expectations(
    aircraft: Aircraft,
    nominal: Nominal,
    disturbance: DisturbanceSet,
    settings: SynthesisSettings,
    linear: Linearisation,
) -> Forecast:
    """Errors and costs to be expected along the nominal.

    Parameters
    ----------
    aircraft : Aircraft
    nominal : Nominal
    disturbance : DisturbanceSet
    settings : SynthesisSettings
    linear : Linearisation
        In the settings' error coordinates.

    Returns
    -------
    Forecast
    """
    coordinates = ErrorCoordinates(settings.attitude)
    ranges = parameter_ranges(aircraft, disturbance.relative)
    uncertain = np.flatnonzero(ranges[:, 0] != ranges[:, 1])
    ends = np.repeat(np.asarray(aircraft.parameter_nominal, dtype=float)[None], 2 * len(uncertain), axis=0)
    for i, which in enumerate(uncertain):
        ends[2 * i : 2 * i + 2, which] = ranges[which]
    effects = np.zeros((nominal.beats, 0, 8))
    if len(uncertain):
        moved = error_map(
            aircraft,
            nominal,
            np.arange(nominal.beats),
            coordinates,
            np.zeros((nominal.beats, 1, 8)),
            parameters=np.broadcast_to(ends, (nominal.beats, *ends.shape)),
        )
        effects = 0.5 * (moved[:, 1::2] - moved[:, ::2])
    return forecast(
        linear,
        tracking_weights(nominal.states, coordinates),
        effort_weights(aircraft, nominal, settings.control_weight),
        coordinates.box(nominal.states[:-1], disturbance.half_widths),
        effects,
        settings.noise_weight,
        settings.least_expected,
        settings.parts,
    )


def _metrics(
    nominal: Nominal,
    settings: SynthesisSettings,
    part: Part,
    linear: Linearisation,
    expected: Forecast,
    effort: Array,
) -> tuple[Array, Array]:
    errors, controls = part.errors, part.controls
    if settings.shape == "cost-to-go":
        joint = expected.cost[1:].copy()
        if settings.coupling != "expected":
            others = [i for i in range(8) if i not in errors]
            joint[:, others] = joint[:, :, others] = 0.0
        return np.ascontiguousarray(joint[:, errors][:, :, errors]), joint
    weights = tracking_weights(nominal.states, ErrorCoordinates(settings.attitude))
    metric = riccati(
        linear.A[:, errors][:, :, errors],
        linear.B[:, errors][:, :, controls],
        weights[1:, errors][:, :, errors],
        effort[:, controls][:, :, controls],
    )
    return metric, own_alone(metric, part, expected.step.shape[1])


def own_alone(metric: Array, part: Part, size: int) -> Array:
    """A part's metric (T, n, n) as one of the whole state that looks at nothing else: ndarray (T, size, size)."""
    out = np.zeros((len(metric), size, size))
    out[:, np.array(part.errors)[:, None], np.array(part.errors)] = metric
    return out


def _share_of_rate(aircraft: Aircraft, nominal: Nominal, rates: Array) -> Array:
    """Half of what rate limits leave for the law's own change from beat to beat: ndarray (T, 4)."""
    room = np.full((nominal.beats, 4), np.inf)
    if nominal.beats > 1:
        states, controls = nominal.states[1:-1], nominal.controls
        # the limits of an increment move against the control it is added to
        change = aircraft.virtual_limits(states, controls[:-1])[0] - aircraft.virtual_limits(states, controls[1:])[0]
        left = 0.5 * (rates * nominal.dt - np.abs(change))
        room[1:], room[:-1] = left, np.minimum(room[:-1], left)
        room[1:-1] = np.minimum(left[:-1], left[1:])
    return room


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
    errors = np.concatenate([_CORNERS, np.zeros((1, 8))]) * reach[:, None]
    around = coordinates.retract_each(states, errors)
    lower, upper = aircraft.virtual_limits(around, np.broadcast_to(controls[:, None], (*around.shape[:2], 4)))
    return lower.max(1), upper.min(1)


def check_reach(
    aircraft: Aircraft,
    states: Array,
    coordinates: ErrorCoordinates,
    disturbance: DisturbanceSet,
    settings: SynthesisSettings,
) -> None:
    """Make sure that the aircraft's model has data where tubes begin.

    Looked at are the ends of the axes of the initial ellipsoids, and the corners of a disturbance box.

    Parameters
    ----------
    aircraft : Aircraft
    states : ndarray (b, n)
        Nominal states at the start of the beats.
    coordinates : ErrorCoordinates
    disturbance : DisturbanceSet
    settings : SynthesisSettings

    Raises
    ------
    InputError
        If it has none there.
    """
    ends = np.zeros((len(states), 8))
    for part in settings.parts:
        initial = initial_ellipsoid(disturbance, coordinates, states, part)
        ends[:, list(part.errors)] = ellipsoid.half_widths(initial.shape, initial.rho)
    errors = np.concatenate([np.eye(8), -np.eye(8)]) * ends[:, None]
    if isinstance(disturbance, DisturbanceBox):
        errors = np.concatenate([errors, _CORNERS * coordinates.box(states, disturbance.half_widths)[:, None]], axis=1)
    reached = coordinates.retract_each(np.ascontiguousarray(states), errors)
    outside, missing = None, np.argwhere(~aircraft.in_domain(reached))
    if len(missing):
        beat, point = missing[0]
        outside = f"at beat {beat} the {aircraft.domain_violation(reached[beat, point])}"
    # an airspeed cannot be less than nothing: such an error would turn the aircraft round
    speed = np.linalg.norm(states[:, :3], axis=1) - ends[:, 0]
    if outside is None and (speed <= 0).any():
        outside = f"at beat {int(np.argmin(speed))} the airspeed would be {speed.min():.4g} m/s"
    if outside is not None:
        raise InputError(
            f"disturbance: the errors that tubes begin with, those of the ellipsoid around the disturbances, reach too "
            f"far: {outside}; choose smaller disturbances or another nominal."
        )
