"""The page ``report.html`` of a run: what its sections say."""

from __future__ import annotations

import json
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aerotube.report import assurance, interactive
from aerotube.report.style import flown
from aerotube.report.template import fill, picture
from aerotube.report.words import CERTIFICATES, certificate_words, change_words, sampling_words, worse_words
from aerotube.results import CALM, CONDITION_WORDS, CONTROLLER_WORDS, ESTIMATOR, KEY_SUFFIX, NOISE

if TYPE_CHECKING:
    import xarray as xr


def build_page(dataset: xr.Dataset, summary: Mapping[str, Any], figures: Mapping[str, Path]) -> str:
    """Build the page.

    Parameters
    ----------
    dataset : xarray.Dataset
    summary : mapping
        Of the dataset.
    figures : mapping of str to Path
        Pictures by name, as `aerotube.report.draw` wrote them.

    Returns
    -------
    str
        HTML.
    """
    sections = [
        ("errors", "Tracking errors", _errors(dataset, summary)),
        ("tubes", "Trajectory tubes", _tubes(dataset, summary, figures)),
        ("containment", "Tubes in flight", _containment(summary, figures)),
        ("margins", "Margins", _margins(summary, figures)),
        ("tracking", "States and controls", _tracking(figures)),
        ("aircraft", "Aircraft", _aircraft(figures)),
        ("scenario", "Scenario", _scenario(dataset)),
        ("provenance", "Provenance", _provenance(dataset)),
    ]
    return fill(
        title=str(summary["title"] or "aerotube results"),
        lead=(
            f"{summary['beats']} beats in {summary['horizon_s']:g} s; {summary['seeds']} seeds of "
            f"{summary['runs_per_seed']} runs each; computed {dataset.attrs.get('created', '')} "
            f"with aerotube {dataset.attrs.get('aerotube_version', '')}."
        ),
        sections=sections,
        version=str(dataset.attrs.get("aerotube_version", "")),
        notice=_notice(summary),
        cards=_cards(summary),
    )


def _number(spread: Mapping[str, float | None], digits: int = 3) -> str:
    if spread["mean"] is None:
        return "–"
    mean = f"{spread['mean']:.{digits}f}"
    return mean if spread["sd"] is None else f"{mean} ± {spread['sd']:.{digits}f}"


def _notice(summary: Mapping[str, Any]) -> str:
    problems = summary["problems"]
    worse = worse_words(summary)
    words = [f"{worse[:1].upper()}{worse[1:]}."] if worse else []
    if not problems and summary["complete"] and not words:
        return ""
    if summary["interrupted"]:
        words.append("The run was interrupted; what was finished is shown.")
    elif not summary["complete"]:
        words.append("Some parts could not be computed; the rest is shown.")
    if problems:
        words.append(f"{len(problems)} computed failure(s); the nominal alone was flown where there was no law:")
    listed = "".join(f"<li>{escape(problem)}</li>" for problem in problems[:20])
    more = f"<li>and {len(problems) - 20} more, in summary.json</li>" if len(problems) > 20 else ""
    items = f"<ul>{listed}{more}</ul>" if problems else ""
    return f'<div class="notice">{escape(" ".join(words))}{items}</div>'


def _cards(summary: Mapping[str, Any]) -> str:
    cards = []
    for condition, suffix in KEY_SUFFIX.items():
        reduction = summary[f"reduction{suffix}"]
        if reduction["mean"] is None:
            continue
        errors = summary[f"mean_upper_error{suffix}"]
        worse = " none" if reduction["mean"] < 0 else ""
        cards.append(
            f'<div class="card"><div class="what">Mean upper error, {CONDITION_WORDS[condition]}</div>'
            f'<div class="number{worse}">{change_words(reduction | {"sd": None}, " %")}</div>'
            f'<div class="how">{errors["none"]["mean"]:.3f} → {errors["compensated"]["mean"]:.3f}; '
            f"LQR {_number(errors['lqr']).split(' ')[0]}</div></div>"
        )
    solve = summary["solve_ms"]
    if solve["median"] is not None:
        parts = summary["beats"]
        cards.append(
            '<div class="card"><div class="what">Time to solve one program</div>'
            f'<div class="number">{solve["median"]:.1f} ms</div>'
            f'<div class="how">99th percentile {solve["p99"]:.1f} ms; {summary["feasible_beats"]} of {parts} beats '
            "feasible</div></div>"
        )
    return "".join(cards)


