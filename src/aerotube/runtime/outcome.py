"""What a flight comes to: tracking, deadlines, latency, real-time factor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerotube.dynamics.errors import euler_error
from aerotube.flight.metrics import error_metric, mean_absolute_error, root_mean_square_error
from aerotube.runtime.aircraft_process import GRACE
from aerotube.runtime.alone import nominal_of
from aerotube.runtime.flight import Flown
from aerotube.runtime.promises import promises
from aerotube.runtime.record import WindowTimes
from aerotube.runtime.watchdog import stolen

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Deadlines:
    """Beats whose law or command was not there in time.

    Attributes
    ----------
    missed : ndarray (g,) of bool
    by_fault : ndarray (g,) of bool
        Of these, those whose laws were late because an injected fault killed or stalled the worker of their window.
    by_machine : ndarray (g,) of bool
        Of the others, those for which the machine stole no less time than they were late.
    lateness : ndarray (g,)
        s; zero where nothing was late.
    """

    missed: NDArray[np.bool_]
    by_fault: NDArray[np.bool_]
    by_machine: NDArray[np.bool_]
    lateness: Array

    @property
    def unexplained(self) -> NDArray[np.bool_]:
        """Missed, and neither a fault nor the machine is why."""
        return self.missed & ~self.by_fault & ~self.by_machine


def errors_flown(flown: Flown) -> Array | None:
    """True errors (manoeuvre, T + 1, 8) of the manoeuvres flown to their end; None without the aircraft's log."""
    truth = flown.truth
    if truth is None or not truth.flown_manoeuvres:
        return None
    record = flown.record
    nominal = nominal_of(record.nominal_state, record.nominal_end, truth.flown_manoeuvres, flown.world.beats)
    return euler_error(truth.states[..., :13], nominal)


def deadlines(flown: Flown) -> Deadlines:
    """Which beats missed their deadline, and whether an injected fault or the machine is to blame.

    A beat has missed its deadline if its window of laws was not there when its measurement was, or if its command
    was not with the aircraft within `GRACE` of the beat (by the aircraft's own log where there is one). Measurements
    that injected faults took away are not counted here.
    """
    record, length = flown.record, _beat_seconds(flown)
    count = record.flown
    late_law = record.law_late[:count].copy()
    lateness = np.zeros(count)
    windows = window_of(flown)
    for g in np.flatnonzero(late_law):
        window = windows.get(int(g))
        done = window.done if window is not None and np.isfinite(window.done) else np.inf
        lateness[g] = max(done - record.sent[g], 0.0) if np.isfinite(record.sent[g]) else np.inf
    late_command = np.zeros(count, bool)
    if np.isfinite(flown.options.speed):
        with np.errstate(invalid="ignore"):
            over = record.sent[:count] - (record.due[:count] + GRACE * length)
        late_command = ~(over <= 0)
        if flown.truth is not None:
            taken = flown.truth.taken.reshape(-1)[:count]
            late_command[: len(taken)] |= taken != 0
        if flown.faults is not None:
            spoiled = [g for g in flown.faults.by_beat if g < count]
            late_command[spoiled] &= over[spoiled] > 0
        lateness[late_command] = np.maximum(lateness, np.nan_to_num(over, nan=length))[late_command]
    missed = late_law | late_command
    by_fault, by_machine = late_law & _hit(flown), np.zeros(count, bool)
    for g in np.flatnonzero(missed & ~by_fault):
        window = windows.get(int(g))
        begin = record.due[g] - length
        if late_law[g] and window is not None:
            begin = min(begin, window.asked)
        end = np.nanmax([record.sent[g], record.due[g] + length])
        theft = stolen(flown.thefts, begin, end)
        by_machine[g] = theft > 0 and theft >= lateness[g]
    return Deadlines(missed, by_fault, by_machine, lateness)


def _hit(flown: Flown) -> NDArray[np.bool_]:
    """Beats of windows at which a worker was hit by an injected fault: (g,)."""
    beats = np.arange(flown.record.flown)
    number = beats % flown.world.beats
    starts = beats - number + number // flown.options.window * flown.options.window
    hit = [] if flown.faults is None else sorted(flown.faults.windows)
    return np.isin(starts, hit)


