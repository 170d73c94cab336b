"""Compensation beside other methods, on the same draws: who wins, and where."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from aerotube.results import CALM, CONDITION_WORDS, ESTIMATOR, KEY_SUFFIX, NOISE
from aerotube.studies.bench import CONDITIONS, Bench
from aerotube.studies.methods_entered import (
    AIR,
    LIBRARY_SEED,
    LIBRARY_SIZE,
    METHODS,
    SATURATION,
    SWEEP_SEEDS,
    Entered,
    enter_all,
    gusts_in,
)
from aerotube.studies.methods_figure import methods_figure
from aerotube.studies.outcome import Compared, Outcome, Table, compare
from aerotube.studies.statistics import LEVEL, paired, spread

if TYPE_CHECKING:
    import xarray as xr

FACTORS = (1.0, 1.5, 2.0)

OURS = ("compensation", "coupled", "saturating")


def study(bench: Bench) -> Outcome:
    """Fly all methods in all conditions."""
    entered = enter_all(bench)
    dataset = _fly(bench, entered)
    error = dataset["mean_upper_error"]
    rows = [row for condition in CONDITIONS for row in _rows(error, condition)]
    return Outcome(
        dataset=dataset,
        figure=methods_figure(dataset, METHODS, AIR),
        caption=(
            "Mean upper error (Eq. 18, mean over the seeds ± sd) of all methods on the same draws, over the size "
            "of the disturbances as a multiple of what was designed for. Bars that are cut off are labelled."
        ),
        compared=tuple(rows),
        verdict=_verdict(error),
        notes=_NOTES,
        tables=(_table(dataset), _strays(dataset), _made(entered)),
    )


_NOTES = (
    "The paper sets these methods side by side in words only (its Table 1): it has no numbers to compare with.",
    "Every method flies on the same draws. LQR and dynamic inversion are chosen, by a sweep on the first "
    f"{SWEEP_SEEDS} seeds, anew for each condition and each air, at the size designed for, and flown unchanged "
    "under larger disturbances. Those seeds are among the ones that count. Ours is as the scenario sets it, "
    "whatever the air.",
    "All commands are cut off at the control limits in flight. Our coupled and decoupled laws hold the limits by "
    "design, on the whole disturbance set; that costs them some tracking, which a clipped LQR does not pay. The "
    f"saturating law may ask for {SATURATION:g} times its limits there, and the cut is part of the closed loop "
    "whose tube is measured.",
    "Dynamic inversion knows the aircraft exactly, but for the mass, the gusts and what it measures.",
    f"The library holds our laws for {LIBRARY_SIZE} manoeuvres that start near the nominal (seed {LIBRARY_SEED}); the "
    "nominal itself is not among them.",
    "Larger disturbances: initial errors, sensor noise and mass error all times the factor, laws and estimator as "
    "designed for the factor 1.",
)


def _fly(bench: Bench, entered: dict[tuple[str, str, str], Entered]) -> xr.Dataset:
    import xarray as xr

    grid = (len(METHODS), len(CONDITIONS), len(AIR), len(FACTORS))
    error = np.empty((*grid, len(bench.seeds)))
    diverged, outside = np.zeros(grid, int), np.zeros(grid, int)
    total, done = int(np.prod(grid)), 0
    for f, factor in enumerate(FACTORS):
        draws = bench.scaled_draws(factor)
        for (a, air), (c, condition), (m, method) in itertools.product(
            enumerate(AIR), enumerate(CONDITIONS), enumerate(METHODS)
        ):
            bench.tell(f"flights, {AIR[air]}, disturbances times {factor:g}", 0.4 + 0.6 * done / total)
            done += 1
            at = m, c, a, f
            if method == "none" and c > 0:
                same = m, 0, a, f
                error[at], diverged[at], outside[at] = error[same], diverged[same], outside[same]
                continue
            law = entered[method, condition, air].law
            flown = bench.fly(law, condition, draws=draws, gusts=gusts_in(bench, air))
            error[at] = flown.mean_upper_error()
            diverged[at], outside[at] = len(flown.diverged), int(flown.outside.sum())
    where = ("controller", "condition", "air", "factor")
    return xr.Dataset(
        {
            "mean_upper_error": (
                (*where, "seed"),
                error,
                {"units": "deg", "long_name": "mean over time of the largest Eq. 18 over the runs of a seed"},
            ),
            "diverged_runs": (where, diverged),
            "outside_runs": (where, outside),
        },
        coords={
            "controller": list(METHODS),
            "condition": list(CONDITIONS),
            "air": list(AIR),
            "factor": ("factor", list(FACTORS), {"long_name": "disturbances over those designed for"}),
            "seed": list(bench.seeds),
        },
    )


def _rows(error: xr.DataArray, condition: str) -> list[Compared]:
    """All methods as designed for, in still air."""
    cell = error.sel(condition=condition, air="still", factor=1.0)
    order = [str(name) for name in cell["controller"].values[np.argsort(cell.mean("seed").values)]]
    return [
        compare(
            f"{method}{KEY_SUFFIX[condition]}",
            f"mean upper error, {METHODS[method]}, {CONDITION_WORDS[condition]}",
            None,
            cell.sel(controller=method).values,
            verdict=f"place {order.index(method) + 1} of {len(order)}",
        )
        for method in METHODS
    ]


def _winner(cell: xr.DataArray) -> tuple[str, bool]:
    """The best method of a cell, and whether the paired t-test tells it from the next one."""
    order = [str(name) for name in cell["controller"].values[np.argsort(cell.mean("seed").values)]]
    first, second = (cell.sel(controller=name).values for name in order[:2])
    clear = first.size > 1 and paired(first, second) < LEVEL
    return order[0], clear


def _verdict(error: xr.DataArray) -> str:
    names = {condition: _winner(error.sel(condition=condition, air="still", factor=1.0)) for condition in CONDITIONS}
    words = {
        CALM: "without sensor noise",
        NOISE: "with noise straight to the law",
        ESTIMATOR: "behind an estimator",
    }
    told = "; ".join(
        f"{words[condition]} {METHODS[name]}" + ("" if clear else " (not significantly)")
        for condition, (name, clear) in names.items()
    )
    cases = list(itertools.product(CONDITIONS, AIR, FACTORS))
    ours = sum(_winner(error.sel(condition=c, air=a, factor=f))[0] in OURS for c, a, f in cases)
    return f"Who wins in still air as designed for: {told}. One of ours wins {ours} of {len(cases)} cases in all."


def _table(dataset: xr.Dataset) -> Table:
    error, rows = dataset["mean_upper_error"], []
    for air, condition, factor in itertools.product(AIR, CONDITIONS, FACTORS):
        cell = error.sel(air=air, condition=condition, factor=factor)
        best, clear = _winner(cell)
        cells = (spread(cell.sel(controller=method).values) for method in METHODS)
        wins = METHODS[best] + ("" if clear else " (not significantly)")
        rows.append((AIR[air], CONDITION_WORDS[condition], f"{factor:g}", *cells, wins))
    head = ("air", "condition", "factor", *METHODS.values(), "wins (paired t-test against the next, 5 %)")
    return Table("Mean upper error (deg), mean over the seeds ± sd", head, tuple(rows))


def _made(entered: dict[tuple[str, str, str], Entered]) -> Table:
    rows = tuple(
        (METHODS[method], CONDITION_WORDS[condition], AIR[air], one.words)
        for (method, condition, air), one in entered.items()
        if one.words and not (method == "library" and air != "still")
    )
    return Table("How the baselines were chosen", ("method", "condition", "air", "what is flown"), rows)


def _strays(dataset: xr.Dataset) -> Table:
    rows = []
    for air, condition, factor in itertools.product(AIR, CONDITIONS, FACTORS):
        cell = dataset.sel(air=air, condition=condition, factor=factor)
        counts = [
            (int(cell["diverged_runs"].sel(controller=method)), int(cell["outside_runs"].sel(controller=method)))
            for method in METHODS
        ]
        if any(a or b for a, b in counts):
            rows.append((AIR[air], CONDITION_WORDS[condition], f"{factor:g}", *(f"{a}, {b}" for a, b in counts)))
    if not rows:
        rows.append(("none", *[""] * (2 + len(METHODS))))
    head = ("air", "condition", "factor", *METHODS.values())
    return Table("Runs that diverged, and runs that left the aircraft's tables at some time", head, tuple(rows))
