"""What the console and the page say alike: changes, margins, tubes in flight, what tubes rest on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from aerotube.results import CONDITION_WORDS, KEY_SUFFIX, SETTING

CERTIFICATES = {
    "solver's word": "the solver's own value, which failed the check",
    "polynomial only": "checked for the polynomial model of the aircraft, which leaves a remainder out",
    "sampled": "the remainder is bounded with a stated confidence from samples",
    "rigorous": "the remainder is bounded rigorously",
    "none": "no tube was found",
}

#: What tubes may not allow for: in words, and the keys of the synthesis that would make them.
_ALLOWANCES = {
    "measurement": ("measurement errors", ("measurement_error",)),
    "wind": ("gusts", ("gust", "gust_rotation")),
}


def change_words(reduction: Mapping[str, float | None], unit: str = "") -> str:
    """A reduction as a change in percent, with its sign and its spread: "−67.1 ± 3.9"."""
    if reduction["mean"] is None:
        return "–"
    mean = f"{-100.0 * reduction['mean'] + 0.0:+.1f}".replace("-", "−")
    return (mean if reduction["sd"] is None else f"{mean} ± {100.0 * reduction['sd']:.1f}") + unit


def certificate_words(counts: Mapping[str, int], explained: bool = True) -> str:
    """Say what the certificates of tubes are, from the number of each kind, and what they are worth."""
    total = sum(counts.values())
    return "; ".join(
        ("" if count == total else f"{count} of {total} tubes ")
        + (f"{kind} ({CERTIFICATES[kind]})" if explained else kind)
        for kind, count in counts.items()
    )


def sampling_words(sampling: Mapping[str, float]) -> str:
    """Say what samples are worth."""
    return (
        f"Sampled: with a confidence of {100 * sampling['confidence']:g} %, for each beat and part, at most "
        f"{100 * sampling['share']:.2g} % of the set exceeds the tube, by the distribution of its "
        f"{sampling['samples']:g} independent samples; searches from the worst of them have raised it further."
    )


def gain_words(decibels: float | None) -> str:
    """A gain margin in words: "±4.1 dB"."""
    return "any" if decibels is None else f"±{decibels:.1f} dB"


def delay_words(worst: Mapping[str, Any]) -> str:
    """A delay margin in words: "44 ms"."""
    return "any" if worst["delay_ms"] is None else f"{worst['delay_ms']:.0f} ms"


def margin_lines(summary: Mapping[str, Any]) -> Iterator[str]:
    """The worst margins of every law over the beats: of gain and phase, and of delay, each with where it is."""
    for law, facts in summary["laws"].items():
        margins = facts["margins"]
        words = f"{law.replace('_', '-')} law, worst margins of the frozen loops: "
        if margins is None:
            continue
        if margins["all"] is None:
            yield words + "none, as no loop is stable by itself"
            continue
        single = {name: worst for name, worst in margins.items() if isinstance(worst, dict) and name != "all"}
        strict = min(single, key=lambda control: single[control]["disk"])
        late = min(single, key=lambda control: _delay(single[control]))
        alone = _disk_words(single[strict], f"{strict}, "), _lag_words(single[late], f"{late}, ")
        every = _disk_words(margins["all"]), _lag_words(margins["all"])
        unstable = margins["unstable_beats"]
        yield (
            f"{words}of one control, {', '.join(alone)}; of all at once, {', '.join(every)}"
            + (f"; beats not stable by themselves: {unstable}" if unstable else "")
        )


def _delay(worst: Mapping[str, Any]) -> float:
    return float("inf") if worst["delay_ms"] is None else float(worst["delay_ms"])


def _disk_words(worst: Mapping[str, Any], control: str = "") -> str:
    return (
        f"gain {gain_words(worst['gain_db'])} and phase ±{worst['phase_deg']:.0f}° ({control}beat {worst['at_beat']})"
    )


def _lag_words(worst: Mapping[str, Any], control: str = "") -> str:
    where = "" if worst["delay_ms"] is None else f" ({control}beat {worst['delay_at_beat']})"
    return f"delay {delay_words(worst)}{where}"


def no_promise(summary: Mapping[str, Any], condition: str) -> str:
    """Why the tubes promise nothing in a condition, and what would change it; empty where they promise something."""
    found = summary["containment"][condition]
    if found["started_inside"] or not found["beats"]:
        return ""
    law = SETTING[condition]
    settings = summary["laws"].get(law, {}).get("settings", {})
    whys, keys = [], []
    for reason, (words, needed) in _ALLOWANCES.items():
        if found["outside"].get(reason) == found["beats"]:
            given = any(settings.get(key) for key in needed)
            whys.append(f"{words} as large as those flown" if given else words)
            keys += [f"synthesis.{law}.{key}" for key in needed]
    if not whys:
        return "no beat started inside their sets"
    return f"they do not allow for {' and '.join(whys)}; {' and '.join(keys)} would make them"


def containment_lines(summary: Mapping[str, Any]) -> Iterator[str]:
    """How flights kept to their tubes, a line for each condition."""
    for condition, found in summary["containment"].items():
        law, why = SETTING[condition].replace("_", "-"), no_promise(summary, condition)
        if why:
            yield f"{condition}: the tubes of the {law} law promise nothing here: {why}"
            continue
        beats, inside = found["beats"], found["started_inside"]
        violations = ", ".join(f"{name} {count}" for name, count in found["violations"].items() if count) or "none"
        reasons = ", ".join(f"{reason} {count}" for reason, count in found["outside"].items() if count)
        yield (
            f"{condition}: {100.0 * inside / max(beats, 1):.1f} % of {beats} beats started inside the sets of their "
            f"tubes{f' (outside: {reasons})' if reasons else ''}; of these left their tube: {violations}"
        )


def certificate_lines(summary: Mapping[str, Any]) -> Iterator[str]:
    """What the tubes of every law rest on."""
    for law, facts in summary["laws"].items():
        yield f"{law.replace('_', '-')} law, its tubes are {certificate_words(facts['certificate'])}"


def worse_words(summary: Mapping[str, Any]) -> str:
    """That compensation flies worse than the nominal controls alone, where it does, and what to do; empty elsewhere."""
    told, sizes = [], set()
    for condition, suffix in KEY_SUFFIX.items():
        errors = {name: one["mean"] for name, one in summary[f"mean_upper_error{suffix}"].items()}
        alone, law = errors.get("none"), errors.get("compensated")
        if alone is not None and law is not None and law > alone:
            told.append(f"{law:.3g} deg in place of {alone:.3g} ({CONDITION_WORDS[condition]})")
            sizes.add(str(summary["laws"].get(SETTING[condition], {}).get("settings", {}).get("size")))
    if not told:
        return ""
    cure = (
        "the size worst-case leaves the law free in all directions but the worst; let the mean square weigh more, "
        "such as size = {worst-case = 0.1, mean-square = 1.0}"
        if any("worst-case" in size for size in sizes)
        else "change the law's settings before you use it"
    )
    return (
        f"compensation flies worse than the nominal controls alone, with mean upper errors of {', '.join(told)}; {cure}"
    )
