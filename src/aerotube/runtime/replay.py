"""A flight again from its log: to the same numbers."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from aerotube import scenario
from aerotube.dynamics.errors import euler_error
from aerotube.flight.metrics import error_metric, mean_absolute_error, root_mean_square_error
from aerotube.nominal import Nominal
from aerotube.preparation import prepare
from aerotube.runtime.alone import nominal_of
from aerotube.runtime.commander import Beat, Source
from aerotube.runtime.law import Laws
from aerotube.runtime.messages import Rung
from aerotube.runtime.options import Options, make_commander, make_estimator, make_task, make_world
from aerotube.runtime.plant import fly_substep

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]


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