def ended(flown: Flown) -> str:
    """How the flight ended.

    Returns
    -------
    str
        "whole"; "interrupted" by the user; "early": another's aircraft ended it; "behind": the aircraft had not flown
        its manoeuvres to their end when the controller was done; "lost": its log did not come home.
    """
    if flown.interrupted:
        return "interrupted"
    if flown.options.port is not None:
        return "whole" if flown.record.flown == flown.record.beats else "early"
    if flown.truth is None:
        return "lost"
    return "whole" if flown.truth.flown_manoeuvres == flown.world.manoeuvres else "behind"


def _beat_seconds(flown: Flown) -> float:
    return flown.world.dt / flown.options.speed if np.isfinite(flown.options.speed) else 0.0


def window_of(flown: Flown) -> dict[int, WindowTimes]:
    """The window that holds each beat."""
    return {g: window for window in flown.record.windows for g in range(window.first, window.first + window.beats)}


def realtime_factor(flown: Flown) -> float | None:
    """Seconds of flight that the windows hold, over the seconds that computing them took; None without windows."""
    done = [w for w in flown.record.windows if np.isfinite(w.done) and not w.error]
    if not done:
        return None
    taken = sum(w.done - w.started for w in done)
    return float(sum(w.computed for w in done) * flown.world.dt / taken)


def window_times(flown: Flown) -> dict[str, float] | None:
    """Median ms that a window of full length took, and of them on what; None without such windows."""
    whole = [w for w in flown.record.windows if not w.error and w.computed == flown.options.window]
    if not whole:
        return None
    spent = {name: [w.seconds.get(name, 0.0) for w in whole] for name in ("check", "design", "certify")}
    every = {"whole": [w.done - w.started for w in whole], **spent}
    return {name: 1e3 * float(np.median(seconds)) for name, seconds in every.items()}


def latency(flown: Flown) -> Array:
    """From a measurement's arrival to its command, s, of the beats that had both."""
    record = flown.record
    spans = record.sent[: record.flown] - record.arrived[: record.flown]
    return np.asarray(spans[np.isfinite(spans)])


def summarise(flown: Flown) -> dict[str, Any]:
    """The contents of ``fly.json``.

    Returns
    -------
    dict
        ``beats`` and the ``seconds`` of flight that they are, of so many ``seconds_asked``; ``ended``, see
        :func:`ended`; ``broken_off``, the beats of a manoeuvre that was not flown to its end, of which the aircraft
        has no log; ``missed_deadlines``, and of them ``missed_explained`` by what explains them (``fault``: one was
        injected into the worker of the beat's window; ``machine``: it stole the time) and ``missed_unexplained``;
        ``faults`` injected, by kind; ``fallbacks`` by kind (beats);
        ``certificates`` by kind (beats, by the part that has the least; "none": no tube is claimed); ``promises`` of
        their tubes, see :func:`~aerotube.runtime.promises.promises`; ``mae`` and ``rmse`` of Eq. 18 over all
        manoeuvres, without compensation and with it; ``latency_us`` from measurement to command; ``realtime_factor`` of
        the window computation, and ``window_ms``, the median time of a whole one. None where a figure does not exist.
    """
    missed = deadlines(flown)
    with_law = errors_flown(flown)
    figures: dict[str, dict[str, float | None]] = {"mae": {}, "rmse": {}}
    for name, errors in (("none", flown.alone), ("compensated", with_law)):
        for key, function in (("mae", mean_absolute_error), ("rmse", root_mean_square_error)):
            value = None if errors is None else float(function(error_metric(errors).reshape(-1)))
            figures[key][name] = value if value is not None and np.isfinite(value) else None
    spans, beats = 1e6 * latency(flown), int(flown.record.flown)
    whole = beats if flown.truth is None else flown.truth.flown_manoeuvres * flown.world.beats
    return {
        "beats": beats,
        "seconds": beats * flown.world.dt,
        "seconds_asked": flown.options.duration,
        "ended": ended(flown),
        "broken_off": max(beats - whole, 0),
        "missed_deadlines": int(missed.missed.sum()),
        "missed_explained": {"fault": int(missed.by_fault.sum()), "machine": int(missed.by_machine.sum())},
        "missed_unexplained": int(missed.unexplained.sum()),
        "faults": {} if flown.faults is None else dict(sorted(flown.faults.injected.items())),
        "fallbacks": flown.record.fallbacks(),
        "certificates": flown.record.certificates(),
        "promises": promises(flown),
        **figures,
        "latency_us": {
            "median": float(np.median(spans)) if len(spans) else None,
            "p99": float(np.percentile(spans, 99)) if len(spans) else None,
        },
        "realtime_factor": realtime_factor(flown),
        "window_ms": window_times(flown),
    }
