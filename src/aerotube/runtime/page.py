"""What a flight leaves behind: the log, ``fly.json``, figures and a page that opens offline."""

from __future__ import annotations

import json
from dataclasses import asdict
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aerotube.report.template import fill, picture
from aerotube.results import ensure_folder, whole_file, write_json, write_text
from aerotube.runtime import log
from aerotube.runtime.limits import what_limits
from aerotube.runtime.outcome import summarise
from aerotube.runtime.pictures import flight_figure, timeline_figure
from aerotube.runtime.words import broken_off, duration, injected, promised

if TYPE_CHECKING:
    import xarray as xr

    from aerotube.runtime.flight import Flown

_DOTS_PER_INCH = 100
_BOLD = ' style="font-weight: bold"'
_PAPERS = 1.0 - 0.25 / 1.21  # reduction of the mean absolute error
_KINDS = {
    "anytime": "flew the any-time answer: the law as it stood at the solver's deadline, certified as it is",
    "last": "flew the law of an earlier beat or manoeuvre, certified for this one too",
    "lqr": "flew the gain of the linear-quadratic regulator, not certified",
    "nominal": "flew the nominal control alone",
    "predicted_state": "had no measurement in time, or none that was believed: the model carried the last one on",
    "no_state": "had neither: the nominal control alone",
    "no_command": "were passed over: their measurement was lost and their moment gone",
}
_CERTIFICATES = {
    "rigorous": "a rigorous certificate: the aircraft's map over the whole set does not exceed its tube",
    "sampled": "a sampled certificate: independent samples of the set, flown, and a search from the worst of them",
    "polynomial only": "a certificate for the polynomial through the closed loop at the programs' nodes only",
    "solver's word": "the solver's word only",
    "none": "none: an uncertified law, none at all, or no measurement of the beat's own",
}


def save(flown: Flown, folder: str | Path) -> dict[str, Any]:
    """Write ``flight.nc``, ``fly.json``, ``figures/`` and ``report.html``.

    Parameters
    ----------
    flown : Flown
    folder : str or Path
        Made if it is not there.

    Returns
    -------
    dict
        The contents of ``fly.json``.
    """
    target = ensure_folder(folder)
    summary = summarise(flown)
    dataset = log.to_dataset(flown)
    dataset.attrs["limits"] = json.dumps([asdict(limit) for limit in what_limits(flown)])
    log.write(dataset, target / "flight.nc")
    write_json(target / "fly.json", summary)
    if dataset.sizes["beat"]:
        write_text(target / "report.html", build(dataset, draw(dataset, target / "figures")))
    return summary


def draw(dataset: xr.Dataset, folder: Path) -> dict[str, Path]:
    """Draw the figures of a log that it has data for; the PNG files by name."""
    folder.mkdir(parents=True, exist_ok=True)
    files = {}
    for name, figure in (("fig15_timeline", timeline_figure(dataset)), ("fig16_flight", flight_figure(dataset))):
        path = folder / f"{name}.png"
        if figure is None:
            path.unlink(missing_ok=True)  # of an earlier flight in the same folder
            continue
        with whole_file(path) as aside:
            figure.savefig(aside, format="png", dpi=_DOTS_PER_INCH)
        files[name] = path
    return files


def build(dataset: xr.Dataset, figures: dict[str, Path]) -> str:
    """Build the page of a flight's log.

    Parameters
    ----------
    dataset : xarray.Dataset
    figures : dict of Path
        As :func:`draw` gives them.

    Returns
    -------
    str
        HTML.
    """
    summary, options = (json.loads(str(dataset.attrs[key])) for key in ("summary", "options"))
    version = str(dataset.attrs.get("aerotube_version", ""))
    sections = [
        ("tracking", "States and controls", _tracking(figures)),
        ("limits", "What limits the tracking", _limits(dataset)),
        ("deadlines", "Deadlines", _deadlines(dataset, summary, figures)),
        ("certificates", "What stands behind the laws", _certificates(dataset, summary)),
        ("fallbacks", "Fallbacks and faults", _fallbacks(dataset, summary)),
        ("recomputation", "Recomputation", _recomputation(dataset, options)),
        ("options", "Options", _table(json.loads(str(dataset.attrs["options_flown"])))),
    ]
    return fill(
        title=f"Flight: {dataset.attrs.get('scenario_title', '')}",
        lead=(
            f"{summary['beats']} beats, {duration(summary)}, {options['speed']:g} s of it in one second of the "
            f"clock; flown {dataset.attrs.get('created', '')} with aerotube {version}."
        ),
        sections=sections,
        version=version,
        cards=_cards(summary),
    )


