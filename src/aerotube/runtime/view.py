"""The flight in the terminal, while it flies."""

from __future__ import annotations

import time
from collections import Counter
from typing import Any

import numpy as np
from rich.console import Console, Group
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from aerotube.flight.metrics import error_metric
from aerotube.runtime.commander import Source
from aerotube.runtime.messages import Rung
from aerotube.runtime.pilot import Pilot

_BARS = "▁▂▃▄▅▆▇█"
_STRIP = 64
_MARKS = {
    Rung.PLANNED: ("█", "green"),
    Rung.ANYTIME: ("▓", "cyan"),
    Rung.LAST: ("▒", "yellow"),
    Rung.LQR: ("░", "magenta"),
    Rung.NOMINAL: ("·", "red"),
}
_WORDS = {
    Rung.PLANNED: "planned",
    Rung.ANYTIME: "any-time answer",
    Rung.LAST: "last law",
    Rung.LQR: "LQR",
    Rung.NOMINAL: "nominal alone",
}


def render(pilot: Pilot) -> Panel:
    """The state of a flight as a panel.

    Parameters
    ----------
    pilot : Pilot
        Flying or done; it is only read.

    Returns
    -------
    rich.panel.Panel
    """
    record, count = pilot.record, pilot.record.flown
    dt = pilot.guidance.planned.dt
    manoeuvre, number = divmod(max(count - 1, 0), pilot.horizon)
    head = Text.assemble(
        (f"beat {count} of {record.beats}", "bold"),
        f"   {count * dt:.1f} s of flight   manoeuvre {manoeuvre + 1}, beat {number + 1} of {pilot.horizon}",
    )
    recent = slice(max(count - _STRIP, 0), count)
    worst = record.rung[recent].max(axis=1, initial=-1)
    strip = Text("laws     ")
    for rung in worst:
        mark, colour = _MARKS[Rung(int(rung))] if rung >= 0 else ("×", "red")
        strip.append(mark, colour)
    legend = Text("         ")
    for rung, words in _WORDS.items():
        legend.append(_MARKS[rung][0], _MARKS[rung][1])
        legend.append(f" {words}   ", "dim")
    return Panel(
        Group(head, Text(), strip, legend, _errors(record, recent), Text(), _numbers(pilot), *_events(pilot)),
        title="aerotube fly",
        title_align="left",
        border_style="blue",
    )


def _errors(record: Any, recent: slice) -> Text:
    metric = error_metric(np.nan_to_num(record.error[recent]))
    top = max(float(metric.max(initial=0.0)), 1e-9)
    bars = "".join(_BARS[min(int(7.99 * value / top), 7)] for value in metric)
    last = f"   {metric[-1]:.2f} deg now, {top:.2f} at most" if len(metric) else ""
    return Text.assemble("error    ", (bars, "blue"), (last, "dim"))


def _numbers(pilot: Pilot) -> Table:
    record, count = pilot.record, pilot.record.flown
    spans = 1e6 * (record.sent[:count] - record.arrived[:count])
    spans = spans[np.isfinite(spans)]
    fallbacks = record.fallbacks()
    table = Table.grid(padding=(0, 3))
    for _ in range(4):
        table.add_column()
    late = int(record.law_late[:count].sum())
    windows = [w for w in record.windows if not w.error]
    latest = f"{1e3 * (windows[-1].done - windows[-1].started):.0f} ms" if windows else "–"
    ladder = ", ".join(
        f"{fallbacks[rung.name.lower()]} {words}"
        for rung, words in _WORDS.items()
        if rung and fallbacks[rung.name.lower()]
    )
    predicted = int((record.source[:count] == Source.PREDICTED).sum())
    none = count - predicted - int((record.source[:count] == Source.MEASURED).sum())
    median = f"{np.median(spans):.0f} µs median, {np.percentile(spans, 99):.0f} µs p99" if len(spans) else "–"
    kinds = ", ".join(f"{n} {kind}" for kind, n in record.certificates().items() if n)
    table.add_row("[dim]windows late[/]", f"{late} beats", "[dim]last window took[/]", latest)
    table.add_row("[dim]fallbacks[/]", ladder or "none", "[dim]measurement to command[/]", median)
    table.add_row(
        "[dim]without measurement[/]",
        f"{predicted} predicted, {none} without a state",
        "[dim]clamp[/]",
        f"{int(record.clamped[:count].any(axis=1).sum())} beats",
    )
    table.add_row("[dim]certificates[/]", kinds or "–", "", "")
    return table


def _events(pilot: Pilot) -> list[Text]:
    refused = _copied(pilot.session.refused) + _copied(pilot.record.refused)
    lines = []
    if refused:
        lines.append(Text("refused  " + ", ".join(f"{n} {words}" for words, n in refused.most_common(6)), "yellow"))
    lines += [Text(f"         {words}", "dim") for _, words in pilot.workers.events[-3:]]
    return [Text(), *lines] if lines else []


def _copied(counts: Counter[str]) -> Counter[str]:
    """What another thread goes on counting in, in one step: looked through, it would not bear a new key."""
    return Counter(dict(counts))


class LiveView:
    """Shows the flight on a terminal, a few times a second; elsewhere, a line now and then."""

    def __init__(self, console: Console | None = None) -> None:
        self._console = console or Console(stderr=True)
        self._live: Any = None
        self._told = time.monotonic()

    def __call__(self, pilot: Pilot) -> None:
        """Show it."""
        if self._live is None and self._console.is_terminal:
            from rich.live import Live

            self._live = Live(console=self._console, auto_refresh=False)
            self._live.start()
        if self._live is not None:
            self._live.update(render(pilot), refresh=True)
        elif time.monotonic() - self._told > 10.0:
            self._told = time.monotonic()
            count = pilot.record.flown
            late = int(pilot.record.law_late[:count].sum())
            words = f"{count} of {pilot.record.beats} beats, {late} with a late window"
            self._console.print(words, highlight=False)

    def close(self) -> None:
        """Leave the last picture standing."""
        if self._live is not None:
            self._live.stop()
