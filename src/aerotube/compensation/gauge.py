"""The tube at any moment, as a gauge: what disturbances do to a flight condition, and how much of it a law takes back.

A planner that ranks manoeuvres by robustness asks this of many moments of many candidates. So a reading needs nothing
but the condition itself: one beat, the controls held, in the metric of the stationary regulator there (Eq. 8), against
errors spread over the disturbance set; and conditions that are asked for together are computed together. What is
compiled, and the structures of the programs, are kept between calls: on one core a reading of sizes then took 16 ms
alone and 6 ms each among ten, with ellipsoids 28 and 13 ms, of which solving is 8.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.compensation.design import Design, design
from aerotube.compensation.forecast import Forecast
from aerotube.compensation.groundwork import (
    Groundwork,
    PartGround,
    check_reach,
    control_room,
    effort_weights,
    own_alone,
    taken,
)
from aerotube.compensation.sets import initial_ellipsoid
from aerotube.compensation.settings import SynthesisSettings
from aerotube.compensation.tubes import Tubes, certified_size, measure
from aerotube.dynamics import ErrorCoordinates, Linearisation, slopes, step
from aerotube.errors import InputError
from aerotube.nominal import Nominal
from aerotube.tube import DisturbanceSet, ellipsoid, riccati, tracking_weights

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Reading:
    """The tubes of conditions; the leading axes are those of the states that were asked for.

    Attributes
    ----------
    parts : tuple of str
        What the eight errors are split into.
    size, size_nominal : ndarray (..., parts)
        Bound of the size, in the metric of the synthesis, of the error at the end of the beat, with the law and
        without; NaN where there is none. The metric is the same for both, so that their ratio says what the law is
        worth; it differs between conditions, so that conditions are best ranked by half-widths or by the ratio.
    half_widths, half_widths_nominal, half_widths_initial : ndarray (..., 8)
        Of the boxes around the terminal ellipsoids with the law and without it, and around the initial one, SI, in
        the law's error coordinates ``[V, alpha, q, theta, beta, p, r, phi]``. NaN where they were not asked for.
    certificate : ndarray (..., parts) of str
        What stands behind the numbers with the law, see :class:`~aerotube.compensation.Tubes`.
    gains : ndarray (..., 4, 8)
        Of the law, from SI errors to increments of the virtual controls (of a polynomial law: its linear part).
    feasible : ndarray (..., parts) of bool
        Whether there is a law; the nominal controls alone are gauged where there is none.
    messages : tuple of str
        One sentence for each thing that failed.
    tubes : Tubes, optional
        All there is to know, conditions in one axis, where ellipsoids were asked for.
    """

    parts: tuple[str, ...]
    size: Array
    size_nominal: Array
    half_widths: Array
    half_widths_nominal: Array
    half_widths_initial: Array
    certificate: NDArray[np.str_]
    gains: Array
    feasible: NDArray[np.bool_]
    messages: tuple[str, ...]
    tubes: Tubes | None = None

    @property
    def ratio(self) -> Array:
        """Size with the law over that without it: ndarray (..., parts)."""
        return np.asarray(self.size / self.size_nominal)


def gauge(
    aircraft: Aircraft,
    state: ArrayLike,
    control: ArrayLike,
    disturbance: DisturbanceSet,
    settings: SynthesisSettings | None = None,
    *,
    dt: float = 0.05,
    ellipsoids: bool = True,
    workers: int = 1,
) -> Reading:
    """Read the tubes at flight conditions.

    Parameters
    ----------
    aircraft : Aircraft
    state : array (..., 13)
        Full states at the start of the beat, SI; :func:`~aerotube.aircraft.trim`, a planner, or
        :func:`~aerotube.preparation.full_state` makes them. Many at once take far less time than one by one.
    control : array (..., 4)
        Nominal controls, held over the beat.
    disturbance : DisturbanceSet
        Errors at the start of the beat, and what is uncertain in the model.
    settings : SynthesisSettings, optional
        Of shape "riccati". By default tubes are certified for the polynomial only, which is fastest.
    dt : float
        Length of the beat, s.
    ellipsoids : bool
        Find the terminal ellipsoids too; sizes alone take less time.
    workers : int
        Threads that solve.

    Returns
    -------
    Reading

    Raises
    ------
    InputError
        If a condition, or what disturbances make of it, is outside the aircraft's model or control limits, an array
        does not fit, or the settings look beyond the beat: another shape, reuse, or limits of rate.
    """
    n = len(aircraft.state_names)
    states, controls = np.asarray(state, dtype=float), np.asarray(control, dtype=float)
    if states.shape[-1:] != (n,) or controls.shape[-1:] != (4,):
        raise InputError(
            f"gauge: states of shape {states.shape} and controls of shape {controls.shape} were given; their last "
            f"axes must be {n} and 4."
        )
    lead = np.broadcast_shapes(states.shape[:-1], controls.shape[:-1])
    if settings is None:
        settings = SynthesisSettings(shape="riccati", certificate="polynomial only")
    if settings.shape != "riccati" or settings.reuse or settings.rate_limits is not None:
        raise InputError(
            "gauge: a condition by itself has no beats that follow; use the shape 'riccati' without reuse and limits "
            "of rate, or gauge a beat of a nominal trajectory."
        )
    nominal = _side_by_side(
        aircraft, np.broadcast_to(states, (*lead, n)).reshape(-1, n), np.broadcast_to(controls, (*lead, 4)), dt
    )
    found = _read(
        aircraft,
        nominal,
        range(0, nominal.beats, 2),
        disturbance,
        settings,
        _local_ground(aircraft, nominal, disturbance, settings),
        ellipsoids,
        workers,
    )
    return _shaped(found, lead)


def gauge_beat(
    aircraft: Aircraft,
    nominal: Nominal,
    beat: int,
    disturbance: DisturbanceSet,
    settings: SynthesisSettings | None = None,
    *,
    ellipsoids: bool = True,
    workers: int = 1,
) -> Reading:
    """Read the tube at a beat of a nominal trajectory: that of the synthesis, which knows what follows.

    See :func:`gauge` for the other parameters; any settings will do.

    Returns
    -------
    Reading
        Without leading axes.

    Raises
    ------
    InputError
        If the nominal has no such beat, or is outside the aircraft's model or limits.
    """
    if not 0 <= beat < nominal.beats:
        raise InputError(f"gauge: the nominal has the beats 0 to {nominal.beats - 1}; {beat} is none of them.")
    settings = settings or SynthesisSettings(certificate="polynomial only")
    beats = range(beat, beat + 1)
    return _shaped(_read(aircraft, nominal, beats, disturbance, settings, None, ellipsoids, workers), ())


def _side_by_side(aircraft: Aircraft, states: Array, controls: Array, dt: float) -> Nominal:
    """One nominal of which every other beat, from the first, is a condition; what joins them is of no meaning."""
    held = controls.reshape(-1, 4)
    inside = aircraft.in_domain(states)
    if not inside.all():
        index = int(np.argmin(inside))
        which = f"condition {index}" if len(states) > 1 else "the condition"
        reason = aircraft.domain_violation(states[index])
        raise InputError(f"gauge: {which} is outside the aircraft's model ({reason}); choose another.")
    both = np.stack([states, step(aircraft, states, held, dt)], axis=1).reshape(-1, states.shape[-1])
    nominal = Nominal(dt, both, np.repeat(held, 2, axis=0)[:-1], "gauge")
    nominal.check(aircraft)
    return nominal


def _local_ground(
    aircraft: Aircraft, nominal: Nominal, disturbance: DisturbanceSet, settings: SynthesisSettings
) -> Groundwork:
    """What the programs rest on, from each condition alone."""
    coordinates, vertices = ErrorCoordinates(settings.attitude), disturbance.parameter_vertices(aircraft)
    beats = np.arange(0, nominal.beats, 2)
    starts, count = nominal.states[beats], len(beats)
    check_reach(aircraft, starts, coordinates, disturbance, settings)
    own = np.arange(nominal.beats) // 2  # a beat that joins two conditions gets what the first of them has

    sets = np.concatenate([[aircraft.parameter_nominal], vertices])
    # the condition as it is, and at each extreme of the parameters
    found = slopes(aircraft, nominal, np.tile(beats, len(sets)), coordinates, np.repeat(sets, count, axis=0))
    A, B, offset = (each.reshape(len(sets), count, *each.shape[1:]) for each in (found.A, found.B, found.offset))
    input_map = np.ascontiguousarray(np.swapaxes(B[1:], 0, 1)[own])
    A, B, offset = A[0], B[0], offset[0]
    effort = effort_weights(aircraft, nominal, settings.control_weight)[beats]
    weights = tracking_weights(nominal.states[beats + 1], coordinates)
    seen = coordinates.box(starts, (1.0 + settings.measurement_error) * disturbance.half_widths)
    parts = []
    rooms = control_room(aircraft, nominal, settings, coordinates, seen, beats)
    for part, (lower, upper) in zip(settings.parts, rooms, strict=True):
        e, c = np.array(part.errors), np.array(part.controls)
        metric = riccati(A[:, e[:, None], e], B[:, e[:, None], c], weights[:, e[:, None], e], effort[:, c[:, None], c])
        initial = initial_ellipsoid(disturbance, coordinates, starts, part)
        joint = own_alone(metric[own], part, 8)
        parts.append(PartGround(taken(initial, own), metric[own], joint, lower[own], upper[own]))
    moment = np.zeros((count, 8, 8))
    moment[:, np.arange(8), np.arange(8)] = coordinates.box(starts, disturbance.half_widths) ** 2 / 3.0
    return Groundwork(
        coordinates=coordinates,
        vertices=vertices,
        linear=Linearisation(A=A[own], B=B[own], offset=offset[own]),
        input_map=input_map,
        effort=effort[own],
        expected=Forecast(
            cost=np.zeros((nominal.beats + 1, 8, 8)),  # no beat follows that an error could cost
            moment=moment[own],
            noise=settings.noise_weight * moment[own],
            step=A[own],
            gain=np.zeros((nominal.beats, 4, 8)),
        ),
        seen=seen[own],
        parts=tuple(parts),
    )


def _read(
    aircraft: Aircraft,
    nominal: Nominal,
    beats: range,
    disturbance: DisturbanceSet,
    settings: SynthesisSettings,
    ground: Groundwork | None,
    ellipsoids: bool,
    workers: int,
) -> Reading:
    """Reading of some beats, in one axis."""
    made = design(aircraft, nominal, disturbance, settings, beats=beats, workers=workers, ground=ground)
    tubes = None
    if ellipsoids:
        tubes, _ = measure(
            aircraft, nominal, disturbance, made.law, made.metric, settings, beats=beats, workers=workers
        )
        sizes, kinds = (tubes.size, tubes.size_nominal), tubes.certificate
    else:
        with_law, without = (
            certified_size(aircraft, nominal, disturbance, law, made.metric, settings, beats=beats, workers=workers)
            for law in (made.law, None)
        )
        sizes, kinds = (with_law, without), np.where(np.isfinite(with_law), "polynomial only", "none")
    return Reading(
        parts=tuple(part.name for part in settings.parts),
        size=sizes[0],
        size_nominal=sizes[1],
        half_widths=_half_widths(made, tubes, "terminal"),
        half_widths_nominal=_half_widths(made, tubes, "nominal"),
        half_widths_initial=_half_widths(made, tubes, "initial"),
        certificate=kinds,
        gains=made.law.gains[np.asarray(beats)],
        feasible=made.feasible,
        messages=(*made.messages, *(tubes.messages if tubes is not None else ())),
        tubes=tubes,
    )


def _half_widths(made: Design, tubes: Tubes | None, which: str) -> Array:
    """Half-widths of boxes around one kind of ellipsoid: ndarray (b, 8)."""
    out = np.full((len(made.beats), 8), np.nan)
    if tubes is None:
        return out
    shapes, sizes = getattr(tubes, f"{which}_shape"), getattr(tubes, f"{which}_rho")
    for index, part in enumerate(tubes.parts):
        there = np.isfinite(sizes[:, index])
        own = ellipsoid.half_widths(shapes[there, index], sizes[there, index])
        out[np.ix_(there, list(part.errors))] = own
    return out


def _shaped(found: Reading, lead: tuple[int, ...]) -> Reading:
    """The same with its axis of beats split into several, or none."""
    arrays: dict[str, Any] = {name: value for name, value in vars(found).items() if isinstance(value, np.ndarray)}
    return replace(found, **{name: value.reshape(*lead, *value.shape[1:]) for name, value in arrays.items()})
