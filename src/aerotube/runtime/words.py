"""What a flight came to, in sentences: for the terminal, and where the page says the same."""

from __future__ import annotations

from typing import Any

_EXPLAINED = {"fault": "by injected faults", "machine": "by the machine"}


def told(summary: dict[str, Any]) -> list[str]:
    """The lines that a terminal gets of ``fly.json``."""
    lines = [f"{summary['beats']} beats; {missed(summary)}"]
    if summary["faults"]:
        lines.append(injected(summary["faults"]))
    fallbacks = {name.replace("_", " "): count for name, count in summary["fallbacks"].items() if count}
    lines.append("fallbacks: " + (", ".join(f"{count} {name}" for name, count in fallbacks.items()) or "none"))
    kinds = [f"{count} {name}" for name, count in summary["certificates"].items() if count]
    lines.append("certificates of the beats' laws: " + (", ".join(kinds) or "none"))
    kept = summary["promises"]
    if kept is not None:
        left = kept["left"] or "none"
        lines.append(f"{kept['promised']} beats started inside the sets of their tubes; of these {left} ended outside")
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
