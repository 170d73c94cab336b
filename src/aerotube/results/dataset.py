"""The labelled dataset of a run, and its file ``results.nc``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aerotube.compensation import SHARES
from aerotube.errors import InputError
from aerotube.results.assurance import put_containment, put_margins
from aerotube.results.record import (
    CONTROL_UNITS,
    CONTROLLERS,
    CONTROLS,
    STATE_UNITS,
    STATES,
    Case,
    Law,
    Record,
)
from aerotube.results.terms import put_terms
from aerotube.results.writing import whole_file

if TYPE_CHECKING:
    import xarray as xr

#: Raised by one in its last place when a variable is added, in its first when one is renamed or removed.
SCHEMA_VERSION = "2.1"

_TITLE = "aerotube results"

#: Where the unit changes along the last axis: one for each label of the axis, in its order.
_UNITS_BY_STATE, _UNITS_BY_CONTROL = ", ".join(STATE_UNITS), ", ".join(CONTROL_UNITS)


def build(record: Record) -> xr.Dataset:
    """Label everything that a run has computed.

    Parameters
    ----------
    record : Record
        Complete or not; what is absent is left out (laws) or missing values (cases, see ``flown``).

    Returns
    -------
    xarray.Dataset
        SI units, in the attribute ``units`` of each variable; provenance in the attributes.
    """
    import xarray as xr

    beats = len(record.nominal_controls)
    dataset = xr.Dataset(
        coords={
            "time": ("time", record.times, {"units": "s"}),
            "beat": ("beat", np.arange(beats), {"long_name": "beat, from time[beat] to time[beat + 1]"}),
            "state": ("state", list(STATES), {"long_name": "error state"}),
            "state_units": ("state", list(STATE_UNITS)),
            "control": ("control", list(CONTROLS)),
            "control_units": ("control", list(CONTROL_UNITS)),
            "full_state": ("full_state", list(record.full_state_names)),
            "full_state_units": ("full_state", list(record.full_state_units)),
        },
        attrs=dict(record.provenance)
        | {
            "title": f"{_TITLE}: tubes, laws and flights of one scenario",
            "schema_version": SCHEMA_VERSION,
            "complete": int(not record.interrupted and len(record.cases) == _wanted(record)),
            "interrupted": int(record.interrupted),
            "runs_per_seed": record.runs,
            "problems": json.dumps(record.problems, ensure_ascii=False),
            "seconds": json.dumps(record.seconds),
        },
    )
    by_state, by_control = {"units": _UNITS_BY_STATE}, {"units": _UNITS_BY_CONTROL}
    put = dataset.__setitem__
    put("nominal_state", (("time", "state"), record.nominal_error_states, by_state))
    put(
        "nominal_full_state",
        (("time", "full_state"), record.nominal_states, {"units": ", ".join(record.full_state_units)}),
    )
    put("nominal_control", (("beat", "control"), record.nominal_controls, by_control))
    put(
        "half_width",
        ("state", record.half_widths, by_state | {"long_name": "half-width of the disturbance box"}),
    )
    put("control_lower", ("control", record.control_lower, by_control))
    put("control_upper", ("control", record.control_upper, by_control))
    if record.coefficient_alpha is not None:
        dataset.coords["coefficient_alpha"] = (
            "coefficient_alpha",
            record.coefficient_alpha,
            {"units": "rad"},
        )
        for name, values in record.coefficients.items():
            put(f"coefficient_{name}", ("coefficient_alpha", values, {"units": "1"}))
    if record.laws:
        _put_laws(dataset, record.laws)
        put_margins(dataset, record.laws)
    if record.conditions:
        _put_cases(dataset, record)
        put_containment(dataset, record)
    return dataset


def _wanted(record: Record) -> int:
    return len(CONTROLLERS) * len(record.conditions)


def _put_laws(dataset: xr.Dataset, laws: dict[str, Law]) -> None:
    dataset.coords["law"] = ("law", list(laws), {"long_name": "setting of the synthesis"})
    # The algorithm, and so the parts, are common to all settings.
    parts = next(iter(laws.values())).parts
    dataset.coords["part"] = ("part", [name for name, _ in parts])
    dataset.coords["part_state"] = (("part", "row"), [[STATES[i] for i in indices] for _, indices in parts])

    def stacked(attribute: str) -> Any:
        return np.stack([getattr(law, attribute) for law in laws.values()])

    shape = ("law", "beat", "part", "row", "column")
    size = ("law", "beat", "part")
    kinds = {
        "initial": "ellipsoid {x : x'Ex <= rho} at the start of a beat",
        "terminal": "ellipsoid at the end of a beat, with the law",
        "nominal": "ellipsoid at the end of a beat, without compensation",
    }
    inverse = {"units": "1 over the products of part_state units"}
    for kind, words in kinds.items():
        dataset[f"{kind}_shape"] = (shape, stacked(f"{kind}_shape"), inverse | {"long_name": f"E of the {words}"})
        dataset[f"{kind}_rho"] = (size, stacked(f"{kind}_rho"), {"units": "1", "long_name": f"rho of the {words}"})
    dataset["metric"] = (shape, stacked("metric"), inverse | {"long_name": "in which the synthesis measured size"})
    for name, words in (("size", "with the law"), ("size_nominal", "without compensation")):
        long_name = f"least rho in the metric, {words}"
        dataset[name] = (size, stacked(name), {"units": "1", "long_name": long_name})
    dataset["gain"] = (
        ("law", "beat", "control", "state"),
        stacked("gains"),
        {"units": "virtual control over state, SI", "long_name": "linear part of the law; throttle row in N"},
    )
    dataset["feasible"] = (
        size,
        stacked("feasible"),
        {"long_name": "a law was found; else the nominal alone is flown"},
    )
    dataset["solve_time"] = (
        size,
        stacked("solve_seconds"),
        {"units": "s", "long_name": "time to solve one part"},
    )
    put_terms(dataset, laws)
    _put_certificates(dataset, laws)
    dataset["settings"] = ("law", [json.dumps(dict(law.settings)) for law in laws.values()])


def _put_certificates(dataset: xr.Dataset, laws: dict[str, Law]) -> None:
    """Put what each tube rests on and what it is made of."""
    dataset.coords["share"] = ("share", list(SHARES), {"long_name": "what a polynomial's bound leaves out of a tube"})
    size = ("law", "beat", "part")

    def put(name: str, attribute: str, dims: tuple[str, ...], **attributes: str) -> None:
        dataset[name] = (dims, np.stack([getattr(law, attribute) for law in laws.values()]), attributes)

    put("certificate", "certificate", size, long_name="what the tubes rest on, with the law")
    put("certificate_nominal", "certificate_nominal", size, long_name="what they rest on, without compensation")
    put("size_polynomial", "polynomial_size", size, units="1", long_name="bound of the polynomials' size, with the law")
    put("size_share", "shares", (*size, "share"), units="1", long_name="what is added to size_polynomial to make size")
    put(
        "size_control", "control", size, units="1",
        long_name="what the nonlinearity of the control's effect can have added, as a part of size_polynomial",
    )  # fmt: skip
    put("boundary_enough", "boundary", size, long_name="the programs are on the boundary of the initial ellipsoid")
    put("certify_time", "certify_seconds", size, units="s", long_name="time of what is added to size_polynomial")
    dataset["sampling"] = (
        "law",
        [json.dumps(dict(law.sampling)) for law in laws.values()],
        {"long_name": "of sampled tubes: with this confidence no more than this share of the set exceeds them"},
    )
    dataset["certificate_note"] = ("law", [json.dumps(list(law.notes)) for law in laws.values()])


def _put_cases(dataset: xr.Dataset, record: Record) -> None:
    dataset.coords["controller"] = ("controller", list(CONTROLLERS))
    dataset.coords["condition"] = ("condition", list(record.conditions))
    dataset.coords["seed"] = ("seed", list(record.seeds), {"long_name": "seed of the random draws"})
    dataset.coords["run"] = ("run", np.arange(record.runs))
    grid = (len(CONTROLLERS), len(record.conditions))
    seeds, runs, times = len(record.seeds), record.runs, len(record.times)
    upper = np.full((*grid, seeds, times), np.nan)
    mean = np.full((*grid, seeds, times), np.nan)
    error = np.full((*grid, runs, times, len(STATES)), np.nan)
    command = np.full((*grid, runs, times - 1, len(CONTROLS)), np.nan)
    diverged = np.zeros((*grid, seeds, runs), dtype=bool)
    outside = np.zeros((*grid, seeds, runs), dtype=bool)
    flown = np.zeros(grid, dtype=bool)
    words = np.full(grid, "", dtype=object)
    for (controller, condition), case in record.cases.items():
        at = CONTROLLERS.index(controller), record.conditions.index(condition)
        upper[at], mean[at], error[at], command[at] = (
            case.upper_metric,
            case.mean_metric,
            case.error,
            case.command,
        )
        diverged[at], outside[at], flown[at], words[at] = case.diverged, case.outside, True, case.law
    case_dims = ("controller", "condition")
    metric = {
        "units": "deg",
        "long_name": "error metric (Eq. 18): RMS over the eight states, deg and deg/s, V in 100 m/s",
    }
    dataset["upper_metric"] = ((*case_dims, "seed", "time"), upper, metric | {"cell_methods": "run: maximum"})
    dataset["mean_metric"] = ((*case_dims, "seed", "time"), mean, metric | {"cell_methods": "run: mean"})
    dataset["error"] = (
        (*case_dims, "run", "time", "state"),
        error,
        {"units": _UNITS_BY_STATE, "long_name": "difference to the nominal, runs of the first seed"},
    )
    dataset["command"] = (
        (*case_dims, "run", "beat", "control"),
        command,
        {"units": _UNITS_BY_CONTROL, "long_name": "control, runs of the first seed"},
    )
    by_run = (*case_dims, "seed", "run")
    dataset["diverged"] = (by_run, diverged, {"long_name": "from then on the last error counts"})
    dataset["outside"] = (by_run, outside, {"long_name": "at some time outside the range of the aircraft's tables"})
    dataset["flown"] = (
        case_dims,
        flown,
        {"long_name": "false: this case was not reached, its values are missing"},
    )
    dataset["flown_law"] = (case_dims, words.astype(str))


def write(dataset: xr.Dataset, path: str | Path) -> None:
    """Write a dataset to a netCDF file, whole or not at all."""
    compressed = {
        name: {"zlib": True, "complevel": 1}
        for name, variable in dataset.data_vars.items()
        if variable.dtype.kind == "f" and variable.ndim > 1
    }
    with whole_file(path) as aside:
        dataset.to_netcdf(aside, engine="h5netcdf", encoding=compressed)


def read(path: str | Path) -> xr.Dataset:
    """Read a results file.

    Raises
    ------
    InputError
        If there is no such file, it is no netCDF file, holds something else than the results of a run, or is of a
        schema that this version does not read.
    """
    import xarray as xr

    if not Path(path).is_file():
        raise InputError(f"results {path}: no such file; `aerotube run` writes one")
    try:
        with xr.open_dataset(path, engine="h5netcdf") as dataset:
            dataset.load()
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else "it is of another format"
        raise InputError(f"results {path} cannot be read as netCDF ({why})") from None
    if not str(dataset.attrs.get("title", "")).startswith(_TITLE):
        raise InputError(
            f'results {path} holds "{dataset.attrs.get("title", "something else")}", not the results of a run; give '
            "the results.nc that `aerotube run` writes"
        )
    version = str(dataset.attrs.get("schema_version", "none"))
    if version.split(".")[0] != SCHEMA_VERSION.split(".")[0]:
        raise InputError(
            f"results {path} has schema version {version}, this aerotube reads {SCHEMA_VERSION}; run it again"
        )
    return dataset


__all__ = ["SCHEMA_VERSION", "Case", "Law", "Record", "build", "read", "write"]
