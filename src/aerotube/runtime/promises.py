"""Whether a flight kept what the tubes of its laws promise: beats that start inside their sets must end inside them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from aerotube.compensation.sets import initial_ellipsoid
from aerotube.dynamics import ErrorCoordinates
from aerotube.runtime.options import flown_settings
from aerotube.tube import parameter_ranges

if TYPE_CHECKING:
    from aerotube.runtime.flight import Flown

Array = NDArray[np.float64]

# Of sizes and half-widths: within it is rounding.
_ROUNDING = 1e-9


def promises(flown: Flown) -> dict[str, Any] | None:
    """Beats of which a tube promised something, and those of them that left it.

    Parameters
    ----------
    flown : Flown

    Returns
    -------
    dict or None
        ``certified``: beats, of whole manoeuvres, with a certified law that was given a measurement of its own;
        ``promised``: those that started inside (errors, what the law saw of them, parameters and wind in the sets of
        the tube, the command there in time); ``left``: those of these that ended outside; ``why``: where none is
        promised, the reason and what to do about it, else None. None without the aircraft's log, and where it flew
        with a delay, actuators or an engine's lag, which no tube knows.
    """
    truth, record, options = flown.truth, flown.record, flown.options
    unknown = options.delay > 0 or options.actuators or len(flown.world.aircraft.state_names) > 13
    if truth is None or not truth.flown_manoeuvres or unknown:
        return None
    settings, disturbance = flown_settings(flown.prepared, options), flown.prepared.disturbance
    coordinates = ErrorCoordinates(settings.attitude)
    count = truth.flown_manoeuvres * flown.world.beats
    nominal = record.nominal_state[:count]
    start = coordinates.difference(truth.states[:, :-1, :13].reshape(count, -1), nominal)
    end = coordinates.difference(truth.states[:, 1:, :13].reshape(count, -1), record.nominal_end[:count])
    certified = np.asarray((record.kind[:count] >= 0).all(axis=1))
    heard = coordinates.box(nominal, settings.measurement_error * disturbance.half_widths)
    wind = np.repeat([settings.gust, settings.gust_rotation], 3)
    ranges = parameter_ranges(flown.world.aircraft, disturbance.relative)
    parameters = np.repeat(truth.parameters, flown.world.beats, axis=0)
    met = {
        "measurement": _within(record.error[:count] - start, heard),
        "air": _within(truth.wind.reshape(count, -1), wind),
        "parameters": _within(parameters - ranges.mean(axis=1), 0.5 * np.ptp(ranges, axis=1)),
        "command": truth.taken.reshape(-1) == 0,
        "start": np.ones(count, bool),
    }
    left = np.zeros(count, bool)
    for i, part in enumerate(settings.parts):
        own = list(part.errors)
        initial = initial_ellipsoid(disturbance, coordinates, nominal, part)
        met["start"] &= _sizes(start[:, own], initial.shape) <= (1.0 + _ROUNDING) * initial.rho
        metric = record.metric[:count][:, own][:, :, own]
        left |= ~(_sizes(end[:, own], metric) <= (1.0 + _ROUNDING) * record.size[:count, i])
    inside = np.logical_and.reduce([certified, *met.values()])
    return {
        "certified": int(certified.sum()),
        "promised": int(inside.sum()),
        "left": int((inside & left).sum()),
        "why": None if inside.any() else _why(flown, certified, met),
    }


def _why(flown: Flown, certified: NDArray[np.bool_], met: dict[str, NDArray[np.bool_]]) -> str:
    """What keeps tubes from promising anything in most beats, and which setting would change it."""
    if not certified.any():
        return "no law that was given a measurement of its own beat has a certificate"
    options, settings = flown.options, flown_settings(flown.prepared, flown.options)
    allowed, air = f"{100 * settings.measurement_error:g} %", f"{settings.gust:g} m/s"
    off = "the estimator's states" if options.estimator else "the measurements"
    which = "noise_free" if options.estimator or not flown.world.noise else "noise"
    reasons = {
        "measurement": f"tubes allow what the law is given to be off by {allowed} of the disturbance box, and {off} "
        f"were off by more; measurement_error in [synthesis.{which}] of the scenario makes tubes that allow more",
        "air": f"tubes withstand gusts of {air}, and the air moved more; gust and gust_rotation in [synthesis] of the "
        "scenario make tubes that withstand more",
        "parameters": "the aircraft's parameters were outside their ranges; [disturbance] of the scenario widens them",
        "command": "commands were not with the aircraft at the start of their beats; a longer beat gives them time",
        "start": "beats started outside the disturbance set; [disturbance] of the scenario widens it",
    }
    missing = {name: int((certified & ~good).sum()) for name, good in met.items()}
    return reasons[max(missing, key=lambda name: missing[name])]


def _within(values: Array, half_widths: Array) -> NDArray[np.bool_]:
    return np.asarray((np.abs(values) <= (1.0 + _ROUNDING) * half_widths + 1e-12).all(axis=-1))


def _sizes(error: Array, shape: Array) -> Array:
    return np.asarray(np.einsum("bi,bij,bj->b", error, shape, error))
