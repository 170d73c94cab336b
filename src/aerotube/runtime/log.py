"""The log of a flight, ``flight.nc``: everything that was measured, decided and flown, and the flight again from it."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from aerotube import scenario
from aerotube.compensation import KINDS, Sampling
from aerotube.dynamics.errors import euler_error
from aerotube.errors import InputError
from aerotube.flight.metrics import error_metric, mean_absolute_error, root_mean_square_error
from aerotube.nominal import Nominal
from aerotube.preparation import prepare
from aerotube.results import provenance, whole_file
from aerotube.results.record import CONTROL_UNITS, CONTROLS, STATE_UNITS, STATES
from aerotube.runtime.commander import Beat, Source
from aerotube.runtime.flight import (
    Flown,
    Options,
    flown_settings,
    make_commander,
    make_estimator,
    make_task,
    make_world,
    nominal_of,
)
from aerotube.runtime.law import Laws
from aerotube.runtime.messages import Rung
from aerotube.runtime.outcome import deadlines, errors_flown, summarise
from aerotube.runtime.plant import fly_substep

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

#: Raised by one in its last place when a variable is added, in its first when one is renamed or removed.
SCHEMA_VERSION = "2.0"


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
    import xarray as xr

    record, count = flown.record, flown.record.flown
    settings = flown_settings(flown.prepared, flown.options)
    missed = deadlines(flown)
    start = float(record.due[0]) if count and np.isfinite(record.due[0]) else 0.0
    names = (*flown.world.aircraft.state_names, *["-"] * 16)[:16]
    out = xr.Dataset(
        coords={
            "beat": np.arange(count),
            "state": ("state", list(STATES)),
            "control": ("control", list(CONTROLS)),
            "measured_state": ("measured_state", [f"{i} {name}" for i, name in enumerate(names)]),
            "part": ("part", [part.name for part in flown.prepared.settings["noise"].parts]),
            "rung_name": ("rung_name", [rung.name.lower() for rung in Rung]),
            "certificate_name": ("certificate_name", list(KINDS)),
        },
        attrs=provenance(flown.prepared.source)
        | {
            "title": "aerotube flight log",
            "schema_version": SCHEMA_VERSION,
            "options": json.dumps(asdict(flown.options)),
            "summary": json.dumps(summarise(flown)),
            "refused": json.dumps(dict(record.refused)),
            "injected": json.dumps({} if flown.faults is None else dict(flown.faults.injected)),
            "events": json.dumps([[round(when - start, 6), words] for when, words in record.events]),
            "certified": json.dumps(
                {
                    "measurement_error": settings.measurement_error,
                    "gust": settings.gust,
                    "samples": settings.samples,
                    "confidence": settings.confidence,
                    "share": Sampling(settings.samples, settings.confidence, settings.sample_seed).share,
                }
            ),
            "warm_up_seconds": flown.warm_up,
            "first_window_seconds": flown.first_window,
            "beat_seconds": flown.world.dt,
            "beats_of_manoeuvre": flown.world.beats,
            "illegal_commands": -1 if flown.truth is None else flown.truth.illegal,
        },
    )

    def put(name: str, dims: tuple[str, ...], values: Any, words: str, units: str = "") -> None:
        out[name] = (dims, values, {"long_name": words} | ({"units": units} if units else {}))

    errors, controls = ", ".join(STATE_UNITS), ", ".join(CONTROL_UNITS)
    full = ("beat", "full_state")
    put("measured", ("beat", "measured_state"), record.measured[:count], "state as measured; NaN: none that was used")
    put("source", ("beat",), record.source[:count], "0 measured, 1 predicted, 2 none, -1 beat passed over")
    put("rung", ("beat", "part"), record.rung[:count], "what stood behind the command, an index of rung_name")
    put("size", ("beat", "part"), record.size[:count], "certified size of the law's tube, in its own metric")
    put("certificate", ("beat", "part"), record.kind[:count], "behind the size, an index of certificate_name; -1 none")
    laws, of_law = record.laws[:count], "law, from monomials of the error to increments of the virtual controls"
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
    put("unexplained", ("beat",), missed.unexplained, "missed, and the machine stole less than the lateness")
    injected = {} if flown.faults is None else flown.faults.by_beat
    put("fault", ("beat",), [injected.get(g, "") for g in range(count)], "fault injected into the measurement")
    for name, words in (("asked", "asked for"), ("started", "taken up"), ("done", "done")):
        values = np.array([getattr(w, name) for w in record.windows]) - start
        put(f"window_{name}", ("window",), np.where(np.isfinite(values), values, np.nan), f"window {words}", "s")
    for name in ("first", "beats", "computed", "attempts", "designed", "kept"):
        put(f"window_{name}", ("window",), [getattr(w, name) for w in record.windows], f"window: {name}")
    for name in ("check", "design", "certify"):
        spent = [w.seconds.get(name, 0.0) for w in record.windows]
        put(f"window_{name}_seconds", ("window",), spent, f"time spent on: {name}", "s")
    thefts = flown.thefts - [[start, 0.0, 0.0]]
    put("theft", ("theft_number", "end_seconds_core"), thefts, "sleeps that took too long", "s, s, 1")
    with_law = errors_flown(flown)
    if flown.truth is not None and with_law is not None and flown.alone is not None:
        truth, aircraft = flown.truth, ("manoeuvre", "step")
        put("true_state", ("manoeuvre", "time", "own_state"), truth.states, "state as it was")
        put("flown", (*aircraft, "substep", "control"), truth.flown, "positions of the controls", controls)
        put("wind", (*aircraft, "wind_component"), truth.wind, "velocity and rotation of the air")
        put("parameters", ("manoeuvre", "parameter"), truth.parameters, "of the aircraft")
        put("taken", aircraft, truth.taken, "substep from which the beat's command was there; -1 never")
        put("true_error", ("manoeuvre", "time", "state"), with_law, "error from the nominal", errors)
        put("alone_error", ("manoeuvre", "time", "state"), flown.alone, "the same without compensation", errors)
    return out


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
    if str(dataset.attrs.get("schema_version", "")).split(".")[0] != SCHEMA_VERSION.split(".")[0] or (
        "command" not in dataset
    ):
        raise InputError(f"log {path} is no flight's, or of another version; give a flight.nc of this version")
    return dataset


def replay(dataset: xr.Dataset) -> dict[str, float | None]:
    """Fly a log again: the aircraft from its start through the flown controls, the controller from its measurements.

    Parameters
    ----------
    dataset : xarray.Dataset

    Returns
    -------
    dict
        ``state`` and ``command``: the largest differences to the log, SI (zero on the machine that flew); ``mae`` and
        ``rmse`` of the flight flown again. None where there is no log of the aircraft.
    """
    options = Options(**json.loads(dataset.attrs["options"]))
    source = scenario.parse(
        str(dataset.attrs["scenario_text"]),
        name=str(dataset.attrs["scenario_name"]),
        overrides=json.loads(dataset.attrs["scenario_overrides"]),
    )
    prepared = prepare(source)
    command = _replay_controller(dataset, prepared, options)
    if "flown" not in dataset:
        return {"state": None, "command": command, "mae": None, "rmse": None}
    states = _replay_aircraft(dataset, make_world(prepared, options))
    runs, beats = dataset.sizes["manoeuvre"], int(dataset.attrs["beats_of_manoeuvre"])
    nominal = nominal_of(dataset["nominal_state"].values, dataset["nominal_end"].values, runs, beats)
    metric = error_metric(euler_error(states[..., :13], nominal)).reshape(-1)
    return {
        "state": float(np.abs(states - dataset["true_state"].values).max()),
        "command": command,
        "mae": float(mean_absolute_error(metric)),
        "rmse": float(root_mean_square_error(metric)),
    }


def _replay_aircraft(dataset: xr.Dataset, world: Any) -> Array:
    flown, wind, parameters = (dataset[name].values for name in ("flown", "wind", "parameters"))
    logged = dataset["true_state"].values
    compiled = world.aircraft.compiled_step()
    states = np.empty_like(logged)
    states[:, 0] = logged[:, 0]
    seconds = world.dt / flown.shape[2]
    for m in range(len(states)):
        for k in range(flown.shape[1]):
            state = states[m, k]
            for control in flown[m, k]:
                state = fly_substep(world.aircraft, compiled, state, control, parameters[m], wind[m, k], seconds)
            states[m, k + 1] = state
    return states


def _replay_controller(dataset: xr.Dataset, prepared: Any, options: Options) -> float:
    """Largest difference between the commands of the log and those that its measurements lead to again."""
    estimator = make_estimator(prepared, options)
    commander = make_commander(prepared, estimator, make_task(prepared, options).form)
    n = len(commander.aircraft.state_names)
    horizon = int(dataset.attrs["beats_of_manoeuvre"])
    names = ("measured", "source", "nominal_state", "nominal_end", "nominal_control", "rung", "command")
    measured, source, start, end, control, rung, logged = (dataset[name].values for name in names)
    reach = dataset["reach"].values if "reach" in dataset else np.zeros((len(source), 0, 0))
    laws = Laws(dataset["coefficient"].values, dataset["room"].values, reach)
    worst = 0.0
    for g in range(len(source)):
        if source[g] < 0:
            continue
        number = g % horizon
        if number == 0:
            commander.begin()
        if estimator is not None:
            commander.estimator = replace(estimator, nominal=_around(start[g], end[g], number, prepared.nominal))
        beat = Beat(start[g], control[g], laws[g], Rung(int(rung[g].max())), end[g])
        state = np.ascontiguousarray(measured[g, :n]) if source[g] == Source.MEASURED else None
        found = commander.command(number, state, beat)
        commander.after(number, beat, found.control)
        worst = max(worst, float(np.abs(found.control - logged[g]).max()))
    return worst


def _around(start: Array, end: Array, number: int, planned: Nominal) -> Nominal:
    """A nominal that has the states of one beat."""
    states = planned.states.copy()
    states[number, :13], states[number + 1, :13] = start, end
    return Nominal(planned.dt, states, planned.controls)