def _cards(summary: dict[str, Any]) -> str:
    cards = []
    for key, words in (("mae", "Mean absolute error"), ("rmse", "Root mean square error")):
        none, compensated = summary[key]["none"], summary[key]["compensated"]
        if none and compensated is not None:
            share = f"−{100 * (1 - compensated / none):.0f} %"
            cards.append((words, share, f"{none:.3f} → {compensated:.3f} (Eq. 18, deg)"))
    number, explained = str(summary["missed_deadlines"]), summary["missed_explained"]
    cards.append(
        (
            "Missed deadlines",
            number,
            f"of {summary['beats']} beats; {explained['fault']} by injected faults, {explained['machine']} by the "
            f"machine, {summary['missed_unexplained']} unexplained",
        )
    )
    span, factor = summary["latency_us"], summary["realtime_factor"]
    if span["median"] is not None:
        cards.append(("Measurement to command", f"{span['median']:.0f} µs", f"99th percentile {span['p99']:.0f} µs"))
    if factor is not None:
        spent = summary["window_ms"]
        took = "" if spent is None else f"; a whole one takes {spent['whole']:.0f} ms (median)"
        cards.append(("Real-time factor", f"{factor:.1f}", f"seconds flown for one of computing windows{took}"))
    return "".join(
        f'<div class="card"><div class="what">{escape(what)}</div><div class="number">{escape(number)}</div>'
        f'<div class="how">{escape(how)}</div></div>'
        for what, number, how in cards
    )


def _tracking(figures: dict[str, Path]) -> str:
    if "fig16_flight" not in figures:
        return "<p>The aircraft was another's: there is no log of its own states.</p>"
    words = "The first manoeuvre, with compensation and without (counterpart of the paper's Fig. 16)."
    return picture(figures["fig16_flight"], words)


def _limits(dataset: xr.Dataset) -> str:
    limits = json.loads(str(dataset.attrs.get("limits", "[]")))
    rows = "".join(
        f"<tr{_BOLD if one['mae_reduction'] >= _PAPERS else ''}>"
        f"<td>{escape(one['condition'])}</td>"
        f'<td class="n">{one["mae"]:.3f} (−{100 * one["mae_reduction"]:.0f} %)</td>'
        f'<td class="n">{one["rmse"]:.3f} (−{100 * one["rmse_reduction"]:.0f} %)</td></tr>'
        for one in limits
    )
    if not rows:
        return ""
    return (
        "<p>The same manoeuvres simulated without delay and actuators, with laws designed for each condition. What is "
        "lost from the first line to those without an estimator is the sensors' noise fed back, and what an estimator "
        "wins back the lines beneath them tell. The paper's own runtime case on its own aircraft: MAE 1.21 to 0.25, "
        "RMSE 1.30 to 0.27 (−79 %), its noise not given; the lines that are as good are bold.</p>"
        '<div class="scroll"><table><tr><th>with compensation</th><th class="n">MAE</th><th class="n">RMSE</th></tr>'
        f"{rows}</table></div>"
    )


def _deadlines(dataset: xr.Dataset, summary: dict[str, Any], figures: dict[str, Path]) -> str:
    stolen = 1e3 * float(dataset["theft"].values[:, 1].sum()) if dataset.sizes["theft_number"] else 0.0
    longest = 1e3 * float(dataset["theft"].values[:, 1].max()) if dataset.sizes["theft_number"] else 0.0
    return (
        "<p>A beat misses its deadline if its laws are not there when its measurement is, or if its command is not "
        "with the aircraft within 30 % of the beat. A miss is explained by an injected fault if one killed or stalled "
        "the worker of the beat's window, else by the machine if that stole at least as much time as was missing on "
        "one of its cores; processes that only sleep measure that: "
        f"{stolen:.0f} ms in all, {longest:.1f} ms at most at once. Code was compiled or loaded in "
        f"{float(dataset.attrs['warm_up_seconds']):.1f} s and the first window "
        f"computed in {float(dataset.attrs['first_window_seconds']):.2f} s, both before take-off.</p>"
        + picture(figures["fig15_timeline"], "Windows, beats and latency (counterpart of the paper's Fig. 15).")
    )


