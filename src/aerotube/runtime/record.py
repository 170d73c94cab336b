"""What a flight writes down, beat by beat, while it flies: plain arrays, filled in place."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerotube.compensation import KINDS
from aerotube.compensation.bounds import NONE
from aerotube.runtime.commander import Command, Source
from aerotube.runtime.law import Form, Laws
from aerotube.runtime.messages import Rung

Array = NDArray[np.float64]


@dataclass
class WindowTimes:
    """How the computation of a window went; moments on the monotonic clock, s.

    Attributes
    ----------
    first, beats : int
        The beats, counted from take-off.
    asked, started, done : float
        Infinite for what never was.
    attempts : int
    computed : int
        Beats that were still to come when its turn came, and have laws.
    designed, kept : int
        Programs of laws solved, and beats whose old law was found to hold.
    seconds : dict of float
        By what was done.
    error : str
    """

    first: int
    beats: int
    asked: float
    started: float
    done: float
    attempts: int
    computed: int = 0
    designed: int = 0
    kept: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    error: str = ""


class Record:
    """The log of a flight.

    Parameters
    ----------
    beats : int
        Of the whole flight, all manoeuvres together.
    states, parts : int
        States that are measured; parts of the synthesis.
    form : Form
        Of the laws.

    Attributes
    ----------
    measured : ndarray (g, n)
        States as they were received; NaN where none was used.
    source, rung : ndarray (g,) and (g, parts) of int
        See `Source` and `Rung`; -1 where the beat was not reached.
    laws : Laws
        Of g beats.
    size : ndarray (g, parts)
        Certified size of the law's tube.
    kind : ndarray (g, parts) of int
        What stands behind it, an index of `aerotube.compensation.KINDS`; -1 where nothing does: no certified law, or
        none that was given a measurement of its own, which every tube presumes.
    metric : ndarray (g, 8, 8)
        In which sizes are measured, part by part.
    error : ndarray (g, 8)
        What the law was given.
    command : ndarray (g, 4)
    clamped : ndarray (g, 4) of bool
    nominal_state : ndarray (g, n')
    nominal_end : ndarray (g, n')
        At the end of the beat.
    nominal_control : ndarray (g, 4)
    due, arrived, sent : ndarray (g,)
        Moments; NaN where there is none.
    law_late : ndarray (g,) of bool
        The beat's window was not there when it was needed.
    windows : list of WindowTimes
    refused : Counter
        Datagrams and measurements that were not taken, by reason.
    events : list of (float, str)
    """

    def __init__(self, beats: int, states: int, parts: int, form: Form) -> None:
        nan = np.nan
        self.beats = beats
        self.measured = np.full((beats, states), nan)
        self.source = np.full(beats, -1)
        self.rung = np.full((beats, parts), -1)
        self.form, self.laws = form, Laws.none(form, beats)
        self.size = np.full((beats, parts), nan)
        self.kind = np.full((beats, parts), -1)
        self.metric = np.zeros((beats, 8, 8))
        self.error = np.full((beats, 8), nan)
        self.command = np.full((beats, 4), nan)
        self.clamped = np.zeros((beats, 4), bool)
        self.nominal_state = np.full((beats, 13), nan)
        self.nominal_end = np.full((beats, 13), nan)
        self.nominal_control = np.full((beats, 4), nan)
        self.due, self.arrived, self.sent = (np.full(beats, nan) for _ in range(3))
        self.law_late = np.zeros(beats, bool)
        self.windows: list[WindowTimes] = []
        self.refused: Counter[str] = Counter()
        self.events: list[tuple[float, str]] = []
        self.flown = 0

    def put(self, beat: int, command: Command, rungs: Any, size: Any, kinds: Any, measured: Array | None) -> None:
        """Write down a beat's command."""
        if measured is not None:
            self.measured[beat, : len(measured)] = measured
        self.source[beat] = command.source
        # what was not asked stands behind nothing
        self.rung[beat] = rungs if command.rung != Rung.NOMINAL else Rung.NOMINAL
        if command.rung != Rung.NOMINAL and command.source == Source.MEASURED:
            self.size[beat], self.kind[beat] = size, kinds
        self.error[beat], self.command[beat], self.clamped[beat] = command.error, command.control, command.clamped
        self.flown = beat + 1

    def fly(self, beat: int, law: Laws, metric: Array) -> None:
        """Write down a beat's law, and the metric in which its sizes are measured."""
        self.metric[beat] = metric
        self.laws.coefficients[beat], self.laws.room[beat], self.laws.reach[beat] = (
            law.coefficients,
            law.room,
            law.reach,
        )

    def certificates(self) -> dict[str, int]:
        """Beats by the certificate of the part that has the least."""
        least = self.kind[: self.flown].min(axis=1, initial=len(KINDS))
        counts = {kind: int((least == number).sum()) for number, kind in enumerate(KINDS)}
        return {**{kind: counts[kind] for kind in KINDS[::-1] if counts[kind]}, NONE: int((least < 0).sum())}

    def fallbacks(self) -> dict[str, int]:
        """Beats on each rung below the plan, and beats without a measurement of their own."""
        worst = self.rung[: self.flown].max(axis=1, initial=0)
        count = {rung.name.lower(): int((worst == rung).sum()) for rung in Rung if rung != Rung.PLANNED}
        source = self.source[: self.flown]
        count["predicted_state"] = int((source == Source.PREDICTED).sum())
        count["no_state"] = int((source == Source.NONE).sum())
        count["no_command"] = int((source == -1).sum())
        return count
