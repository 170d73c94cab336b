"""Tracking, control effort and tube size over noise weight, shape and limits: what a designer chooses from."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from aerotube import compensation
from aerotube.compensation.settings import Limits, Shape
from aerotube.flight import METRIC_SCALE, Flights
from aerotube.report.style import new_figure
from aerotube.results import CALM, CONDITION_WORDS, NOISE
from aerotube.studies.bench import Bench
from aerotube.studies.flown import COLOURS, DASHES
from aerotube.studies.outcome import Outcome, Table, compare
from aerotube.tube import ellipsoid

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

NOISE_WEIGHTS = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0)
SHAPES: tuple[Shape, ...] = ("cost-to-go", "riccati")
LIMITS: tuple[Limits, ...] = ("box", "ellipsoid")
FLOWN = (CALM, NOISE)

# Where the number of a point stands, in points of the page, so that those of curves that meet stay apart.
_ASIDE = ((5, -9), (5, 4), (-11, -9), (-11, 5))


def study(bench: Bench) -> Outcome:
    """Design, measure and fly a law for every choice."""
    dataset = _sweep(bench)
    noisy = dataset["mean_upper_error"].sel(condition=NOISE).mean("seed")
    best = {name: noisy.where(noisy == noisy.min(), drop=True)[name].values[0] for name in noisy.dims}
    scene = dataset.sel(shape="cost-to-go", limits="box")
    rows = []
    for weight in NOISE_WEIGHTS:
        at = scene.sel(noise_weight=weight)
        for condition in FLOWN:
            words = f"mean upper error, ν = {weight:g}, {CONDITION_WORDS[condition]}"
            end = "" if condition == CALM else "_noise"
            rows.append(
                compare(f"error_{weight:g}{end}", words, None, at["mean_upper_error"].sel(condition=condition).values)
            )
        rows.append(
            compare(
                f"effort_{weight:g}",
                f"control effort, ν = {weight:g}, sensor noise",
                None,
                float(at["effort"].sel(condition=NOISE)),
                "1",
            ),
        )
        rows.append(compare(f"tube_{weight:g}", f"tube size, ν = {weight:g}", None, float(at["tube_size"])))
    calm, heard = (scene["mean_upper_error"].sel(condition=name).mean("seed").values for name in FLOWN)
    return Outcome(
        dataset=dataset,
        figure=_figure(dataset),
        caption=(
            "Left and middle: tracking over control effort, one point for each noise weight ν, smaller weights to the "
            "right as a rule. Right: tracking with noise over the size of the tube of one beat. Lower left is better."
        ),
        compared=tuple(rows),
        verdict=(
            f"From ν = 0 to {NOISE_WEIGHTS[-1]:g} the error with noise goes from {heard[0]:.2f} over "
            f"{heard.min():.2f} (ν = {NOISE_WEIGHTS[int(heard.argmin())]:g}) to {heard[-1]:.2f}, without noise from "
            f"{calm[0]:.2f} to {calm[-1]:.2f}; best with noise: shape {best['shape']}, limits on the "
            f"{best['limits']}, ν = {best['noise_weight']:g}."
        ),
        notes=(
            "The paper has no such curve; it weighs neither noise nor effort.",
            "Control effort is the root mean square of the increments over half their travel, over all runs, beats "
            "and controls. Tube size is Eq. 18 of the half-widths at the end of a beat, mean over the beats; of "
            "the polynomials.",
            "All laws have the control weight and the measurement error of the scenario's noise setting; each flies "
            "without sensor noise and with noise of the full range, on the same draws.",
            "The size of the tube of one beat does not tell how well a law tracks: under noise the best law leaves a "
            "larger tube than others, and laws with the same tubes track differently. What looks beyond the beat "
            "does.",
        ),
        tables=(_table(dataset),),
    )


def _sweep(bench: Bench) -> xr.Dataset:
    import xarray as xr

    ready, base = bench.prepared, bench.settings(NOISE)
    grid = (len(SHAPES), len(LIMITS), len(NOISE_WEIGHTS))
    error = np.full((*grid, len(FLOWN), len(bench.seeds)), np.nan)
    effort, size = np.full((*grid, len(FLOWN)), np.nan), np.full(grid, np.nan)
    feasible = np.zeros(grid, int)
    choices = itertools.product(enumerate(SHAPES), enumerate(LIMITS), enumerate(NOISE_WEIGHTS))
    for done, ((s, shape), (k, limits), (w, weight)) in enumerate(choices):
        bench.tell(f"shape {shape}, limits on the {limits}, ν = {weight:g}", done / int(np.prod(grid)))
        chosen: dict[str, Any] = {"shape": shape, "limits": limits, "noise_weight": weight}
        settings = replace(base, certificate="polynomial only", **chosen)
        made = bench.design(settings)
        tubes, _ = compensation.measure(
            ready.model, ready.nominal, ready.disturbance, made.law, made.metric, settings, workers=bench.workers
        )
        feasible[s, k, w] = int(made.feasible.all(axis=1).sum())
        size[s, k, w] = _tube_size(tubes)
        for c, condition in enumerate(FLOWN):
            flown = bench.fly(made.law, condition)
            error[s, k, w, c] = flown.mean_upper_error()
            effort[s, k, w, c] = _effort(bench, flown)
    where = ("shape", "limits", "noise_weight")
    return xr.Dataset(
        {
            "mean_upper_error": ((*where, "condition", "seed"), error, {"units": "deg"}),
            "effort": (
                (*where, "condition"),
                effort,
                {"units": "1", "long_name": "root mean square control increment over half the travel"},
            ),
            "tube_size": (where, size, {"units": "deg", "long_name": "Eq. 18 of the half-widths, mean over beats"}),
            "feasible_beats": (where, feasible),
        },
        coords={
            "shape": list(SHAPES),
            "limits": list(LIMITS),
            "noise_weight": list(NOISE_WEIGHTS),
            "condition": list(FLOWN),
            "seed": list(bench.seeds),
        },
    )


def _tube_size(tubes: compensation.Tubes) -> float:
    """Eq. 18 of the half-widths at the end of a beat, mean over the beats (deg)."""
    squares = np.zeros(len(tubes.terminal_rho))
    for place, part in enumerate(tubes.parts):
        widths = ellipsoid.half_widths(tubes.terminal_shape[:, place], tubes.terminal_rho[:, place])
        squares += np.sum((widths * METRIC_SCALE[list(part.errors)]) ** 2, axis=-1)
    return float(np.nanmean(np.sqrt(squares / 8.0)))


def _effort(bench: Bench, flown: Flights) -> float:
    aircraft = bench.prepared.plant
    half_travel = 0.5 * (aircraft.control_upper - aircraft.control_lower)
    moved = (flown.control - bench.prepared.nominal.controls) / half_travel
    return float(np.sqrt(np.mean(moved**2)))


def _figure(dataset: xr.Dataset) -> Figure:
    figure = new_figure(16, 5.2, "What the noise weight ν (the numbers at points), the shape and the limits buy")
    figure.subplots_adjust(left=0.05, right=0.99, bottom=0.21, top=0.87, wspace=0.2)
    error = dataset["mean_upper_error"].mean("seed")
    panels = figure.subplots(1, 3)
    for place, (shape, limits) in enumerate(itertools.product(SHAPES, LIMITS)):
        at = {"shape": shape, "limits": limits}
        label = f"{shape}, limits on the {limits}"
        style = {"color": COLOURS[place], "linestyle": DASHES[place], "marker": "o", "markersize": 4, "label": label}
        effort = dataset["effort"].sel(at)
        errors = error.sel(at)
        curves = [(effort.sel(condition=name).values, errors.sel(condition=name).values) for name in FLOWN]
        curves.append((dataset["tube_size"].sel(at).values, errors.sel(condition=NOISE).values))
        for axes, (across, up) in zip(panels, curves, strict=True):
            axes.plot(across, up, **style)
            for weight, x, y in zip(NOISE_WEIGHTS, across, up, strict=True):
                if weight in (NOISE_WEIGHTS[0], NOISE_WEIGHTS[-1], 1.0):
                    axes.annotate(
                        f"{weight:g}",
                        (x, y),
                        fontsize=8,
                        color=COLOURS[place],
                        xytext=_ASIDE[place],
                        textcoords="offset points",
                    )
    flown = (f"({letter}) {CONDITION_WORDS[name]}" for letter, name in zip("ab", FLOWN, strict=True))
    titles = (*flown, "(c) sensor noise, over the tube of one beat")
    for axes, title in zip(panels, titles, strict=True):
        axes.set_title(title, fontsize=10, loc="left")
        axes.set_xlabel(
            "control effort (–)" if title[1] != "c" else "tube size, Eq. 18 of half-widths (deg)", fontsize=9
        )
        axes.set_ylabel("mean upper error, Eq. 18 (deg)", fontsize=9)
        axes.tick_params(labelsize=8)
        axes.grid(True, color="#DDDDDD", linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=4, fontsize=9, frameon=False)
    return figure


def _table(dataset: xr.Dataset) -> Table:
    rows = []
    for shape, limits, weight in itertools.product(SHAPES, LIMITS, NOISE_WEIGHTS):
        at = dataset.sel(shape=shape, limits=limits, noise_weight=weight)
        errors = (float(at["mean_upper_error"].sel(condition=name).mean()) for name in FLOWN)
        efforts = (float(at["effort"].sel(condition=name)) for name in FLOWN)
        numbers = (f"{value:.3f}" for value in (*errors, *efforts, float(at["tube_size"])))
        rows.append((shape, limits, f"{weight:g}", *numbers, str(int(at["feasible_beats"]))))
    head = (
        "shape",
        "limits",
        "ν",
        *(f"error, {CONDITION_WORDS[name]} (deg)" for name in FLOWN),
        *(f"effort, {CONDITION_WORDS[name]}" for name in FLOWN),
        "tube size (deg)",
        "feasible beats",
    )
    return Table("All choices", head, tuple(rows))
