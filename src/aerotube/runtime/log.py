"""The log of a flight, ``flight.nc``: everything that was measured, decided and flown."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from aerotube.compensation import KINDS, Sampling
from aerotube.errors import InputError
from aerotube.results import provenance, whole_file
from aerotube.results.record import CONTROL_UNITS, CONTROLS, STATE_UNITS, STATES
from aerotube.runtime.flight import Flown
from aerotube.runtime.messages import Rung
from aerotube.runtime.options import flown_options, flown_settings
from aerotube.runtime.outcome import deadlines, errors_flown, summarise

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

#: Raised by one in its last place when a variable is added, in its first when one is renamed or removed.
SCHEMA_VERSION = "2.0"
TITLE = "aerotube flight log"


def to_dataset(flown: Flown) -> xr.Dataset:
    """Label everything that a flight has written down.

    Parameters
    ----------
    flown : Flown

    Returns
    -------
    xarray.Dataset
        SI; times in s of the clock since the first beat was due. ``beat`` counts all beats from take-off,
        ``manoeuvre`` and ``step`` those of the aircraft's own log.
    """
    record, count = flown.record, flown.record.flown
    start = float(record.due[0]) if count and np.isfinite(record.due[0]) else 0.0
    out = _described(flown, start)
    _put_beats(out, flown, start)
    _put_windows(out, flown, start)
    thefts = flown.thefts - [[start, 0.0, 0.0]]
    _put(out, "theft", ("theft_number", "end_seconds_core"), thefts, "sleeps that took too long", "s, s, 1")
    _put_aircraft(out, flown)
    return out


def _put(out: xr.Dataset, name: str, dims: tuple[str, ...], values: Any, words: str, units: str = "") -> None:
    out[name] = (dims, values, {"long_name": words} | ({"units": units} if units else {}))


def _described(flown: Flown, start: float) -> xr.Dataset:
    """A dataset with its labels, and with what is said of the flight as a whole."""
    import xarray as xr

    record, settings = flown.record, flown_settings(flown.prepared, flown.options)
    names = (*flown.world.aircraft.state_names, *["-"] * 16)[:16]
    certified = {
        "measurement_error": settings.measurement_error,
        "gust": settings.gust,
        "samples": settings.samples,
        "confidence": settings.confidence,
        "share": Sampling(settings.samples, settings.confidence, settings.sample_seed).share,
    }
    return xr.Dataset(
        coords={
            "beat": np.arange(record.flown),
            "state": ("state", list(STATES)),
            "control": ("control", list(CONTROLS)),
            "measured_state": ("measured_state", [f"{i} {name}" for i, name in enumerate(names)]),
            "part": ("part", [part.name for part in settings.parts]),
            "rung_name": ("rung_name", [rung.name.lower() for rung in Rung]),
            "certificate_name": ("certificate_name", list(KINDS)),
        },
        attrs=provenance(flown.prepared.source)
        | {
            "title": TITLE,
            "schema_version": SCHEMA_VERSION,
            "options": json.dumps(asdict(flown.options)),
            "options_flown": json.dumps(flown_options(flown.prepared, flown.options)),
            "summary": json.dumps(summarise(flown)),
            "refused": json.dumps(dict(record.refused)),
            "events": json.dumps([[round(when - start, 6), words] for when, words in record.events]),
            "certified": json.dumps(certified),
            "warm_up_seconds": flown.warm_up,
            "first_window_seconds": flown.first_window,
            "beat_seconds": flown.world.dt,
            "beats_of_manoeuvre": flown.world.beats,
            "illegal_commands": -1 if flown.truth is None else flown.truth.illegal,
        },
    )


def _put_beats(out: xr.Dataset, flown: Flown, start: float) -> None:
    """What was measured, decided and commanded, beat by beat."""
    record, count, missed = flown.record, flown.record.flown, deadlines(flown)
    errors, controls = ", ".join(STATE_UNITS), ", ".join(CONTROL_UNITS)
    injected = {} if flown.faults is None else flown.faults.by_beat
    full, laws = ("beat", "full_state"), record.laws[:count]
    of_law = "law, from monomials of the error to increments of the virtual controls"

    def put(name: str, dims: tuple[str, ...], values: Any, words: str, units: str = "") -> None:
        _put(out, name, dims, values, words, units)

    put("measured", ("beat", "measured_state"), record.measured[:count], "state as measured; NaN: none that was used")
    put("source", ("beat",), record.source[:count], "0 measured, 1 predicted, 2 none, -1 beat passed over")
    put("rung", ("beat", "part"), record.rung[:count], "what stood behind the command, an index of rung_name")
    put("size", ("beat", "part"), record.size[:count], "certified size of the law's tube, in its own metric")
    put("certificate", ("beat", "part"), record.kind[:count], "behind the size, an index of certificate_name; -1 none")
    put("metric", ("beat", "state", "other_state"), record.metric[:count], "in which the size is measured")
    put("coefficient", ("beat", "control", "monomial"), laws.coefficients, of_law)
    put("exponent", ("monomial", "state"), record.form.exponents, "powers of the errors in each monomial")
    put("room", ("beat", "control", "end"), laws.room, "increments at which a saturating law cuts itself off")
    if not record.form.linear:
        put("reach", ("beat", "state", "other_state"), laws.reach, "errors beyond which the law's bends stand still")
    put("error", ("beat", "state"), record.error[:count], "error that the law was given", errors)
    put("command", ("beat", "control"), record.command[:count], "command", controls)
    put("clamped", ("beat", "control"), record.clamped[:count], "the clamp held the control at its limit")
    put("nominal_state", full, record.nominal_state[:count], "nominal at the start of the beat")
    put("nominal_end", full, record.nominal_end[:count], "nominal at its end")
    put("nominal_control", ("beat", "control"), record.nominal_control[:count], "nominal control", controls)
    for name, words in (("due", "measurement due"), ("arrived", "measurement in"), ("sent", "command out")):
        put(name, ("beat",), getattr(record, name)[:count] - start, words, "s")
    put("law_late", ("beat",), record.law_late[:count], "the beat's window was not there")
    put("missed", ("beat",), missed.missed, "deadline missed")
    put("unexplained", ("beat",), missed.unexplained, "missed, and neither a fault nor the machine explains it")
    put("fault", ("beat",), [injected.get(g, "") for g in range(count)], "fault injected into the measurement")


def _put_windows(out: xr.Dataset, flown: Flown, start: float) -> None:
    """How the computation of the windows went."""
    windows = flown.record.windows
    for name, words in (("asked", "asked for"), ("started", "taken up"), ("done", "done")):
        values = np.array([getattr(w, name) for w in windows]) - start
        _put(out, f"window_{name}", ("window",), np.where(np.isfinite(values), values, np.nan), f"window {words}", "s")
    for name in ("first", "beats", "computed", "attempts", "designed", "kept"):
        _put(out, f"window_{name}", ("window",), [getattr(w, name) for w in windows], f"window: {name}")
    for name in ("check", "design", "certify"):
        spent = [w.seconds.get(name, 0.0) for w in windows]
        _put(out, f"window_{name}_seconds", ("window",), spent, f"time spent on: {name}", "s")


def _put_aircraft(out: xr.Dataset, flown: Flown) -> None:
    """The aircraft's own log, where there is one."""
    truth, with_law = flown.truth, errors_flown(flown)
    if truth is None or with_law is None or flown.alone is None:
        return
    errors, controls, beats = ", ".join(STATE_UNITS), ", ".join(CONTROL_UNITS), ("manoeuvre", "step")
    _put(out, "true_state", ("manoeuvre", "time", "own_state"), truth.states, "state as it was")
    _put(out, "flown", (*beats, "substep", "control"), truth.flown, "positions of the controls", controls)
    _put(out, "wind", (*beats, "wind_component"), truth.wind, "velocity and rotation of the air")
    _put(out, "parameters", ("manoeuvre", "parameter"), truth.parameters, "of the aircraft")
    _put(out, "taken", beats, truth.taken, "substep from which the beat's command was there; -1 never")
    _put(out, "true_error", ("manoeuvre", "time", "state"), with_law, "error from the nominal", errors)
    _put(out, "alone_error", ("manoeuvre", "time", "state"), flown.alone, "the same without compensation", errors)


def write(dataset: xr.Dataset, path: Path) -> None:
    """Write a log whole or not at all."""
    with whole_file(path) as aside:
        dataset.to_netcdf(aside, engine="h5netcdf")


def read(path: Path) -> xr.Dataset:
    """Read a log.

    Raises
    ------
    InputError
        If it is none.
    """
    import xarray as xr

    try:
        with xr.open_dataset(path, engine="h5netcdf") as opened:
            dataset = opened.load()
    except FileNotFoundError:
        raise InputError(f"log {path}: no such file; `aerotube fly` writes one") from None
    except (OSError, ValueError) as error:
        raise InputError(f"log {path} cannot be read ({str(error).splitlines()[0]}); give a flight.nc") from None
    if dataset.attrs.get("title") != TITLE:
        raise InputError(f"{path} is no log of a flight; give a flight.nc, as `aerotube fly` writes one")
    version = str(dataset.attrs.get("schema_version", ""))
    if version.split(".")[0] != SCHEMA_VERSION.split(".")[0]:
        raise InputError(
            f"log {path} is of version {version or '?'}, this program reads {SCHEMA_VERSION}; fly the scenario again"
        )
    return dataset
