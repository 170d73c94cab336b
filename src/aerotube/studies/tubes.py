"""Fig. 8: trajectory tubes with compensation and without; which states they shrink in."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from aerotube import compensation
from aerotube.compensation import SynthesisSettings
from aerotube.report import tubes_figure
from aerotube.report.tubes import PAIRS, projection
from aerotube.results import CALM
from aerotube.results.record import STATES
from aerotube.studies.bench import Bench
from aerotube.studies.outcome import Compared, Outcome, Table, compare
from aerotube.tube import ellipsoid
from aerotube.units import DISPLAY

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

#: What the paper reads off its Fig. 8 (its section 4.2.1).
PAPER = {
    "V": "unchanged",
    "alpha": "unchanged",
    "q": "shrinks",
    "theta": "unchanged",
    "beta": "unchanged",
    "p": "shrinks",
    "r": "shrinks",
    "phi": "unchanged",
}
_LAW = "noise_free"


def study(bench: Bench) -> Outcome:
    """Compare the extents of the tubes, state by state."""
    dataset = bench.results()
    figure = tubes_figure(dataset, _LAW)
    assert figure is not None  # the main job has tubes, or has failed
    extents = _extents(dataset)
    rows = [_row(name, closed / opened) for name, (opened, closed) in extents.items()]
    agree = [row for row in rows if row.verdict.endswith("agrees")]
    shrunk = [DISPLAY[row.name].name for row in rows if row.ours is not None and row.ours < 0.9]
    return Outcome(
        dataset=_labelled(dataset, extents),
        figure=figure,
        caption=(
            "Tubes projected on two states over time, with compensation and without, and their half-widths (Fig. 8). "
            "Each beat starts from the whole disturbance set."
        ),
        compared=tuple(rows),
        verdict=(
            f"Within one beat the law shrinks the tube in {', '.join(shrunk) or 'no state'}; "
            f"{len(agree)} of 8 states change as in the paper."
        ),
        notes=_NOTES,
        tables=(_other_laws(bench),),
    )


_NOTES = (
    "The paper gives words, no numbers: a state counts as unchanged within 10 %. Ours is the half-width of the "
    "tube at the end of a beat with the law over that without, mean over the beats ± standard deviation over them.",
    "In one beat of 50 ms a control moves the rates; angles and airspeed follow only later. That is why tubes of one "
    "beat hardly change in them, here and in the paper.",
    "Our law makes small what an error left at the end of a beat will cost later on (cost-to-go), not the tube of the "
    "one beat. It may therefore widen the tube in a rate to be rid of an angle's error in the beats after it.",
    "The paper's objective, the least ρ with a free shape above a Riccati matrix, is reached by leaving the shape at "
    "that matrix: the terminal shape then says nothing about the tube. Ours are ellipsoids of least volume around "
    "what can be reached.",
)


def _extents(dataset: xr.Dataset) -> dict[str, tuple[Array, Array]]:
    """Half-widths of the tubes at the end of the beats, without the law and with it, in shown units."""
    found = {}
    for pair in PAIRS:
        tube = projection(dataset, _LAW, pair)
        for place, name in enumerate(pair):
            found[name] = tube.half_extent("nominal", place), tube.half_extent("terminal", place)
    return {name: found[name] for name in STATES}


def _labelled(dataset: xr.Dataset, extents: dict[str, tuple[Array, Array]]) -> xr.Dataset:
    kept = dataset.sel(law=_LAW)[
        ["initial_shape", "initial_rho", "terminal_shape", "terminal_rho", "nominal_shape", "nominal_rho", "size"]
    ]
    widths = np.stack([np.stack(pair, axis=-1) for pair in extents.values()], axis=1)
    factors = np.array([DISPLAY[name].factor for name in extents])
    kept["half_width"] = (
        ("beat", "state", "controller"),
        widths / factors[:, None],
        {"units": "SI, by state", "long_name": "half-width of the tube at the end of a beat"},
    )
    return kept.assign_coords(state=list(extents), controller=["none", "compensated"])


def _change(ratio: float) -> str:
    return "shrinks" if ratio < 0.9 else "widens" if ratio > 1.1 else "unchanged"


def _row(name: str, ratio: Array) -> Compared:
    ours = _change(float(ratio.mean()))
    agrees = "agrees" if ours == PAPER[name] else "differs"
    return compare(
        name, f"half-width in {DISPLAY[name].name}, with over without", None, ratio, "1",
        f"the paper: {PAPER[name]}; ours: {ours}: {agrees}",
    )  # fmt: skip


def _other_laws(bench: Bench) -> Table:
    """The same ratios for laws that make other sizes small."""
    base = bench.settings(CALM)
    others: dict[str, SynthesisSettings] = {
        "mean square, cost-to-go (ours)": base,
        "mean square, Riccati shape": replace(base, shape="riccati"),
        "worst case, Riccati shape (the paper's size and Eq. 8)": replace(base, size="worst-case", shape="riccati"),
        "increment form (Eq. 14 as the paper has it)": replace(
            base, formulation="increment", size="worst-case", shape="riccati"
        ),
    }
    rows = []
    for place, (words, wanted) in enumerate(others.items()):
        settings = replace(wanted, certificate=base.certificate)
        bench.tell("tubes of other laws", 0.6 + 0.1 * place)
        made, ready = bench.design(settings), bench.prepared
        tubes, _ = compensation.measure(
            ready.model, ready.nominal, ready.disturbance, made.law, made.metric, settings, workers=bench.workers
        )
        ratios = {}
        for part, known in enumerate(tubes.parts):
            closed = ellipsoid.half_widths(tubes.terminal_shape[:, part], tubes.terminal_rho[:, part])
            opened = ellipsoid.half_widths(tubes.nominal_shape[:, part], tubes.nominal_rho[:, part])
            for place_in_part, error in enumerate(known.errors):
                ratios[STATES[error]] = float(np.nanmean(closed[:, place_in_part] / opened[:, place_in_part]))
        rows.append((words, *(f"{ratios[name]:.2f}" for name in STATES)))
    head = ("half-width with the law over without", *(DISPLAY[name].symbol for name in STATES))
    return Table("The same for laws that make other sizes small (mean over the beats)", head, tuple(rows))
