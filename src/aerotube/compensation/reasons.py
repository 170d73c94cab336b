"""Why a program has no law, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aerotube import sos


def why(solution: sos.Solution, position: int, controls: Sequence[str]) -> str:
    """Say why a program of a batch has no law: which requirements, by how much, in which direction.

    Parameters
    ----------
    solution : sos.Solution
    position : int
        Of the program in the batch.
    controls : sequence of str
        Names of the part's virtual controls.

    Returns
    -------
    str
        Without a full stop. Amounts of limits are shares of the control's room (of half its range for a law of
        higher degree), those of tubes shares of the tube without compensation; directions of tubes are whitened
        errors, those of limits on a set with corners these by number (not of a box in many errors, which has too many).
    """
    status = sos.Status(int(solution.status[position]))
    if status != sos.Status.INFEASIBLE:
        return str(status)
    found = solution.explain((position,))
    if not found.conflicts:
        return "infeasible"
    parts = []
    for conflict in found.conflicts:
        what = _requirement(conflict.name, controls)
        if conflict.kind == "sos":
            at = np.array2string(conflict.direction, precision=2, suppress_small=True, max_line_width=200)
            what += f" at {at}"
        elif conflict.kind == "linear" and not any(v.name.startswith("reach/") for v in solution.structure.variables):
            what += f" at corner {int(np.argmax(conflict.direction))}"
        parts.append(f"{what}, {conflict.share:.0%} of the conflict")
    text = f"infeasible: {'; '.join(parts)}"
    return text + (f"; one is missed by {found.amount:.2g} at least" if found.amount > 0 else "; without proof")


def _requirement(name: str, controls: Sequence[str]) -> str:
    kind, _, number = name.partition("/")
    words = {
        "limit": "limit of",
        "above": "upper limit of",
        "below": "lower limit of",
    }
    if kind in words:
        return f"{words[kind]} the {controls[int(number)]}"
    return {
        "mean": "mean square of the error",
        "worst": "worst case of the error",
        "effort": "effect of the control",
        "tube": "tube",
        "terminal": "least terminal shape",
    }.get(kind, name)
