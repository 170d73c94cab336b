"""What speaks for a law besides its tubes: margins of its loops, and how flights kept to the tubes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from aerotube.flight import FORMS, REASONS
from aerotube.results.record import CONTROLS, Law, Record
from aerotube.verify import Margins, gain_margin, phase_margin

if TYPE_CHECKING:
    import xarray as xr

_MARGINS = {
    "disk_margin": ("disk", "1", "disk margin (balanced) of the frozen loop at each control, the others closed"),
    "margin_frequency": ("frequency", "rad/s", "where the disk margin is attained"),
    "delay_margin": ("delay", "s", "delay margin of the frozen loop at each control, the others closed"),
}
_MARGINS_ALL = {
    "disk_margin_all": ("disk_all", "1", "disk margin with independent factors in all controls at once, lower bound"),
    "margin_frequency_all": ("frequency_all", "rad/s", "where the disk margin of all controls is attained"),
    "delay_margin_all": ("delay_all", "s", "delay that all controls may have, each its own, lower bound"),
    "loop_radius": ("radius", "1", "largest modulus of the frozen loop's poles; margins are zero from one on"),
}


def put_margins(dataset: xr.Dataset, laws: Mapping[str, Law]) -> None:
    """Label the margins of all laws, if they have any."""
    found: list[Margins | None] = [law.margins for law in laws.values()]
    if any(margins is None for margins in found):
        return
    for table, dims in ((_MARGINS, ("law", "beat", "control")), (_MARGINS_ALL, ("law", "beat"))):
        for name, (attribute, unit, words) in table.items():
            values = np.stack([getattr(margins, attribute) for margins in found])
            dataset[name] = (dims, values, {"units": unit, "long_name": words})


def put_containment(dataset: xr.Dataset, record: Record) -> None:
    """Label how the flights of the compensated aircraft kept to their tubes, for the conditions flown."""
    cases = {name: record.cases.get(("compensated", name)) for name in record.conditions}
    counts = {name: case.containment for name, case in cases.items() if case is not None and case.containment}
    if not counts:
        return
    beats, parts = len(record.nominal_controls), len(next(iter(record.laws.values())).parts)
    dataset.coords["reason"] = ("reason", list(REASONS), {"long_name": "why a beat does not start inside"})
    dataset.coords["form"] = ("form", list(FORMS), {"long_name": "size in the metric, or terminal ellipsoid"})
    shapes: dict[str, tuple[tuple[str, ...], tuple[int, ...], str]] = {
        "flown": ((), (), "runs that had not diverged at the start of the beat"),
        "inside": ((), (), "of those, runs that started the beat inside every set of its tubes"),
        "outside": (("reason",), (len(REASONS),), "runs that did not, by reason; a run may have several"),
        "violated": (
            ("part", "form"),
            (parts, len(FORMS)),
            "of the runs that started inside, those ended outside",
        ),
        "worst": (("part", "form"), (parts, len(FORMS)), "largest size at the end over the tube's, of those inside"),
    }
    for name, (dims, lengths, words) in shapes.items():
        kind = float if name == "worst" else np.int64
        values = np.full((len(record.conditions), beats, *lengths), np.nan if kind is float else 0, dtype=kind)
        for condition, counted in counts.items():
            values[record.conditions.index(condition)] = getattr(counted, name)
        dataset[f"containment_{name}"] = (("condition", "beat", *dims), values, {"units": "1", "long_name": words})
    dataset["containment_counted"] = ("condition", [name in counts for name in record.conditions])


def summarise_margins(dataset: xr.Dataset, law: str) -> dict[str, Any] | None:
    """Worst margins of a law over the beats, in the units in which they are told; None without any.

    Returns
    -------
    dict or None
        ``unstable_beats``: beats whose frozen loop is not stable by itself, which are left out of the rest. For each
        control and for ``all``: ``disk``, ``gain_db`` (either way), ``phase_deg``, ``at_beat``, and ``delay_ms`` with
        ``delay_at_beat`` (None where no delay does harm).
    """
    if "disk_margin" not in dataset:
        return None
    chosen = dataset.sel(law=law)
    stable = chosen["loop_radius"].values < 1.0
    out: dict[str, Any] = {"unstable_beats": int((~stable).sum())}
    columns = {
        name: (chosen["disk_margin"].values[:, i], chosen["delay_margin"].values[:, i])
        for i, name in enumerate(CONTROLS)
    }
    columns["all"] = chosen["disk_margin_all"].values, chosen["delay_margin_all"].values
    for name, (disk, delay) in columns.items():
        if not stable.any():
            out[name] = None
            continue
        worst = int(np.where(stable, disk, np.inf).argmin())
        late = int(np.where(stable, delay, np.inf).argmin())
        gain = float(20.0 * np.log10(gain_margin(disk[worst])[1])) if disk[worst] < 2.0 else None
        out[name] = {
            "disk": float(disk[worst]),
            "gain_db": gain,
            "phase_deg": float(np.degrees(phase_margin(disk[worst]))),
            "at_beat": worst,
            "delay_ms": 1e3 * float(delay[late]) if np.isfinite(delay[late]) else None,
            "delay_at_beat": late,
        }
    return out


def summarise_containment(dataset: xr.Dataset) -> dict[str, Any]:
    """How flights kept to their tubes, by condition.

    Returns
    -------
    dict
        For each condition counted: ``beats`` of all runs, ``started_inside`` of them, ``outside`` for each reason,
        ``violations`` for each part and form, and ``worst`` sizes over the tube's (None where there are none).
    """
    if "containment_flown" not in dataset:
        return {}
    out = {}
    for condition in dataset["condition"].values:
        chosen = dataset.sel(condition=condition)
        if not bool(chosen["containment_counted"]):
            continue
        violated = chosen["containment_violated"].sum("beat")
        worst = chosen["containment_worst"].max("beat")
        names = [(str(part), str(form)) for part in dataset["part"].values for form in dataset["form"].values]
        sizes = {pair: float(worst.sel(part=pair[0], form=pair[1])) for pair in names}
        out[str(condition)] = {
            "beats": int(chosen["containment_flown"].sum()),
            "started_inside": int(chosen["containment_inside"].sum()),
            "outside": {
                str(reason): int(chosen["containment_outside"].sel(reason=reason).sum())
                for reason in dataset["reason"].values
            },
            "violations": {f"{part}, {form}": int(violated.sel(part=part, form=form)) for part, form in names},
            "worst": {f"{part}, {form}": _finite(sizes[part, form]) for part, form in names},
        }
    return out


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