def _errors(dataset: xr.Dataset, summary: Mapping[str, Any]) -> str:
    conditions = [name for name in KEY_SUFFIX if flown(dataset, name)]
    if not conditions:
        return ""
    head = "".join(f'<th class="n">{escape(CONDITION_WORDS[name])}</th>' for name in conditions)
    rows = []
    for controller, words in CONTROLLER_WORDS.items():
        cells = "".join(
            f'<td class="n">{_number(summary[f"mean_upper_error{KEY_SUFFIX[name]}"][controller])}</td>'
            for name in conditions
        )
        rows.append(f'<tr><td><span class="key {controller}"></span>{escape(words)}</td>{cells}</tr>')
    for key, words in (("reduction", "change by compensation"), ("lqr_reduction", "change by LQR")):
        cells = "".join(
            f'<td class="n">{change_words(summary[f"{key}{KEY_SUFFIX[name]}"], " %")}</td>' for name in conditions
        )
        rows.append(f"<tr><td>{words}</td>{cells}</tr>")
    laws = "".join(
        f"<li>{escape(CONDITION_WORDS[name])}: {escape(CONTROLLER_WORDS[controller])} flies "
        f"{escape(str(dataset['flown_law'].sel(controller=controller, condition=name).values))}</li>"
        for name in conditions
        for controller in flown(dataset, name)
        if controller != "none"
    )
    strayed = "".join(
        f"<li>{escape(CONDITION_WORDS[name])}, {escape(CONTROLLER_WORDS[controller])}: {count} runs</li>"
        for name in conditions
        for controller, count in summary["outside_runs"][name].items()
        if count
    )
    outside = f"<p>Outside the range of the aircraft's tables at some time:</p><ul>{strayed}</ul>" if strayed else ""
    return (
        "<p>The error of a run is the root mean square over the eight states (Eq. 18), in degrees and degrees per "
        "second, the airspeed in hundreds of m/s. The mean upper error is the largest over the runs of a seed, "
        "averaged over time; shown is its mean over the seeds ± their standard deviation.</p>"
        f'<div class="scroll"><table><tr><th>mean upper error (deg)</th>{head}</tr>{"".join(rows)}</table></div>'
        f"<details><summary>Which laws were flown</summary><ul>{laws}</ul></details>"
        f"{outside}{interactive.errors_html(dataset, conditions)}"
    )


def _tubes(dataset: xr.Dataset, summary: Mapping[str, Any], figures: Mapping[str, Path]) -> str:
    if "law" not in dataset.dims:
        return ""
    rows, chosen = [], ""
    for name, law in summary["laws"].items():
        settings = ", ".join(
            f"{key.replace('_', ' ')} {format(value, 'g') if isinstance(value, float) else value}"
            for key, value in law["settings"].items()
        )
        solve = law["solve_ms"]
        beyond = law["certify_ms"]["median"]
        time = "–" if solve["median"] is None else f"{solve['median']:.1f} / {solve['p99']:.1f}"
        more = "–" if beyond is None else f"{beyond:.1f}"
        rows.append(
            f'<tr><td class="w">{escape(name.replace("_", "-"))}</td>'
            f"<td>{escape(certificate_words(law['certificate'], explained=False))}</td>"
            f'<td class="n">{law["feasible_beats"]} of {summary["beats"]}</td><td class="n">{time}</td>'
            f'<td class="n">{more}</td></tr>'
        )
        chosen += f"<li>{escape(name.replace('_', '-'))}: {escape(settings)}</li>"
    meant = {
        kind: sampling_words(law["sampling"]) if kind == "sampled" else f"{kind.capitalize()}: {CERTIFICATES[kind]}."
        for law in summary["laws"].values()
        for kind in law["certificate"]
    }
    first = str(dataset["law"].values[0])
    return (
        "<p>Each beat starts anywhere in the disturbance set; the tube says where the error can be at the end of the "
        "beat. What a tube is worth depends on its certificate. A law that looks beyond the beat (cost-to-go) may "
        "widen the tube in one state to be rid of an error in another later on.</p>"
        '<div class="scroll"><table><tr><th>law</th><th>certificate of its tubes</th><th class="n">feasible beats</th>'
        '<th class="n">solve, median / p99 (ms)</th><th class="n">beyond the polynomial, median (ms)</th>'
        f"</tr>{''.join(rows)}</table></div>"
        f"<p>{escape(' '.join(meant.values()))}</p>"
        f"<details><summary>Settings of the synthesis</summary><ul>{chosen}</ul></details>"
        f"{_beyond(summary, figures)}"
        f"{interactive.tubes_html(dataset, first)}"
        + _picture(figures, "fig8_tubes", "Tubes and their half-widths over time (counterpart of the paper's Fig. 8).")
    )


