"""Laws for a window of beats: designed, certified, and completed down the ladder where there is none.

Everything that is flown is measured first, for every beat and part, on the nominal that will be flown. The same
measurement decides what else may be flown there:

* a law stopped at the solver's deadline, if its size is certified;
* the law of an earlier beat, where a beat has none of its own, if its size has a certificate too, if it keeps the
  controls within their limits, and if, to first order and measured exactly, it leaves errors no larger than the nominal
  alone would (an error of the measurement adds to every law's size, and nothing to the nominal's);
* the law that the last manoeuvre flew at the same beat, if the nominal has moved by no more than it tolerates: its
  certified size on the new nominal is at most a stated factor of its size where it was made, in the same metric, and
  it keeps the controls within their limits there. Then nothing is designed anew (event-triggered recomputation).

A law that saturates keeps the controls within their limits by cutting itself off, and the cut is in what is measured.

Sizes are those of :func:`aerotube.compensation.flown_size`, and every one of them says what stands behind it: samples
of the aircraft as it flies ("sampled") unless the settings ask for less, or the polynomial through the closed loop at
the nodes ("polynomial only"). Rigorous certificates take longer than a flight has; `aerotube run` gives them for the
same laws.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerotube.compensation import KINDS, Design
from aerotube.flight.lqr import time_varying_lqr
from aerotube.nominal import Nominal
from aerotube.runtime.law import Laws
from aerotube.runtime.messages import Rung
from aerotube.runtime.sizes import Sized, sizes, useful, whole, within_limits
from aerotube.runtime.task import Task, design_in
from aerotube.tube import tracking_weights

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Window:
    """Laws of some beats.

    Attributes
    ----------
    beats : ndarray (b,) of int
        Of the window, and behind them those for which the last law was measured too.
    window : int
        How many of them are the window's own.
    laws : Laws
        Of b beats.
    rungs : ndarray (b, parts) of int
        What stands behind each part of them, see `Rung`; for the beats behind the window, of the last law there.
    size : ndarray (b, parts)
        Certified; NaN where the part flies something that is not certified.
    kinds : ndarray (b, parts) of int
        What stands behind the sizes, an index of `aerotube.compensation.KINDS`; -1 where nothing does.
    metric : tuple of ndarray (b, n, n)
        In which the size of each part is measured.
    lqr : ndarray (b', 4, 8)
        Gains of the regulator from the first beat of the window to the end of the look-ahead.
    kept : ndarray (b,) of bool
        Beats whose law is the last manoeuvre's, checked and found to hold.
    made : ndarray (b, parts)
        Certified sizes where the laws were designed; kept ones may have grown since.
    designed : int
        Programs of a law that were solved.
    seconds : dict of float
        Wall-clock time by what was done.
    messages : tuple of str
    """

    beats: NDArray[np.intp]
    window: int
    laws: Laws
    rungs: NDArray[np.int64]
    size: Array
    kinds: NDArray[np.int64]
    metric: tuple[Array, ...]
    lqr: Array
    kept: NDArray[np.bool_]
    made: Array
    designed: int
    seconds: dict[str, float] = field(default_factory=dict)
    messages: tuple[str, ...] = ()


def compute(
    task: Task,
    nominal: Nominal,
    beats: range,
    *,
    before: Window | None = None,
    budget: float | None = None,
) -> Window:
    """Compute the laws of a window.

    Parameters
    ----------
    task : Task
    nominal : Nominal
        The whole manoeuvre as it will be flown.
    beats : range
        The window.
    before : Window, optional
        Of the same beats of the manoeuvre before, for event-triggered recomputation.
    budget : float, optional
        Seconds for the design of the laws; a program that is not done with its share of them is stopped.

    Returns
    -------
    Window

    Raises
    ------
    InputError, ComputationError
        As :func:`aerotube.compensation.design` does.
    """
    seconds: dict[str, float] = {}
    first = max(beats.start - task.around, 0)
    first -= first % (task.reuse + 1)
    last = min(beats.stop + max(task.around, task.validity), nominal.beats)
    cut = Nominal(nominal.dt, nominal.states[first : last + 1], nominal.controls[first:last])
    own = np.arange(beats.start, beats.stop) - first
    behind = np.arange(beats.stop, min(beats.stop + task.validity, nominal.beats)) - first
    clock = time.perf_counter()
    kept, sized = np.zeros(len(own), bool), Sized(np.empty((0, 0)), np.empty((0, 0), dtype=np.int64))
    if task.tolerance is not None and before is not None and len(before.rungs) >= len(own):
        kept, sized = still_valid(task, cut, own, before)
        seconds["check"] = time.perf_counter() - clock
        clock = time.perf_counter()
    if task.reuse:  # beats that share a law keep it together or not at all
        shared = (own + first) // (task.reuse + 1)
        kept &= ~np.isin(shared, shared[~kept])
    fresh = np.flatnonzero(~kept)
    made = None
    if len(fresh):
        made = design_in(task, cut, own[fresh], budget)
        seconds["design"] = time.perf_counter() - clock
        clock = time.perf_counter()
    laws = _assemble(task, cut, own, behind, fresh, kept, sized, made, before)
    seconds["certify"] = time.perf_counter() - clock
    return Window(
        beats=np.concatenate([own, behind]) + first,
        window=len(own),
        designed=-(-len(fresh) // (task.reuse + 1)) * len(task.settings.parts),
        seconds=seconds,
        messages=(*(() if made is None else made.messages), *_told(task, laws)),
        **laws,
    )


def still_valid(
    task: Task, nominal: Nominal, beats: NDArray[np.intp], before: Window
) -> tuple[NDArray[np.bool_], Sized]:
    """Where the laws of the manoeuvre before hold on a new nominal, by the rule of the module's text.

    Returns
    -------
    holds : ndarray (b,) of bool
    sized : Sized
        Of b beats; NaN where it was not worth asking.
    """
    assert task.tolerance is not None
    count, parts = len(beats), len(task.settings.parts)
    certified = np.asarray(np.isfinite(before.made[:count]).all(1) & (before.rungs[:count] <= Rung.LAST).all(1))
    if not certified.any():
        return certified, Sized(np.full((count, parts), np.nan), np.full((count, parts), -1))
    laws = whole(task, nominal, beats, before.laws[:count])
    sized = sizes(task, nominal, beats, laws, tuple(shape[:count] for shape in before.metric))
    tolerated = (sized.size <= (1.0 + task.tolerance) * before.made[:count]).all(1)
    inside = within_limits(task, nominal, beats, laws).all(1)
    return np.asarray(certified & tolerated & inside), sized


def _assemble(
    task: Task,
    nominal: Nominal,
    own: NDArray[np.intp],
    behind: NDArray[np.intp],
    fresh: NDArray[np.intp],
    kept: NDArray[np.bool_],
    sized: Sized,
    made: Design | None,
    before: Window | None,
) -> dict[str, Any]:
    """Laws of all beats, each measured, and completed by the regulator where nothing is certified."""
    parts, beats = task.settings.parts, np.concatenate([own, behind])
    count = len(beats)
    laws = whole(task, nominal, own[kept], None if before is None else before.laws[np.flatnonzero(kept)])
    rungs = np.full((count, len(parts)), int(Rung.LAST))
    origin = np.full((count, len(parts)), -1)
    if before is not None and kept.any():
        where = np.flatnonzero(kept)
        rungs[where], origin[where] = before.rungs[where], where[:, None]
    if made is not None:
        _take(task, made, laws, own, fresh, rungs, origin)
    _hold(task, laws, rungs, origin, beats)
    metric = _metric(task, nominal, beats, kept, made, before)
    kept = np.concatenate([kept, np.zeros(len(behind), bool)])
    size, kinds = np.empty((count, len(parts))), np.empty((count, len(parts)), dtype=np.int64)
    if kept.any():
        size[kept], kinds[kept] = sized.size[kept[: len(own)]], sized.kinds[kept[: len(own)]]
    new = np.flatnonzero(~kept)
    if len(new):
        found = sizes(task, nominal, beats[new], laws, tuple(shape[new] for shape in metric))
        size[new], kinds[new] = found.size, found.kinds
    first_size = size.copy()
    if before is not None and kept.any():
        first_size[kept] = before.made[: len(own)][kept[: len(own)]]
    lqr = np.zeros((nominal.beats, 4, 8)) if before is None else _padded(before.lqr, own[0], nominal.beats)
    if made is not None:
        lqr = time_varying_lqr(
            task.aircraft, nominal, made.linearisation, task.coordinates, noise_weight=task.settings.noise_weight
        ).gains
    certified = np.isfinite(size) & (origin >= 0)
    held = np.flatnonzero((rungs == Rung.LAST).any(1))
    if len(held):
        helps = useful(task, nominal, beats[held], laws, tuple(shape[held] for shape in metric))
        inside = within_limits(task, nominal, beats[held], laws)
        certified[held] &= (rungs[held] != Rung.LAST) | (helps & inside)
    for i, part in enumerate(parts):
        for j in np.flatnonzero(~certified[:, i]):
            rows = beats[j], part.controls
            laws.coefficients[rows] = 0.0
            laws.coefficients[beats[j], part.controls, :8] = lqr[rows]
            laws.room[rows] = [-np.inf, np.inf]
            rungs[j, i] = Rung.LQR if lqr[rows].any() else Rung.NOMINAL
    return {
        "laws": laws[beats],
        "rungs": rungs,
        "size": np.where(certified, size, np.nan),
        "kinds": np.where(certified, kinds, -1),
        "metric": metric,
        "lqr": lqr[own[0] :],
        "kept": kept,
        "made": np.where(certified, first_size, np.nan),
    }


def _take(
    task: Task,
    made: Design,
    laws: Laws,
    own: NDArray[np.intp],
    fresh: NDArray[np.intp],
    rungs: NDArray[np.int64],
    origin: NDArray[np.int64],
) -> None:
    """Put the laws of a design in their places."""
    place = np.searchsorted(made.beats, own[fresh])
    coefficients, reach = made.law.coefficients, made.law.unwhitening
    for i, part in enumerate(task.settings.parts):
        there = made.feasible[place, i] | made.stopped[place, i]
        at = fresh[there]
        rows = np.ix_(own[at], part.controls)
        laws.coefficients[rows] = coefficients[rows]
        if reach is not None:
            block = np.ix_(own[at], part.errors, part.errors)
            laws.reach[block] = reach[block]
        rungs[at, i] = np.where(made.feasible[place, i], Rung.PLANNED, Rung.ANYTIME)[there]
        origin[at, i] = at


def _hold(task: Task, laws: Laws, rungs: NDArray[np.int64], origin: NDArray[np.int64], beats: NDArray[np.intp]) -> None:
    """Let beats without a law of their own hold the one before them."""
    for i, part in enumerate(task.settings.parts):
        for j in range(1, len(beats)):
            if origin[j, i] >= 0 or origin[j - 1, i] < 0:
                continue
            source = origin[j, i] = origin[j - 1, i]
            laws.coefficients[beats[j], part.controls] = laws.coefficients[beats[source], part.controls]
            if not task.form.linear:
                block = np.ix_(part.errors, part.errors)
                laws.reach[beats[j]][block] = laws.reach[beats[source]][block]
            rungs[j, i] = Rung.LAST


def _metric(
    task: Task,
    nominal: Nominal,
    beats: NDArray[np.intp],
    kept: NDArray[np.bool_],
    made: Design | None,
    before: Window | None,
) -> tuple[Array, ...]:
    """Metric of every beat: the design's, the kept law's, or else that of the nearest beat before that has one."""
    found = []
    weights = tracking_weights(nominal.states, task.coordinates)
    for i, part in enumerate(task.settings.parts):
        shape = weights[beats + 1][:, part.errors][:, :, part.errors].copy()
        known = np.zeros(len(beats), bool)
        if before is not None and kept.any():
            where = np.flatnonzero(kept)
            shape[where], known[where] = before.metric[i][where], True
        if made is not None:
            common, mine, theirs = np.intersect1d(beats, made.beats, return_indices=True)
            new = ~known[mine]
            shape[mine[new]], known[mine] = made.metric[i][theirs[new]], True
            del common
        for j in np.flatnonzero(~known):
            if j:
                shape[j] = shape[j - 1]
        found.append(shape)
    return tuple(found)


def _told(task: Task, laws: dict[str, Any]) -> list[str]:
    """One sentence if certificates are less than was asked for."""
    asked = KINDS.index(task.settings.certificate)
    kinds = laws["kinds"]
    less = (kinds >= 0) & (kinds < asked)
    if not less.any():
        return []
    found = ", ".join(f"{int((kinds[less] == number).sum())} {KINDS[number]}" for number in np.unique(kinds[less]))
    return [f"certificates are less than {KINDS[asked]!r}, which takes longer than a flight has or failed: {found}."]


def _padded(gains: Array, first: int, beats: int) -> Array:
    out = np.zeros((beats, 4, 8))
    count = min(len(gains), beats - first)
    out[first : first + count] = gains[:count]
    return out
