"""Fig. 11: time to compute a law, with and without decoupling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from aerotube.results import CALM
from aerotube.studies.bench import Bench
from aerotube.studies.outcome import Outcome, compare
from aerotube.studies.timing import SOLVES, distributions_figure, solve_times


def study(bench: Bench) -> Outcome:
    """Time coupled and decoupled laws of single beats, on one thread."""
    import xarray as xr

    base, solves = bench.settings(CALM), min(SOLVES, max(bench.runs, 2))
    coupled = solve_times(bench, replace(base, algorithm="coupled"), "coupled laws", solves)
    halves, both = solve_times(bench, replace(base, algorithm="decoupled"), "decoupled laws", solves)
    milliseconds = {
        "in the solver: coupled": 1e3 * coupled[0][:, 0],
        "in the solver: longitudinal": 1e3 * halves[:, 0],
        "in the solver: lateral": 1e3 * halves[:, 1],
        "the whole command: coupled": 1e3 * coupled[1],
        "the whole command: decoupled, both halves": 1e3 * both,
    }
    paper = (61000.0, 94.0, 95.0, None, None)
    keys = ("coupled", "longitudinal", "lateral", "coupled_command", "decoupled_command")
    rows = []
    for key, (name, values), theirs in zip(keys, milliseconds.items(), paper, strict=True):
        words = f"{name.split(': ')[1]}, {name.split(': ')[0]}"
        rows.append(compare(f"{key}_median", f"median time, {words}", theirs, float(np.median(values)), "ms"))
        largest = {"longitudinal": 129.0, "lateral": 128.0}.get(key)
        rows.append(compare(f"{key}_largest", f"largest time, {words}", largest, float(values.max()), "ms"))
    medians = [float(np.median(values)) for values in milliseconds.values()]
    speedup = medians[0] / max(medians[1:3])
    rows.append(compare("speedup", "coupled over the slower half, in the solver", 61000.0 / 95.0, speedup, "1"))
    dataset = xr.Dataset(
        {
            "solve_time": (
                ("kind", "solve"),
                1e-3 * np.stack(list(milliseconds.values())),
                {"units": "s", "long_name": "time of one law, one thread"},
            )
        },
        coords={"kind": list(milliseconds), "solve": np.arange(solves)},
    )
    return Outcome(
        dataset=dataset,
        figure=distributions_figure(
            f"Time of one law: {solves} solves of each kind, one thread",
            milliseconds,
            2,
            ("in the solver", "the whole command"),
        ),
        caption="Distribution of times with and without decoupling (Fig. 11).",
        compared=tuple(rows),
        verdict=(
            f"A coupled law takes {medians[0]:.0f} ms in the solver, its halves {medians[1]:.1f} and "
            f"{medians[2]:.1f} ms, on one thread; the paper reports 61 s and 94 and 95 ms."
        ),
        notes=(
            "The paper solves with SOSTOOLS and SeDuMi under MATLAB, with a cubic Taylor polynomial and "
            "multipliers, on a Xeon Gold 6230; ours are programs on values at nodes of a sphere, without "
            "multipliers, in compiled code. Decoupling saves a smaller factor here because the coupled program is "
            "so much smaller.",
            "In the solver: from program data to the law. The whole command also linearises and forecasts the whole "
            "manoeuvre, samples the map and sets up the data; in flight most of that is shared by all beats. Tubes "
            "are measured apart and not counted.",
            "Times are of this machine and its present load; the files say which processor.",
        ),
    )
