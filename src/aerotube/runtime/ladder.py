"""The ladder of fallbacks: what is flown in a beat, whether its window of laws is there or not."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aerotube.compensation import COUPLED
from aerotube.compensation.tubes import regrouped
from aerotube.nominal import Nominal
from aerotube.runtime.law import Laws
from aerotube.runtime.messages import Rung
from aerotube.runtime.task import Task
from aerotube.runtime.window import Window

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Chosen:
    """What is flown in a beat: the law, and of each part its rung, its certified size and what stands behind that.

    Attributes
    ----------
    law : Laws
        Of the one beat.
    rungs, kinds : ndarray (parts,) of int
    size : ndarray (parts,)
    metric : ndarray (8, 8)
        In which the sizes are measured, part by part; zero where nothing is certified.
    """

    law: Laws
    rungs: NDArray[np.int64]
    size: Array
    kinds: NDArray[np.int64]
    metric: Array


class Ladder:
    """Laws of a flight for the beats to come, and what else may be flown there.

    Parameters
    ----------
    task : Task
        Gives the laws' form and their parts.
    planned : Nominal
        Of every manoeuvre, where no other is decided on.

    Attributes
    ----------
    nominals : dict of int to Nominal
        That are decided on, by beat from take-off.
    planned : dict of int to Chosen
        Of the windows that hold the beats.
    held : dict of int to Chosen
        Of the windows before, certified for these beats too.
    lqr : dict of int to ndarray (4, 8)
        Gains of the regulator.
    earlier : dict of int to (Chosen, Nominal)
        Certified laws of the last manoeuvre that had one, by beat of the manoeuvre, and what they are certified on.
    earlier_lqr : dict of int to ndarray (4, 8)
        By beat of the manoeuvre.
    """

    def __init__(self, task: Task, planned: Nominal) -> None:
        self._form, self._parts = task.form, task.settings.parts
        self._nominal, self._horizon = planned, planned.beats
        self.nominals: dict[int, Nominal] = {}
        self.planned: dict[int, Chosen] = {}
        self.held: dict[int, Chosen] = {}
        self.lqr: dict[int, Array] = {}
        self.earlier: dict[int, tuple[Chosen, Nominal]] = {}
        self.earlier_lqr: dict[int, Array] = {}
        self._over = -1  # the last beat that is let go of

    def decide(self, beats: range, nominal: Nominal) -> None:
        """Say along what beats will be flown, those that are still to come."""
        for beat in beats[max(self._over + 1 - beats.start, 0) :]:
            self.nominals[beat] = nominal

    def nominal(self, beat: int) -> Nominal:
        """What a beat is flown along."""
        return self.nominals.get(beat, self._nominal)

    def best(self, beat: int) -> tuple[Chosen, bool]:
        """Down the ladder: what is flown, and whether the beat's window is late.

        A last law is that of the window before, where it was certified for this beat, or that of the manoeuvre before
        at this beat, if the nominal is the very same.
        """
        found = self.planned.get(beat)
        if found is not None:
            return found, False
        found = self.held.get(beat)
        if found is not None:
            return found, True
        number = beat % self._horizon
        earlier = self.earlier.get(number)
        if earlier is not None and earlier[1] is self.nominals.get(beat):
            return replace(earlier[0], rungs=np.maximum(earlier[0].rungs, Rung.LAST)), True
        gain = self.lqr.get(beat, self.earlier_lqr.get(number))
        if gain is not None:
            return self._uncertified(gain, Rung.LQR), True
        return self._uncertified(np.zeros((4, 8)), Rung.NOMINAL), True

    def install(self, window: Window, manoeuvre: int, nominal: Nominal) -> None:
        """Put the laws of a window, and what is known behind it, where the beats will look for them.

        Beats that are over do not look again: a late window leaves nothing there but what later manoeuvres may use.
        """
        start = manoeuvre * self._horizon
        (metric,) = regrouped(window.metric, self._parts, COUPLED)
        for j, beat in enumerate(window.beats + start):
            own, certified = j < window.window, bool((window.rungs[j] <= Rung.LAST).all())
            chosen = Chosen(window.laws[j], window.rungs[j], window.size[j], window.kinds[j], metric[j])
            if (own or certified) and beat > self._over:
                (self.planned if own else self.held)[int(beat)] = chosen
            if own and certified:
                self.earlier[int(beat) % self._horizon] = chosen, nominal
        for number, gain in enumerate(window.lqr, int(window.beats[0])):
            self.earlier_lqr[number] = gain
            if start + number > self._over:
                self.lqr[start + number] = gain

    def forget(self, beat: int) -> None:
        """Let go of what was there for a beat that is over; beats end in their order."""
        self._over = max(self._over, beat)
        for store in (self.planned, self.held, self.lqr, self.nominals):
            store.pop(beat, None)

    def _uncertified(self, gains: Array, rung: Rung) -> Chosen:
        parts = len(self._parts)
        law = Laws.linear(self._form, gains[None])[0]
        return Chosen(law, np.full(parts, int(rung)), np.full(parts, np.nan), np.full(parts, -1), np.zeros((8, 8)))
