"""What a flight came to, in sentences: for the terminal, and where the page says the same."""

from __future__ import annotations

from typing import Any

_ROUNDING = 1e-9  # s
_ENDED = {
    "interrupted": "interrupted: what was flown until then is written",
    "early": "the aircraft ended the session before the last beat",
    "behind": "the aircraft fell behind the clock and did not fly to the end; make beats longer or the speed lower",
    "lost": "the aircraft's process ended without its log: nothing is known of what it flew",
}
_EXPLAINED = {"fault": "by injected faults", "machine": "by the machine"}


def told(summary: dict[str, Any]) -> list[str]:
    """The lines that a terminal gets of ``fly.json``."""
    lines = [f"{summary['beats']} beats, {duration(summary)}; {missed(summary)}"]
    if summary["ended"] != "whole":
        lines.insert(0, _ENDED[summary["ended"]])
    if summary["faults"]:
        lines.append(injected(summary["faults"]))
    fallbacks = {name.replace("_", " "): count for name, count in summary["fallbacks"].items() if count}
    lines.append("fallbacks: " + (", ".join(f"{count} {name}" for name, count in fallbacks.items()) or "none"))
    kinds = [f"{count} {name}" for name, count in summary["certificates"].items() if count]
    lines.append("certificates of the beats' laws: " + (", ".join(kinds) or "none"))
    kept = summary["promises"]
    lines.append(promised(kept))
    if summary["broken_off"]:
        lines.append(broken_off(summary))
    for key, name in (("mae", "mean absolute error"), ("rmse", "root mean square error")):
        none, compensated = summary[key]["none"], summary[key]["compensated"]
        if none and compensated is not None:
            share = 100 * (1 - compensated / none)
            lines.append(f"{name}: {none:.3f} without compensation, {compensated:.3f} with it (−{share:.0f} %)")
    span = summary["latency_us"]
    if span["median"] is not None:
        lines.append(f"measurement to command: {span['median']:.0f} µs median, {span['p99']:.0f} µs 99th percentile")
    if summary["realtime_factor"] is not None:
        lines.append(f"windows are computed {summary['realtime_factor']:.1f} times as fast as they are flown")
    spent = summary["window_ms"]
    if spent is not None:
        parts = [f"{spent[name]:.0f} to {name}" for name in ("check", "design", "certify") if spent[name]]
        lines.append(f"a whole window takes {spent['whole']:.0f} ms (median): {', '.join(parts)}")
    return lines


def duration(summary: dict[str, Any]) -> str:
    """Seconds flown, and why they are not those that were asked for."""
    words, asked = f"{summary['seconds']:g} s of flight", summary["seconds_asked"]
    longer = summary["ended"] == "whole" and asked is not None and abs(asked - summary["seconds"]) > _ROUNDING
    return words + (f" ({asked:g} s were asked for: whole manoeuvres)" if longer else "")


def broken_off(summary: dict[str, Any]) -> str:
    """Why there are beats with a law that nothing else is said of."""
    return (
        f"the last {summary['broken_off']} beats are of a manoeuvre that was not flown to its end: they are counted "
        "above, but the aircraft logs whole manoeuvres, and errors and tubes are looked at in those"
    )


def promised(kept: dict[str, Any] | None) -> str:
    """Whether beats kept to their tubes."""
    if kept is None:
        return (
            "whether beats kept to their tubes is not looked at: tubes know no delay, no actuators and no engine's "
            "lag, and the aircraft's own log of whole manoeuvres is needed"
        )
    if not kept["promised"]:
        return f"no beat of which its tube promises anything: {kept['why']}"
    return (
        f"of {kept['certified']} certified beats of whole manoeuvres {kept['promised']} started inside the sets of "
        f"their tubes; of these {kept['left'] or 'none'} ended outside"
    )


def missed(summary: dict[str, Any]) -> str:
    """How many deadlines were missed, and what explains them."""
    count, explained = summary["missed_deadlines"], summary["missed_explained"]
    if not count:
        return "no missed deadlines"
    parts = [f"{explained[key]} explained {words}" for key, words in _EXPLAINED.items()]
    return f"{count} missed deadlines: {', '.join(parts)}, {summary['missed_unexplained']} unexplained"


def injected(faults: dict[str, int]) -> str:
    """How many faults were injected, by kind."""
    return f"{sum(faults.values())} faults injected: " + ", ".join(f"{count} {kind}" for kind, count in faults.items())