def _certificates(dataset: xr.Dataset, summary: dict[str, Any]) -> str:
    counts = {kind: count for kind, count in summary["certificates"].items() if count}
    rows = "".join(
        f'<tr><td class="n">{count}</td><td>{escape(_CERTIFICATES[kind])}</td></tr>' for kind, count in counts.items()
    )
    kept = [promised(summary["promises"]), *([broken_off(summary)] if summary["broken_off"] else [])]
    stated = json.loads(str(dataset.attrs["certified"]))
    error, gust = stated["measurement_error"], stated["gust"]
    heard = (
        f"with errors of the measurement up to {100 * error:g} % of the disturbance box"
        if error
        else "given the error exactly: how far an estimator is off, the tubes do not know"
    )
    air = f"in gusts up to {gust:g} m/s" if gust else "in still air"
    return (
        "<p>Every law was measured on the nominal it was to fly, before it flew: the largest error at the end of the "
        f"beat, in the law's metric, over the whole disturbance set, {air}, {heard}. Tubes know no delays and no "
        "actuators, and say nothing of a beat that starts outside the set. A beat counts for the part that has the "
        "least. Samples: "
        f"{stated['samples']} for each beat, so that the tube is exceeded on no more than "
        f"{100 * stated['share']:.1f} % of the set, with a confidence of {100 * stated['confidence']:g} %.</p>"
        f'<div class="scroll"><table><tr><th class="n">beats</th><th>whose law has</th></tr>{rows}</table></div>'
        + "".join(f"<p>{escape(line[0].upper() + line[1:])}.</p>" for line in kept)
    )


def _fallbacks(dataset: xr.Dataset, summary: dict[str, Any]) -> str:
    rows = "".join(
        f'<tr><td class="n">{count}</td><td>{escape(_KINDS[kind])}</td></tr>'
        for kind, count in summary["fallbacks"].items()
    )
    clamped = int(dataset["clamped"].values.any(axis=1).sum())
    body = (
        f'<div class="scroll"><table><tr><th class="n">beats</th><th>that</th></tr>{rows}'
        f'<tr><td class="n">{clamped}</td>'
        "<td>had a control held at its limit by the clamp</td></tr></table></div>"
    )
    if summary["faults"]:
        body += f"<p>{escape(injected(summary['faults']))}.</p>"
    counts = json.loads(str(dataset.attrs["refused"]))
    if counts:
        words = ", ".join(f"{n} {name}" for name, n in sorted(counts.items()))
        body += f"<p>Refused on the way in: {escape(words)}.</p>"
    events = json.loads(str(dataset.attrs["events"]))
    if events:
        items = "".join(f"<li>{when:.3f} s: {escape(words)}</li>" for when, words in events[:100])
        body += f"<details><summary>{len(events)} events</summary><ul>{items}</ul></details>"
    return body


def _recomputation(dataset: xr.Dataset, options: dict[str, Any]) -> str:
    if options["tolerance"] is None:
        return ""
    computed, check = dataset["window_computed"].values, dataset["window_check_seconds"].values
    kept, beats, checked = int(dataset["window_kept"].sum()), int(computed.sum()), int(computed[check > 0].sum())
    spent = {name: float(dataset[f"window_{name}_seconds"].sum()) for name in ("check", "design", "certify")}
    each = {
        "check": 1e3 * spent["check"] / checked if checked else 0.0,
        "design": 1e3 * spent["design"] / (beats - kept) if beats > kept else 0.0,
    }
    saving = 1e-3 * each["design"] * kept - spent["check"]
    return (
        f"<p>A law of the manoeuvre before was kept where its certified tube on the new nominal was at most "
        f"{100 * options['tolerance']:g} % larger than where it was made, and its controls kept there, on the box or "
        "the ellipsoid of errors on which the settings want them, their limits and, where rates are limited, their "
        "share of the rate. "
        f"Kept: {kept} of {beats} beats ({100 * kept / max(beats, 1):.0f} %). Time spent: {spent['check']:.2f} s on "
        f"checking ({each['check']:.1f} ms a beat), {spent['design']:.2f} s on designing anew ({each['design']:.1f} ms "
        f"a beat), {spent['certify']:.2f} s on certifying. Against designing every beat, checking and keeping "
        + (f"saved {saving:.2f} s.</p>" if saving >= 0 else f"cost {-saving:.2f} s more.</p>")
    )


def _table(rows: dict[str, str]) -> str:
    cells = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows.items())
    return f'<div class="scroll"><table>{cells}</table></div>'