def _beyond(summary: Mapping[str, Any], figures: Mapping[str, Path]) -> str:
    """What the tubes hold beyond their polynomials."""
    rows, notes = [], []
    for name, law in summary["laws"].items():
        notes += [f"{name.replace('_', '-')} law, {note}" for note in law["certificate_notes"]]
        for part, excess in law["tube_excess"].items():
            if excess is None:
                continue
            numbers = (excess["median"], excess["largest"], *excess["shares"].values(), excess["control"])
            cells = "".join(f'<td class="n">{100 * number:.1f}</td>' for number in numbers)
            rows.append(f'<tr><td class="w">{escape(name.replace("_", "-"))}</td><td>{escape(part)}</td>{cells}</tr>')
    told = "".join(f"<li>{escape(note)}</li>" for note in notes[:20])
    less = f"<details><summary>{len(notes)} tubes rest on less than was asked for</summary><ul>{told}</ul></details>"
    if not rows:
        return less if notes else ""
    heads = ("median", "largest", "remainder", "parameters", "coupling", "measurement", "gusts", "control (within)")
    head = "".join(f'<th class="n">{escape(title)}</th>' for title in heads)
    caption = (
        "What is added to the bound of each program's polynomial, in percent of it. Where the control's nonlinearity "
        "acts, it is a part of the polynomial already."
    )
    return (
        f"<p>By how much tubes are larger than their polynomials' (ρ, in percent): median and largest of the "
        f"beats, then what makes it up, mean of the beats.</p>"
        f'<div class="scroll"><table><tr><th>law</th><th>part</th>{head}</tr>{"".join(rows)}</table></div>'
        f"{less if notes else ''}" + _picture(figures, "tube_shares", caption)
    )


def _containment(summary: Mapping[str, Any], figures: Mapping[str, Path]) -> str:
    caption = "Runs that start inside the sets of their tubes and keep to them, by the condition flown."
    return assurance.containment_html(summary) + _picture(figures, "containment", caption)


def _margins(summary: Mapping[str, Any], figures: Mapping[str, Path]) -> str:
    caption = "Disk and delay margins of each beat's frozen loop."
    return assurance.margins_html(summary) + _picture(figures, "margins", caption)


_TRACKING = {
    CALM: "fig9_tracking",
    NOISE: "fig9_tracking_noise",
    ESTIMATOR: "fig9_tracking_estimator",
}


def _tracking(figures: Mapping[str, Path]) -> str:
    pictures = {
        condition: _picture(figures, name, f"{CONDITION_WORDS[condition].capitalize()} (counterpart of Fig. 9).")
        for condition, name in _TRACKING.items()
        if name in figures
    }
    bodies = [
        # The first is open, the others are a click away.
        picture
        if number == 0
        else f"<details><summary>{CONDITION_WORDS[name].capitalize()}</summary>{picture}</details>"
        for number, (name, picture) in enumerate(pictures.items())
    ]
    return "".join(bodies)


def _aircraft(figures: Mapping[str, Path]) -> str:
    return _picture(
        figures,
        "fig7_coefficients",
        "Coefficients about the centre of gravity of the scenario, wind axes for drag and lift (counterpart of the "
        "paper's Fig. 7).",
    )


def _picture(figures: Mapping[str, Path], name: str, caption: str) -> str:
    return picture(figures[name], caption) if name in figures else ""


def _scenario(dataset: xr.Dataset) -> str:
    text = str(dataset.attrs.get("scenario_text", ""))
    overrides = json.loads(str(dataset.attrs.get("scenario_overrides", "{}")))
    changed = "".join(f"<li><code>{escape(key)} = {escape(str(value))}</code></li>" for key, value in overrides.items())
    set_over = f"<p>Set over it on the command line:</p><ul>{changed}</ul>" if changed else ""
    return (
        f"<p>Scenario <b>{escape(str(dataset.attrs.get('scenario_name', '')))}</b>.</p>{set_over}"
        f"<details><summary>The scenario file</summary><pre>{escape(text)}</pre></details>"
    )


def _provenance(dataset: xr.Dataset) -> str:
    attributes = dataset.attrs
    libraries = json.loads(str(attributes.get("library_versions", "{}")))
    seeds = [int(seed) for seed in dataset["seed"].values] if "seed" in dataset else []
    rows = {
        "aerotube": attributes.get("aerotube_version", ""),
        "computed": attributes.get("created", ""),
        "scenario SHA-256": attributes.get("scenario_sha256", ""),
        "seeds": f"{seeds[0]} to {seeds[-1]}" if seeds else "",
        "Python": attributes.get("python_version", ""),
        "libraries": ", ".join(f"{name} {version}" for name, version in libraries.items()),
        "platform": attributes.get("platform", ""),
        "processor": attributes.get("processor", ""),
        "time taken": "; ".join(
            f"{words} {value:.1f} s" for words, value in json.loads(str(attributes.get("seconds", "{}"))).items()
        ),
        "schema of results.nc": attributes.get("schema_version", ""),
    }
    cells = "".join(f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>" for name, value in rows.items())
    return f'<div class="scroll"><table>{cells}</table></div>'
