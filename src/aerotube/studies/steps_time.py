"""Fig. 13: time of the two-step and the three-step algorithm over the number of threads."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from aerotube import compensation
from aerotube.compensation import SynthesisSettings
from aerotube.results import CALM
from aerotube.studies.bench import Bench
from aerotube.studies.outcome import Compared, Outcome, Table, compare
from aerotube.studies.statistics import Welch, welch
from aerotube.studies.steps_performance import cases
from aerotube.studies.timing import distributions_figure

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

#: Median times of the paper, ms, and its differences of the means, by threads.
PAPER = {"two-step": {8: 95.0, 16: 60.0, 32: 44.0}, "three-step": {8: 133.0, 16: 68.0, 32: 33.0}}
PAPER_DIFFERENCE = {8: 41.5, 16: 7.5, 32: -10.6}
MEASURED, PREDICTED = (1, 2), (8, 16, 32)

#: Beats of a window, as many as the paper computes at once, and how often each form is timed.
WINDOW = 16
WINDOWS = {"exact map": 100, "increment form": 100}


@dataclass(frozen=True)
class _Times:
    """Times of windows in seconds: measured by threads, and on one thread the part outside of the solver and in it."""

    measured: dict[int, Array]
    serial: Array
    parallel: Array

    def at(self, threads: int) -> Array:
        """Measured, or predicted by :func:`predicted`."""
        if threads in self.measured:
            return self.measured[threads]
        return predicted(self.serial, self.parallel, threads)


def predicted(serial: Array, parallel: Array, threads: int, programs: int = 2 * WINDOW) -> Array:
    """Time of a window on so many threads: what is serial, and the longest queue of the programs.

    Parameters
    ----------
    serial, parallel : ndarray
        Time outside of the solver and in it, on one thread.
    threads : int
    programs : int
        Of about the same length; each thread gets as many, but for the last.

    Returns
    -------
    ndarray
        Amdahl's law with whole programs. Threads are taken not to slow each other down.
    """
    return np.asarray(serial + parallel * np.ceil(programs / threads) / programs)


def study(bench: Bench) -> Outcome:
    """Time windows of laws on one and two threads, and predict more."""
    two, three, increment_two, increment_three = cases(bench.settings(CALM)).values()
    kinds = {
        ("exact map", "two-step"): two,
        ("exact map", "three-step"): three,
        ("increment form", "two-step"): increment_two,
        ("increment form", "three-step"): increment_three,
    }
    found = {kind: _time(bench, kind, settings, place / 4) for place, (kind, settings) in enumerate(kinds.items())}
    rows: list[Compared] = []
    tests: dict[tuple[str, int], Welch] = {}
    for form in WINDOWS:
        for threads in (*MEASURED, *PREDICTED):
            rows += _rows(form, threads, found, tests)
    shares = {kind: float(np.median(one.serial / (one.serial + one.parallel))) for kind, one in found.items()}
    samples = {
        f"{form}, {threads} threads, {_how(threads)}: {steps}": 1e3 * one.at(threads)
        for (form, steps), one in found.items()
        for threads in (2, *PREDICTED)
    }
    groups = list(dict.fromkeys(name.split(": ")[0] for name in samples))
    exact = {
        threads: [1e3 * float(np.median(found["exact map", steps].at(threads))) for steps in PAPER]
        for threads in PREDICTED
    }
    faster = "three" if exact[32][1] < exact[32][0] else "two"
    return Outcome(
        dataset=_dataset(found),
        figure=distributions_figure(
            f"Time of the laws of a window of {WINDOW} beats, both halves", samples, 4, groups, "windows"
        ),
        caption="Distributions of times with two and three steps over the number of threads (Fig. 13).",
        compared=tuple(rows),
        verdict=(
            f"{WINDOW} beats on 8, 16 and 32 threads, predicted: two steps "
            f"{', '.join(f'{pair[0]:.0f}' for pair in exact.values())} ms, three steps "
            f"{', '.join(f'{pair[1]:.0f}' for pair in exact.values())} ms; {faster} steps are faster at 32, in the "
            "paper three."
        ),
        notes=(
            f"A time is that of the laws of a window of {WINDOW} beats, both halves, with everything that comes "
            f"before the solver: {2 * WINDOW} programs. The paper's is of a command, with what it says of the "
            "window in its section 4.6.",
            "Measured on 1 and 2 threads. On 8, 16 and 32 predicted: the time outside of the solver stays, the "
            "programs queue on the threads, each as long as on one thread. The row for 2 threads checks the model "
            "where it can be.",
            "Serial shares on one thread: "
            + ", ".join(f"{form}, {steps} {share:.0%}" for (form, steps), share in shares.items())
            + ".",
            "On the exact map two steps find law and ellipsoid together, in a large program; three steps the law in a "
            "held shape, then the ellipsoid, in two small ones, and are faster. In the paper's increment form the "
            "second program of three steps comes on top of a first one that is hardly smaller: slower on one thread, "
            "by less the more threads there are.",
        ),
        tables=(_tests(tests), _model(found)),
    )


def _how(threads: int) -> str:
    return "measured" if threads in MEASURED else "predicted"


def _time(bench: Bench, kind: tuple[str, str], settings: SynthesisSettings, before: float) -> _Times:
    ready = bench.prepared
    windows = min(WINDOWS[kind[0]], max(bench.runs, 2))
    window = min(WINDOW, ready.nominal.beats)
    last = ready.nominal.beats - window

    def make(number: int, threads: int) -> tuple[float, Any]:
        first = number % (last + 1)
        start = time.perf_counter()
        made = compensation.design(
            ready.model, ready.nominal, ready.disturbance, settings, beats=range(first, first + window), workers=threads
        )
        return time.perf_counter() - start, made

    make(0, 1)  # compiles, and makes what all windows share
    measured: dict[int, Array] = {}
    serial, parallel = [], []
    for place, threads in enumerate(MEASURED):
        times = []
        for number in range(windows):
            bench.tell(f"{kind[0]}, {kind[1]}, {threads} thread(s)", before + (place + number / windows) / 8)
            taken, made = make(number, threads)
            times.append(taken)
            if threads == 1:
                inside = float(made.step_seconds.sum())
                serial.append(max(taken - inside, 0.0))
                parallel.append(inside)
        measured[threads] = np.array(times)
    return _Times(measured, np.array(serial), np.array(parallel))


def _rows(
    form: str, threads: int, found: dict[tuple[str, str], _Times], tests: dict[tuple[str, int], Welch]
) -> list[Compared]:
    key = "" if form == "exact map" else "increment_"
    how = _how(threads)
    samples = {steps: 1e3 * found[form, steps].at(threads) for steps in PAPER}
    rows = [
        compare(
            f"{key}{steps.replace('-', '_')}_{threads}",
            f"median time, {steps}, {form}, {threads} thread(s), {how}",
            PAPER[steps].get(threads),
            float(np.median(values)),
            "ms",
        )
        for steps, values in samples.items()
    ]
    test = welch(samples["three-step"], samples["two-step"])
    tests[form, threads] = test
    words = f"mean of three-step less two-step, {form}, {threads} thread(s), {how}"
    told = "significant" if test.significant else "not significant"
    paper = PAPER_DIFFERENCE.get(threads)
    if paper is not None:
        told += "; the same sign as the paper's" if test.difference * paper > 0 else "; the other sign than the paper's"
    rows.append(compare(f"{key}difference_{threads}", words, paper, test.difference, "ms", told))
    return rows


def _dataset(found: dict[tuple[str, str], _Times]) -> xr.Dataset:
    import xarray as xr

    variables: dict[str, Any] = {}
    for (form, steps), one in found.items():
        name, dim = f"{form}_{steps}".replace(" ", "_").replace("-", "_"), f"window_{form}".replace(" ", "_")
        for threads, values in one.measured.items():
            variables[f"{name}_{threads}_threads"] = (dim, values, {"units": "s", "long_name": "measured"})
        for part, values, words in (("serial", one.serial, "outside of"), ("parallel", one.parallel, "in")):
            long_name = f"{words} the solver, one thread"
            variables[f"{name}_{part}"] = (dim, values, {"units": "s", "long_name": long_name})
    return xr.Dataset(variables, attrs={"beats_of_a_window": WINDOW})


def _tests(tests: dict[tuple[str, int], Welch]) -> Table:
    rows = tuple(
        (form, str(threads), f"{test.difference:.2f}", test.words, "yes" if test.significant else "no")
        for (form, threads), test in tests.items()
    )
    head = ("form", "threads", "three-step less two-step (ms)", "p", "significant at 5 %")
    return Table("Welch's t-tests of equal means", head, rows)


def _model(found: dict[tuple[str, str], _Times]) -> Table:
    rows = []
    for (form, steps), one in found.items():
        model = np.median(predicted(one.serial, one.parallel, 2))
        rows.append((form, steps, f"{1e3 * np.median(one.measured[2]):.1f}", f"{1e3 * model:.1f}"))
    head = ("form", "steps", "measured on 2 threads (ms)", "by the model (ms)")
    return Table("The model where it can be checked (medians)", head, tuple(rows))
