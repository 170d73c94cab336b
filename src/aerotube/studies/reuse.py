"""Fig. 10: one law for several beats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from aerotube.results import CALM, CONDITION_WORDS, KEY_SUFFIX
from aerotube.studies.bench import CONDITIONS, Bench
from aerotube.studies.flown import bands_figure, flights_dataset
from aerotube.studies.outcome import Compared, Outcome, Table, compare
from aerotube.studies.statistics import spread

PANELS = (("a", "elevator"), ("b", "throttle"), ("c", "aileron"), ("d", "rudder"))
STEPS = (0, 1, 2, 3)
_WORDS = {0: "no reuse", 1: "one-step reuse", 2: "two-step reuse", 3: "three-step reuse"}


def study(bench: Bench) -> Outcome:
    """Fly laws that serve one beat and several, on the same draws."""
    rows: list[Compared] = []
    lines, changes = [], {}
    for place, condition in enumerate(CONDITIONS):
        bench.tell(f"laws and flights, {CONDITION_WORDS[condition]}", place / len(CONDITIONS))
        settings = bench.settings(condition)
        flown = {_WORDS[k]: bench.fly(bench.design(replace(settings, reuse=k)).law, condition) for k in STEPS}
        if condition == CALM:
            dataset = flights_dataset(flown, bench.prepared.nominal.controls)
        errors = {k: flown[_WORDS[k]].mean_upper_error() for k in STEPS}
        changes[condition] = errors[1] / errors[0] - 1.0
        end, words = KEY_SUFFIX[condition], CONDITION_WORDS[condition]
        rows += [
            compare(f"without{end}", f"mean upper error, no reuse, {words}", 0.32, errors[0]),
            compare(f"one_step{end}", f"mean upper error, one-step reuse, {words}", 0.33, errors[1]),
            compare(f"change{end}", f"increase by one-step reuse, {words}", 0.03, changes[condition], "1"),
        ]
        lines.append((words, *(spread(errors[k]) for k in STEPS)))
    mean = round(float(changes[CALM].mean()), 3) + 0.0  # no minus before a zero
    most = round(max(float(change.mean()) for change in changes.values()), 3) + 0.0
    return Outcome(
        dataset=dataset,
        figure=bands_figure(
            dataset,
            f"Tracking with and without control reuse, no sensor noise: bands over {bench.runs} runs (seed "
            f"{bench.seeds[0]})",
            PANELS,
            [_WORDS[k] for k in STEPS[:2]],
        ),
        caption="Laws that serve one beat, and two (Fig. 10).",
        compared=tuple(rows),
        verdict=(
            f"One-step reuse costs {mean:+.1%} in mean upper error without sensor noise and at most {most:+.1%} in "
            "all conditions; the paper reports +3 %."
        ),
        notes=(
            "A law that is reused is designed for all the beats it serves: one program holds the maps of all of "
            "them. The law of a beat is kept, the measurement is fresh at every beat.",
            "The paper's jagged commands at the switches hardly show here: neighbouring laws differ little, since "
            "each looks along the whole manoeuvre.",
        ),
        tables=(
            Table("Mean upper error (deg)", ("condition", *(_WORDS[k] for k in STEPS)), tuple(lines)),
            _smoothness(bench),
        ),
    )


def _smoothness(bench: Bench) -> Table:
    """How far the commands jump from beat to beat: the jaggedness of the paper's Fig. 10."""
    aircraft = bench.prepared.plant
    travel = aircraft.control_upper - aircraft.control_lower
    rows = []
    for k in STEPS:
        flown = bench.fly(bench.design(replace(bench.settings(CALM), reuse=k)).law, CALM)
        jumps = np.diff(flown.control - bench.prepared.nominal.controls, axis=1) / travel
        # the first jump is that of the initial error, whatever the reuse
        size = np.sqrt(np.mean(jumps[:, 1:] ** 2, axis=(0, 1)))
        rows.append((_WORDS[k], *(f"{100 * value:.3f} %" for value in size)))
    head = ("root mean square change of a command between beats, of its travel", *aircraft.control_names)
    return Table("Jumps of the commands, no sensor noise", head, tuple(rows))
