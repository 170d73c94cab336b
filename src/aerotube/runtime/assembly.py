"""A window put together: laws that are kept, designed, held from the beat before, or else the regulator's.

Each law is measured before it is flown; where it has no certificate, or is held and of no use, the regulator flies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerotube.compensation import Design
from aerotube.flight.lqr import time_varying_lqr
from aerotube.nominal import Nominal
from aerotube.runtime.law import Laws
from aerotube.runtime.messages import Rung
from aerotube.runtime.sizes import Sized, sizes, useful, whole, within_limits
from aerotube.runtime.task import Task
from aerotube.runtime.window import Window
from aerotube.tube import tracking_weights

Array = NDArray[np.float64]
Beats = NDArray[np.intp]


def assemble(
    task: Task,
    nominal: Nominal,
    own: Beats,
    behind: Beats,
    kept: NDArray[np.bool_],
    sized: Sized,
    made: Design | None,
    before: Window | None,
) -> Window:
    """Laws of all beats, each measured, and completed by the regulator where nothing is certified.

    Parameters
    ----------
    task : Task
    nominal : Nominal
        As much of it as is looked at.
    own, behind : ndarray (w,), (v,) of int
        Beats of the window, and those for which its last law is measured too.
    kept : ndarray (w,) of bool
        Where the last manoeuvre's law is kept.
    sized : Sized
        Of these laws; it is not looked at elsewhere.
    made : Design, optional
        Of the other beats of the window.
    before : Window, optional
        Of the last manoeuvre.

    Returns
    -------
    Window
    """
    beats, where = np.concatenate([own, behind]), np.flatnonzero(kept)
    shape = len(beats), len(task.settings.parts)
    laws = whole(task, nominal, own[where], None if before is None else before.laws[where])
    draft = _Draft(task, nominal, beats, laws, np.full(shape, int(Rung.LAST)), np.full(shape, -1))
    if before is not None:
        draft.rungs[where], draft.origin[where] = before.rungs[where], where[:, None]
    if made is not None:
        draft.take(made, np.flatnonzero(~kept))
    draft.hold()
    metric = _metric(task, nominal, beats, where, made, before)
    size, kinds = _measured(draft, metric, where, sized)
    first_size = size.copy()
    if before is not None:
        first_size[where] = before.made[where]
    lqr = _regulator(task, nominal, int(own[0]), made, before)
    certified = draft.certified(size, metric)
    draft.fall_back(certified, lqr)
    return Window(
        beats=beats,
        window=len(own),
        laws=laws[beats],
        rungs=draft.rungs,
        size=np.where(certified, size, np.nan),
        kinds=np.where(certified, kinds, -1),
        metric=metric,
        lqr=lqr[own[0] :],
        kept=np.concatenate([kept, np.zeros(len(behind), bool)]),
        made=np.where(certified, first_size, np.nan),
    )


@dataclass(frozen=True)
class _Draft:
    """Laws as they are put together: arrays that are filled in place.

    Attributes
    ----------
    beats : ndarray (b,) of int
    laws : Laws
        Of the whole nominal.
    rungs : ndarray (b, parts) of int
    origin : ndarray (b, parts) of int
        Place among the beats of the one whose law it is; -1: there is none.
    """

    task: Task
    nominal: Nominal
    beats: Beats
    laws: Laws
    rungs: NDArray[np.int64]
    origin: NDArray[np.int64]

    def take(self, made: Design, fresh: Beats) -> None:
        """Put the laws of a design in their places."""
        place = np.searchsorted(made.beats, self.beats[fresh])
        coefficients, reach = made.law.coefficients, made.law.unwhitening
        for i, part in enumerate(self.task.settings.parts):
            there = made.feasible[place, i] | made.stopped[place, i]
            at = fresh[there]
            rows = np.ix_(self.beats[at], part.controls)
            self.laws.coefficients[rows] = coefficients[rows]
            if reach is not None:
                block = np.ix_(self.beats[at], part.errors, part.errors)
                self.laws.reach[block] = reach[block]
            self.rungs[at, i] = np.where(made.feasible[place, i], Rung.PLANNED, Rung.ANYTIME)[there]
            self.origin[at, i] = at

    def hold(self) -> None:
        """Let beats without a law of their own hold the one before them."""
        beats, laws, origin = self.beats, self.laws, self.origin
        for i, part in enumerate(self.task.settings.parts):
            for j in range(1, len(beats)):
                if origin[j, i] >= 0 or origin[j - 1, i] < 0:
                    continue
                source = origin[j, i] = origin[j - 1, i]
                laws.coefficients[beats[j], part.controls] = laws.coefficients[beats[source], part.controls]
                if not self.task.form.linear:
                    block = np.ix_(part.errors, part.errors)
                    laws.reach[beats[j]][block] = laws.reach[beats[source]][block]
                self.rungs[j, i] = Rung.LAST

    def certified(self, size: Array, metric: tuple[Array, ...]) -> NDArray[np.bool_]:
        """Where the laws may be flown: certified, and, if held, useful and within the limits: (b, parts)."""
        out = np.asarray(np.isfinite(size) & (self.origin >= 0))
        held = np.flatnonzero((self.rungs == Rung.LAST).any(1))
        if len(held):
            task, nominal, beats = self.task, self.nominal, self.beats[held]
            helps = useful(task, nominal, beats, self.laws, tuple(shape[held] for shape in metric))
            inside = within_limits(task, nominal, beats, self.laws)
            out[held] &= (self.rungs[held] != Rung.LAST) | (helps & inside)
        return out

    def fall_back(self, certified: NDArray[np.bool_], lqr: Array) -> None:
        """Put the regulator, or nothing, where no law may be flown."""
        laws = self.laws
        for i, part in enumerate(self.task.settings.parts):
            for j in np.flatnonzero(~certified[:, i]):
                rows = self.beats[j], part.controls
                laws.coefficients[rows] = 0.0
                laws.coefficients[self.beats[j], part.controls, :8] = lqr[rows]
                laws.room[rows] = [-np.inf, np.inf]
                self.rungs[j, i] = Rung.LQR if lqr[rows].any() else Rung.NOMINAL


def _measured(draft: _Draft, metric: tuple[Array, ...], where: Beats, sized: Sized) -> tuple[Array, NDArray[np.int64]]:
    """Sizes of all beats' laws and what stands behind them; those of kept laws are known."""
    size, kinds = np.empty(draft.rungs.shape), np.empty(draft.rungs.shape, dtype=np.int64)
    if len(where):
        size[where], kinds[where] = sized.size[where], sized.kinds[where]
    new = np.setdiff1d(np.arange(len(size)), where)
    if len(new):
        shapes = tuple(shape[new] for shape in metric)
        found = sizes(draft.task, draft.nominal, draft.beats[new], draft.laws, shapes)
        size[new], kinds[new] = found.size, found.kinds
    return size, kinds


