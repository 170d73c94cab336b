"""Laws for a window of beats: designed, certified, and completed down the ladder where there is none.

Everything that is flown is measured first, for every beat and part, on the nominal that will be flown. The same
measurement decides what else may be flown there:

* a law stopped at the solver's deadline, if its size is certified;
* the law of an earlier beat, where a beat has none of its own, if its size has a certificate too, if it keeps the
  limits (see below), and if, to first order and measured exactly, it leaves errors no larger than the nominal alone
  would (an error of the measurement adds to every law's size, and nothing to the nominal's);
* the law that the last manoeuvre flew at the same beat, if the nominal has moved by no more than it tolerates: its
  certified size on the new nominal is at most a stated factor of its size where it was made, in the same metric, and
  it keeps the limits there. Then nothing is designed anew (event-triggered recomputation).

A law keeps the limits of a nominal if it keeps the controls, for all errors as they are measured (of the disturbance
box, or where `limits = "ellipsoid"` of the ellipsoid around it), within the room that this nominal leaves there, and,
where there are `rate_limits`, within its share of what the nominal's own changes leave of the rate. A law that
saturates keeps them by cutting itself off, and the cut is in what is measured.

Sizes are those of :func:`aerotube.compensation.flown_size`, and every one of them says what stands behind it: samples
of the aircraft as it flies ("sampled") unless the settings ask for less, or the polynomial through the closed loop at
the nodes ("polynomial only"). Rigorous certificates take longer than a flight has; `aerotube run` gives them for the
same laws.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from aerotube.compensation import KINDS
from aerotube.nominal import Nominal
from aerotube.runtime.assembly import assemble
from aerotube.runtime.messages import Rung
from aerotube.runtime.sizes import Sized, sizes, whole, within_limits
from aerotube.runtime.task import Task, design_in
from aerotube.runtime.window import Window


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
    window = assemble(task, cut, own, behind, kept, sized, made, before)
    seconds["certify"] = time.perf_counter() - clock
    return replace(
        window,
        beats=window.beats + first,
        designed=-(-len(fresh) // (task.reuse + 1)) * len(task.settings.parts),
        seconds=seconds,
        messages=(*(() if made is None else made.messages), *_told(task, window.kinds)),
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


def _told(task: Task, kinds: NDArray[np.int64]) -> list[str]:
    """One sentence if certificates are less than was asked for."""
    asked = KINDS.index(task.settings.certificate)
    less = (kinds >= 0) & (kinds < asked)
    if not less.any():
        return []
    found = ", ".join(f"{int((kinds[less] == number).sum())} {KINDS[number]}" for number in np.unique(kinds[less]))
    return [f"certificates are less than {KINDS[asked]!r}, which takes longer than a flight has or failed: {found}."]
