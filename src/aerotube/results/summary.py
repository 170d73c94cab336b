"""The headline numbers of a run, from its dataset."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from aerotube.compensation import KINDS, NONE
from aerotube.results.assurance import summarise_containment, summarise_margins
from aerotube.results.record import CONTROLLERS, KEY_SUFFIX

if TYPE_CHECKING:
    import xarray as xr


def summarise(dataset: xr.Dataset) -> dict[str, Any]:
    """Compute the summary of a dataset.

    Parameters
    ----------
    dataset : xarray.Dataset
        As built by `aerotube.results.build`, complete or not.

    Returns
    -------
    dict
        Plain numbers, ready for JSON; None where a part was not computed. ``mean_upper_error`` is the mean
        over time of the largest metric (Eq. 18) over the runs of a seed, then mean and standard deviation
        over seeds; ``reduction`` is one minus the ratio compensated to none, seed by seed; the keys ending in
        ``_noise`` and ``_estimator`` are the same with sensor noise, and with noise and the state estimator.
    """
    times = dataset["time"].values
    summary: dict[str, Any] = {
        "schema_version": dataset.attrs["schema_version"],
        "complete": bool(dataset.attrs["complete"]),
        "interrupted": bool(dataset.attrs["interrupted"]),
        "title": dataset.attrs.get("scenario_title", ""),
        "seeds": int(dataset.sizes.get("seed", 0)),
        "seed_values": [int(seed) for seed in dataset["seed"].values] if "seed" in dataset else [],
        "runs_per_seed": int(dataset.attrs["runs_per_seed"]),
        "horizon_s": round(float(times[-1] - times[0]), 9),
        "beats": int(dataset.sizes["beat"]),
    }
    summary |= _of_flights(dataset) | _of_laws(dataset)
    summary["containment"] = summarise_containment(dataset)
    summary["problems"] = json.loads(dataset.attrs["problems"])
    summary["seconds"] = json.loads(dataset.attrs["seconds"])
    summary["provenance"] = {
        key: dataset.attrs[key]
        for key in (
            "aerotube_version",
            "scenario_name",
            "scenario_sha256",
            "platform",
            "processor",
            "created",
        )
        if key in dataset.attrs
    }
    return summary


def _of_flights(dataset: xr.Dataset) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for condition, suffix in KEY_SUFFIX.items():
        errors = {str(name): mean_upper_error(dataset, str(name), condition) for name in _controllers(dataset)}
        result[f"mean_upper_error{suffix}"] = {name: _spread(values) for name, values in errors.items()}
        none = errors.get("none")
        for name, key in (("compensated", "reduction"), ("lqr", "lqr_reduction")):
            values = errors.get(name)
            ratio = None if values is None or none is None else 1.0 - values / none
            result[f"{key}{suffix}"] = _spread(ratio)
    for name in ("diverged", "outside"):
        if name in dataset:
            counts = dataset[name].sum(("seed", "run"))
            result[f"{name}_runs"] = {
                str(condition): {
                    controller: int(counts.sel(condition=condition, controller=controller))
                    for controller in _controllers(dataset)
                }
                for condition in dataset["condition"].values
            }
    return result


def _controllers(dataset: xr.Dataset) -> list[str]:
    return [str(c) for c in dataset["controller"].values] if "controller" in dataset else list(CONTROLLERS)


def mean_upper_error(dataset: xr.Dataset, controller: str, condition: str) -> np.ndarray | None:
    """Mean over time of the upper envelope of the metric, one value a seed; None if the case was not flown.

    Parameters
    ----------
    dataset : xarray.Dataset
    controller, condition : str

    Returns
    -------
    ndarray (seed,) or None
    """
    if "upper_metric" not in dataset or condition not in dataset["condition"].values:
        return None
    case = {"controller": controller, "condition": condition}
    if not bool(dataset["flown"].sel(case)):
        return None
    values: np.ndarray = dataset["upper_metric"].sel(case).mean("time").values
    return values


def _spread(values: np.ndarray | None) -> dict[str, float | None]:
    """Mean and sample standard deviation; one seed has no spread."""
    if values is None or not np.all(np.isfinite(values)):
        return {"mean": None, "sd": None}
    return {"mean": float(np.mean(values)), "sd": float(np.std(values, ddof=1)) if len(values) > 1 else None}


def _of_laws(dataset: xr.Dataset) -> dict[str, Any]:
    if "law" not in dataset.dims:
        return {"feasible_beats": None, "solve_ms": {"median": None, "p99": None}, "laws": {}}
    both = dataset["feasible"].all("part")
    milliseconds = 1e3 * dataset["solve_time"]
    laws = {
        str(name): {
            "feasible_beats": int(both.sel(law=name).sum()),
            "certificate": _counts(dataset["certificate"].sel(law=name).values),
            "certificate_notes": json.loads(str(dataset["certificate_note"].sel(law=name).values)),
            "sampling": json.loads(str(dataset["sampling"].sel(law=name).values)),
            "tube_excess": _excess(dataset.sel(law=name)),
            "certify_ms": _percentiles(1e3 * dataset["certify_time"].sel(law=name).values),
            "solve_ms": _percentiles(milliseconds.sel(law=name).values),
            "settings": json.loads(str(dataset["settings"].sel(law=name).values)),
            "margins": summarise_margins(dataset, str(name)),
        }
        for name in dataset["law"].values
    }
    return {
        # A beat counts when every setting found a law in every part.
        "feasible_beats": int(both.all("law").sum()),
        "solve_ms": _percentiles(milliseconds.values),
        "laws": laws,
    }


def _counts(kinds: np.ndarray) -> dict[str, int]:
    """How many tubes have each kind of certificate, the best first."""
    found = [str(kind) for kind in kinds.ravel()]
    return {kind: found.count(kind) for kind in (*reversed(KINDS), NONE) if kind in found}


def _excess(law: xr.Dataset) -> dict[str, Any]:
    """By how much tubes are larger than their polynomials' (rho, relative), part by part, and what makes it up."""
    out: dict[str, Any] = {}
    for part in law["part"].values:
        chosen = law.sel(part=part)
        relative = chosen["size_share"] / chosen["size_polynomial"]
        beats = np.isfinite(relative.values).all(axis=-1)
        if not beats.any():
            out[str(part)] = None
            continue
        whole = relative.sum("share").values[beats]
        out[str(part)] = {
            "median": float(np.median(whole)),
            "largest": float(whole.max()),
            "shares": {str(name): float(relative.sel(share=name).values[beats].mean()) for name in law["share"].values},
            "control": float((chosen["size_control"] / chosen["size_polynomial"]).values[beats].mean()),
        }
    return out


def _percentiles(values: np.ndarray) -> dict[str, float | None]:
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return {"median": None, "p99": None}
    return {"median": float(np.median(finite)), "p99": float(np.percentile(finite, 99))}
