"""Fig. 17 and Table 3: which nominal states and controls the law depends on."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from aerotube import compensation
from aerotube.aircraft.rigid_body import velocity_from_flow
from aerotube.compensation import SynthesisSettings
from aerotube.compensation.groundwork import check_reach
from aerotube.dynamics import ErrorCoordinates
from aerotube.errors import ComputationError
from aerotube.nominal import Nominal, constant_controls
from aerotube.numerics import quaternion_from_euler
from aerotube.report.style import new_figure
from aerotube.results import CALM
from aerotube.results.record import CONTROLS, STATES
from aerotube.studies.bench import Bench
from aerotube.studies.outcome import Compared, Outcome, Table, compare
from aerotube.studies.statistics import LEVEL, welch
from aerotube.units import DISPLAY

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

INPUTS = (*STATES, *CONTROLS)

#: Table 3 of the paper: ranges of nominal states and controls (m/s, deg, deg/s, throttle 0 to 1).
TABLE_3 = {
    "V": (200.0, 350.0),
    "alpha": (-10.0, 25.0),
    "q": (-30.0, 30.0),
    "theta": (-60.0, 60.0),
    "beta": (-10.0, 10.0),
    "p": (-50.0, 50.0),
    "r": (-10.0, 10.0),
    "phi": (-90.0, 90.0),
    "elevator": (-15.0, 15.0),
    "throttle": (0.2, 0.8),
    "aileron": (-15.0, 15.0),
    "rudder": (-25.0, 25.0),
}

#: What the paper finds most influential for each control (its section 4.7).
PAPER = {
    "elevator": ("V", "alpha"),
    "throttle": ("alpha", "q"),
    "aileron": ("beta", "r", "phi", "aileron", "rudder"),
    "rudder": ("rudder",),
}

#: Pairs of random nominals, those also tried with the paper's objective, and the seed of their draw.
PAIRS, WORST_CASE_PAIRS, SEED = 100, 30, 17

_FACTORS = np.array([DISPLAY[name].factor for name in INPUTS])


def study(bench: Bench) -> Outcome:
    """Change one nominal input at a time and see how far the law's coefficients move."""
    pairs = min(PAIRS, max(bench.runs, 3))
    base = replace(bench.settings(CALM), shape="riccati")
    settings = {"mean-square": base, "worst-case": replace(base, size="worst-case")}
    points, rejected = _points(bench, pairs)
    moved = {}
    for place, (size, chosen) in enumerate(settings.items()):
        moved[size] = _coefficient_changes(bench, points, chosen, 0.8 * place, 0.8 if place == 0 else 0.2)
    changes = moved["mean-square"]
    if not np.isfinite(changes).all(axis=(1, 2)).any():
        raise ComputationError("sensitivity: no pair of nominals has laws on both sides")
    orders = {name: _ranking(changes[..., c]) for c, name in enumerate(CONTROLS)}
    influential = [(control, name) for control in CONTROLS for name in PAPER[control]]
    agree = [name for control, name in influential if name in orders[control][:5]]
    return Outcome(
        dataset=_dataset(moved, points, rejected),
        figure=_figure(changes, pairs),
        caption=(
            f"Change ΔC of the law's coefficients when one nominal input is replaced, mean over {pairs} pairs of "
            "random nominals and its 95 % interval (Fig. 17). Dark: what the paper names as most influential."
        ),
        compared=tuple(_rows(changes, orders)),
        verdict=(
            "Most influential: "
            + ", ".join(f"{DISPLAY[orders[c][0]].name} for the {DISPLAY[c].name}" for c in CONTROLS)
            + f". Of the {len(influential)} inputs that the paper names, {len(agree)} are among our first five."
        ),
        notes=(
            *_NOTES,
            f"{rejected} pairs were drawn again because a nominal, or an error its tube begins with, left "
            "the aircraft's tables.",
        ),
        tables=(_table(changes, orders), _other_size(moved)),
    )


def _dataset(moved: dict[str, Array], points: Array, rejected: int) -> xr.Dataset:
    import xarray as xr

    changes = moved["mean-square"]
    return xr.Dataset(
        {
            "change": (
                ("size", "pair", "input", "control"),
                np.stack(list(moved.values())),
                {"units": "1", "long_name": "mean absolute change of the law's coefficients, by range of the control"},
            ),
            "p_value": (
                ("control", "input", "other"),
                np.stack([_p_values(changes[..., c]) for c in range(4)]),
                {"units": "1", "long_name": "Welch's t-test of equal mean change, mean-square laws"},
            ),
            "nominal": (("point", "pair", "input"), points / _FACTORS, {"units": "SI"}),
        },
        coords={
            "size": list(moved),
            "input": list(INPUTS),
            "other": list(INPUTS),
            "control": list(CONTROLS),
            "point": ["first", "second", *(f"first with {name} of the second" for name in INPUTS)],
        },
        attrs={"draw_seed": SEED, "rejected_pairs": rejected},
    )


