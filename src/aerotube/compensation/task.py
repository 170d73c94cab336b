"""What a design is asked for, and what each formulation of its programs hands back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.aircraft.base import Aircraft
from aerotube.compensation.groundwork import Groundwork
from aerotube.compensation.reasons import why
from aerotube.compensation.settings import SynthesisSettings
from aerotube.compensation.terminal import Terminal
from aerotube.nominal import Nominal
from aerotube.tube import DisturbanceSet

Array = NDArray[np.float64]
Beats = NDArray[np.intp]
Tell = Callable[[int], None]


@dataclass(frozen=True)
class Task:
    """What all programs share."""

    aircraft: Aircraft
    nominal: Nominal
    disturbance: DisturbanceSet
    settings: SynthesisSettings
    ground: Groundwork
    workers: int
    deadline: float | None


@dataclass(frozen=True)
class PartLaws:
    """The laws of one part.

    Attributes
    ----------
    rows : ndarray (b, g) of int
        The beats that each law serves.
    coefficients : ndarray (b, m, M)
        Of monomials of SI errors, zero where there is no law.
    feasible, stopped : ndarray (b,) of bool
    bound, seconds : ndarray (b,)
        Of each program.
    messages : list of str
    terminal : Terminal or None
        The ellipsoids that the programs themselves found.
    """

    rows: Beats
    coefficients: Array
    feasible: NDArray[np.bool_]
    stopped: NDArray[np.bool_]
    bound: Array
    seconds: Array
    messages: list[str]
    terminal: Terminal | None = None


def messages(
    task: Task, names: Sequence[tuple[int, Beats]], solution: sos.Solution, failed: NDArray[np.bool_]
) -> list[str]:
    """One sentence for each program of a batch that has no law; names are the part's index and the beats served."""
    out = []
    for position in np.flatnonzero(failed).tolist():
        index, row = names[position]
        part = task.settings.parts[index]
        beats = f"beat {row[0]}" if len(row) == 1 else f"beats {row[0]} to {row[-1]}"
        controls = [task.aircraft.virtual_names[i] for i in part.controls]
        reason = why(solution, position, controls)
        out.append(f"{beats}, {part.name}: no law ({reason}); the nominal alone is flown.")
    return out