def _metric(
    task: Task, nominal: Nominal, beats: Beats, where: Beats, made: Design | None, before: Window | None
) -> tuple[Array, ...]:
    """Metric of every beat: the design's, the kept law's, or else that of the nearest beat before that has one."""
    found = []
    weights = tracking_weights(nominal.states, task.coordinates)
    for i, part in enumerate(task.settings.parts):
        shape = weights[beats + 1][:, part.errors][:, :, part.errors].copy()
        known = np.zeros(len(beats), bool)
        if before is not None:
            shape[where], known[where] = before.metric[i][where], True
        if made is not None:
            _, mine, theirs = np.intersect1d(beats, made.beats, return_indices=True)
            new = ~known[mine]
            shape[mine[new]], known[mine] = made.metric[i][theirs[new]], True
        for j in np.flatnonzero(~known):
            if j:
                shape[j] = shape[j - 1]
        found.append(shape)
    return tuple(found)


def _regulator(task: Task, nominal: Nominal, first: int, made: Design | None, before: Window | None) -> Array:
    """Gains (T, 4, 8) along the nominal: of the design's linearisation, or else the last manoeuvre's."""
    if made is not None:
        return time_varying_lqr(
            task.aircraft, nominal, made.linearisation, task.coordinates, noise_weight=task.settings.noise_weight
        ).gains
    out = np.zeros((nominal.beats, 4, 8))
    if before is not None:
        count = min(len(before.lqr), nominal.beats - first)
        out[first : first + count] = before.lqr[:count]
    return out