def _rows(changes: Array, orders: dict[str, list[str]]) -> list[Compared]:
    """Every input of every control, beside what the paper names."""
    rows = []
    for c, control in enumerate(CONTROLS):
        mean = np.nanmean(changes[..., c], axis=0)
        for i, name in enumerate(INPUTS):
            place = orders[control].index(name) + 1
            named = "among the paper's most influential" if name in PAPER[control] else "not named by the paper"
            words = f"{DISPLAY[control].name}: change of the law with the nominal {DISPLAY[name].name}"
            values = changes[:, i, c][np.isfinite(changes[:, i, c])]
            told = f"place {place} of 12; {named}"
            rows.append(compare(f"{control}_{name}", words, None, values / mean.max(), "of the largest", told))
    return rows


_NOTES = (
    "The paper says ΔC = C₁ − C₂ for two sets of 100 random nominals, not how a change is laid to one input. Here the "
    "law of each nominal of the first set is compared with that of the same nominal with one input taken from its "
    "partner in the second set: twelve changes a pair. ΔC is the mean absolute change of a control's coefficients, "
    "errors measured by their disturbance ranges and controls by their travel (thrust by 50 kN).",
    "The objective is the mean square, whose law is unique. The paper's, the least worst case, leaves the "
    "coefficients undetermined except along the worst direction: the second table shows the same study with it, "
    "where part of the ΔC is nothing but the solver's choice.",
    "The F-16's engine tables end at Mach 1: of Table 3's airspeeds only those below 328 m/s (at 3 km) are flown.",
    "Each law is of one beat, its size measured in the Riccati shape of Eq. 8, since random nominals have no "
    "manoeuvre to look ahead along.",
)

_THRUST_RANGE = 50e3  # N


def _points(bench: Bench, pairs: int) -> tuple[Array, int]:
    """Nominals: the first set, the second, and the first with one input after the other of the second.

    Returns
    -------
    points : ndarray (14, pair, 12)
        In shown units.
    rejected : int
        Pairs drawn in vain.
    """
    low, high = np.array([TABLE_3[name] for name in INPUTS]).T
    generator = np.random.Generator(np.random.Philox(np.random.SeedSequence(SEED)))
    kept: list[Array] = []
    rejected = 0
    while len(kept) < pairs:
        first, second = generator.uniform(low, high, (2, 12))
        mixed = np.where(np.eye(12, dtype=bool), second, first)
        points = np.concatenate([first[None], second[None], mixed])
        if all(_inside(bench, point) for point in points):
            kept.append(points)
        else:
            rejected += 1
        if rejected > 1000 + 100 * pairs:
            raise ComputationError("sensitivity: hardly any nominal of Table 3 stays inside the aircraft's model")
    return np.stack(kept, axis=1), rejected


def _nominal(bench: Bench, point: Array) -> Nominal:
    """One beat from a point."""
    ready = bench.prepared
    V, alpha, q, theta, beta, p, r, phi, *control = point / _FACTORS
    attitude = quaternion_from_euler(phi, theta, 0.0)
    altitude = ready.nominal.states[0, 12]
    state = np.array([*velocity_from_flow(V, alpha, beta), *attitude, p, q, r, 0.0, 0.0, altitude])
    return constant_controls(ready.model, state, np.array(control), ready.nominal.dt, 1)


def _inside(bench: Bench, point: Array) -> bool:
    ready, settings = bench.prepared, bench.settings(CALM)
    try:
        nominal = _nominal(bench, point)
        nominal.check(ready.model)
        check_reach(ready.model, nominal.states[:-1], ErrorCoordinates(settings.attitude), ready.disturbance, settings)
    except (ValueError, ComputationError):
        return False
    return True


