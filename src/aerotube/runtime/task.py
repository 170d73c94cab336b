"""What windows of laws are computed from, and their design in the time that there is."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.compensation import Design, LinearLaw, SynthesisSettings, design
from aerotube.compensation.groundwork import groundwork
from aerotube.dynamics.errors import ErrorCoordinates
from aerotube.nominal import Nominal
from aerotube.runtime.law import Form
from aerotube.tube import DisturbanceSet

Array = NDArray[np.float64]

_LONG = 0.1  # s a program may take from which on they are solved one by one
_GRANTED = 1.5  # equal shares of the time that is left that they may take: what easy ones leave, hard ones use


@dataclass(frozen=True)
class Task:
    """What every window is computed from.

    Attributes
    ----------
    aircraft : Aircraft
        The model that laws are computed on.
    disturbance : DisturbanceSet
    settings : SynthesisSettings
    window : int
        Beats of a window.
    around : int
        Beats before and after the window that the forecast of errors and costs looks at; the numbers are those of
        the whole manoeuvre where it is no longer than that.
    validity : int
        Beats after a window for which its last law is measured, in case the next window is late.
    tolerance : float or None
        Event-triggered: largest growth of a kept law's certified size, as a share of it. None: all is designed.
    workers : int
        Threads that solve.
    """

    aircraft: Aircraft
    disturbance: DisturbanceSet
    settings: SynthesisSettings
    window: int = 16
    around: int = 60
    validity: int = 3
    tolerance: float | None = None
    workers: int = 2

    @property
    def reuse(self) -> int:
        """Beats that a law serves beyond its own."""
        return self.settings.reuse

    @property
    def coordinates(self) -> ErrorCoordinates:
        """In which the laws are given the error."""
        return ErrorCoordinates(self.settings.attitude)

    @cached_property
    def form(self) -> Form:
        """Of the laws."""
        return Form.of(self.settings)


def design_in(task: Task, nominal: Nominal, beats: NDArray[np.intp], budget: float | None) -> Design:
    """Design the laws of some beats in so many seconds; without a limit for None.

    Programs that take long are solved one by one, in as many threads as there are: what an easy one leaves of its time
    is there for a hard one.
    """

    def some(own: NDArray[np.intp], deadline: float | None, workers: int) -> Design:
        return design(
            task.aircraft, nominal, task.disturbance, task.settings, beats=own, workers=workers, deadline=deadline
        )

    if budget is None:
        return some(beats, None, task.workers)
    until = time.perf_counter() + budget
    laws = beats // (task.reuse + 1)
    every, parts = np.unique(laws), len(task.settings.parts)
    share = budget * task.workers / (len(every) * parts)
    if share < _LONG:
        return some(beats, max(share, 1e-6), task.workers)
    groundwork(task.aircraft, nominal, task.disturbance, task.settings)  # once, and not in every thread
    waiting, lock = len(every), threading.Lock()

    def one(law: int) -> Design:
        nonlocal waiting
        with lock:
            turns = -(-waiting // task.workers)
            waiting -= 1
        left = (until - time.perf_counter()) * min(_GRANTED / turns, 1.0)
        return some(beats[laws == law], max(left / parts, 1e-6), 1)

    with ThreadPoolExecutor(task.workers) as pool:
        return _joined(list(pool.map(one, every.tolist())))


def _joined(designs: list[Design]) -> Design:
    """One design of several of the same nominal, whose beats follow one another."""
    first = designs[0]

    def along(name: str) -> Array:
        return np.concatenate([getattr(one, name) for one in designs])

    law: Any = first.law
    held = "gains" if isinstance(law, LinearLaw) else "coefficients"
    return replace(
        first,
        law=replace(law, **{held: np.sum([getattr(one.law, held) for one in designs], axis=0)}),
        beats=along("beats").astype(np.intp),
        metric=tuple(np.concatenate(own) for own in zip(*(one.metric for one in designs), strict=True)),
        feasible=along("feasible").astype(bool),
        stopped=along("stopped").astype(bool),
        messages=[message for one in designs for message in one.messages],
        bound=along("bound"),
        step_seconds=along("step_seconds"),
        terminal=None,
    )
