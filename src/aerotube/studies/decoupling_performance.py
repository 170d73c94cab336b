"""Fig. 12: tracking with and without decoupling."""

from __future__ import annotations

from dataclasses import replace

from aerotube.results import CALM, CONDITION_WORDS, KEY_SUFFIX, NOISE
from aerotube.studies.bench import CONDITIONS, Bench
from aerotube.studies.flown import bands_figure, flights_dataset
from aerotube.studies.outcome import Outcome, Table, compare
from aerotube.studies.statistics import spread, welch

PANELS = (
    ("a", "elevator"),
    ("b", "throttle"),
    ("c", "V"),
    ("d", "alpha"),
    ("e", "aileron"),
    ("f", "p"),
    ("g", "rudder"),
)
_COUPLED, _DECOUPLED = "coupled (Algorithm 1)", "decoupled (Algorithm 2)"


def study(bench: Bench) -> Outcome:
    """Fly coupled and decoupled laws on the same draws."""
    rows, lines, changes = [], [], {}
    for place, condition in enumerate(CONDITIONS):
        settings = bench.settings(condition)
        bench.tell(f"laws and flights, {CONDITION_WORDS[condition]}", place / len(CONDITIONS))
        laws = {
            _COUPLED: bench.design(replace(settings, algorithm="coupled")).law,
            _DECOUPLED: bench.design(replace(settings, algorithm="decoupled")).law,
        }
        flown = {words: bench.fly(law, condition) for words, law in laws.items()}
        if condition == CALM:
            dataset = flights_dataset(flown, bench.prepared.nominal.controls)
        errors = {words: flights.mean_upper_error() for words, flights in flown.items()}
        changes[condition] = errors[_DECOUPLED] / errors[_COUPLED]
        end, words = KEY_SUFFIX[condition], CONDITION_WORDS[condition]
        rows += [
            compare(f"coupled{end}", f"mean upper error, coupled, {words}", 0.33, errors[_COUPLED]),
            compare(f"decoupled{end}", f"mean upper error, decoupled, {words}", 0.30, errors[_DECOUPLED]),
            compare(f"change{end}", f"decoupled over coupled, {words}", 0.30 / 0.33, changes[condition], "1"),
        ]
        test = welch(errors[_DECOUPLED], errors[_COUPLED]) if len(bench.seeds) > 1 else None
        p = "–" if test is None else test.words
        lines.append((words, spread(errors[_COUPLED]), spread(errors[_DECOUPLED]), p))
    calm, noisy = (changes[condition].mean() - 1.0 for condition in (CALM, NOISE))
    return Outcome(
        dataset=dataset,
        figure=bands_figure(
            dataset,
            f"Tracking with and without decoupling, no sensor noise: bands over {bench.runs} runs (seed "
            f"{bench.seeds[0]})",
            PANELS,
            (_COUPLED, _DECOUPLED),
        ),
        caption="Coupled and decoupled laws on the same draws (Fig. 12).",
        compared=tuple(rows),
        verdict=(
            f"Decoupling changes the mean upper error by {calm:+.1%} without sensor noise and by {noisy:+.1%} with it; "
            "the paper reports −9 %."
        ),
        notes=(
            "The paper explains its better decoupled law by more accurate computations on the smaller problems. "
            "Here both programs are solved to the same certified accuracy, so only what decoupling leaves out "
            "remains: the law of a half does not see the other half's error. It knows what its own error lets "
            "expect of it.",
            "The paper's coupled figure of 0.33 is with one-step control reuse; ours are without.",
        ),
        tables=(
            Table(
                "Mean upper error (deg), and Welch's t-test of equal means over the seeds",
                ("condition", "coupled", "decoupled", "p"),
                tuple(lines),
            ),
        ),
    )