def _coefficient_changes(
    bench: Bench, points: Array, settings: SynthesisSettings, before: float, weight: float
) -> Array:
    """Mean absolute change of each control's coefficients: ndarray (pair, input, control), NaN without a law."""
    ready = bench.prepared
    travel = ready.model.control_upper - ready.model.control_lower
    span = np.where(np.arange(4) == 1, _THRUST_RANGE, travel)
    widths = ready.disturbance.half_widths

    def coefficients(point: Array) -> Array:
        try:
            made = compensation.design(ready.model, _nominal(bench, point), ready.disturbance, settings)
        except ComputationError:
            return np.full((4, 8), np.nan)
        gains = made.law.gains[0] * widths / span[:, None]
        return np.where(made.feasible.all(), gains, np.nan)

    found = np.full((points.shape[1], 12, 4), np.nan)
    pairs = points.shape[1] if settings.size == "mean-square" else min(points.shape[1], WORST_CASE_PAIRS)
    wanted = [0, *range(2, 14)]  # the second set serves to replace from
    with ThreadPoolExecutor(bench.workers) as pool:
        for pair in range(pairs):
            bench.tell(f"{settings.size} laws of random nominals", before + weight * pair / pairs)
            laws = np.stack(list(pool.map(coefficients, points[wanted, pair])))
            found[pair] = np.abs(laws[1:] - laws[0]).sum(axis=-1) / 4.0  # a half has four errors
    return found


def _p_values(change: Array) -> Array:
    """Welch's t-tests between all inputs: ndarray (12, 12)."""
    sound = change[np.isfinite(change).all(axis=1)]
    out = np.ones((12, 12))
    for i in range(12):
        for j in range(i):
            out[i, j] = out[j, i] = welch(sound[:, i], sound[:, j]).p
    return out


def _ranking(change: Array) -> list[str]:
    return [INPUTS[i] for i in np.argsort(-np.nanmean(change, axis=0))]


def _table(changes: Array, orders: dict[str, list[str]]) -> Table:
    rows = []
    for c, control in enumerate(CONTROLS):
        p = _p_values(changes[..., c])
        leader = INPUTS.index(orders[control][0])
        level = [DISPLAY[name].symbol for name in orders[control] if p[leader, INPUTS.index(name)] >= LEVEL]
        mean = np.nanmean(changes[..., c], axis=0)
        ranked = ", ".join(f"{DISPLAY[n].symbol} {mean[INPUTS.index(n)] / mean.max():.2f}" for n in orders[control][:6])
        paper = ", ".join(DISPLAY[name].symbol for name in PAPER[control])
        tested = ", ".join(level)
        rows.append((DISPLAY[control].name, ranked, tested, paper))
    head = (
        "control",
        "ours: the six most influential, relative to the first",
        "not told from the first by Welch's t-test (5 %)",
        "the paper's most influential",
    )
    return Table("Ranking", head, tuple(rows))


def _other_size(moved: dict[str, Array]) -> Table:
    rows = []
    for c, control in enumerate(CONTROLS):
        cells = []
        for changes in moved.values():
            mean = np.nanmean(changes[..., c], axis=0)
            order = _ranking(changes[..., c])[:4]
            cells.append(", ".join(f"{DISPLAY[n].symbol} {mean[INPUTS.index(n)] / mean.max():.2f}" for n in order))
        medians = [float(np.nanmedian(changes[..., c])) for changes in moved.values()]
        rows.append((DISPLAY[control].name, *cells, f"{medians[1] / medians[0]:.1f}"))
    head = ("control", *(f"{size} laws" for size in moved), "median ΔC, worst-case over mean-square")
    return Table(f"The same with the paper's objective ({WORST_CASE_PAIRS} pairs)", head, tuple(rows))


_COLOURS = {"#0072B2": "named by the paper as influential", "#9ecae1": "others"}


def _figure(changes: Array, pairs: int) -> Figure:
    from matplotlib.patches import Patch

    figure = new_figure(15, 7.5, f"Change of the law's coefficients with each nominal input ({pairs} pairs)")
    figure.subplots_adjust(left=0.06, right=0.99, bottom=0.11, top=0.9, hspace=0.4, wspace=0.14)
    for axes, letter, (c, control) in zip(figure.subplots(2, 2).ravel(), "abcd", enumerate(CONTROLS), strict=True):
        values = changes[..., c][np.isfinite(changes[..., c]).all(axis=1)]
        mean, half = values.mean(axis=0), 1.96 * values.std(axis=0, ddof=1) / np.sqrt(len(values))
        named, other = _COLOURS
        colours = [named if name in PAPER[control] else other for name in INPUTS]
        axes.bar(np.arange(12), mean, 0.7, yerr=np.minimum(half, 0.95 * mean), color=colours, capsize=3)
        axes.set_yscale("log")
        axes.set_xticks(np.arange(12), [DISPLAY[name].symbol for name in INPUTS])
        axes.set_title(f"({letter}) {DISPLAY[control].name}", fontsize=10, loc="left")
        axes.set_ylabel("ΔC (–)", fontsize=9)
        axes.tick_params(labelsize=9)
        axes.grid(True, axis="y", color="#DDDDDD", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    handles = [Patch(color=colour, label=label) for colour, label in _COLOURS.items()]
    figure.legend(handles=handles, loc="lower center", ncols=2, fontsize=9, frameon=False)
    return figure
