"""The terms of the laws in a dataset, complete enough for another tool to evaluate them.

With the errors x of a beat in the coordinates that ``error_coordinates`` names, the increment of the virtual controls
is ``coefficient @ prod(x ** exponent)``, cut off at ``increment_lower`` and ``increment_upper``. Where a law of higher
degree has a ``reach``, and ``d = max(1, |reach @ x|)`` over the states of a part exceeds one, it is d times that of
``x / d`` for the terms in these states.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from aerotube.results.record import STATE_UNITS, STATES, Law

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

_UNITS = {"units": "virtual control over monomial_units, SI; throttle row in N"}
_INCREMENT = {"units": "virtual control, SI; throttle in N"}


def put_terms(dataset: xr.Dataset, laws: Mapping[str, Law]) -> None:
    """Label the terms of all laws, on one list of monomials that holds those of each."""
    rows = list(dict.fromkeys(tuple(row) for law in laws.values() for row in law.exponents.tolist()))
    dataset.coords["monomial"] = (
        "monomial",
        [_product(STATES, row) for row in rows],
        {"long_name": "product of errors"},
    )
    dataset.coords["monomial_units"] = ("monomial", [_product(STATE_UNITS, row) for row in rows])
    dataset["exponent"] = (("monomial", "state"), np.array(rows), {"long_name": "of each error in a monomial"})
    shape = next(iter(laws.values())).coefficients.shape[:2]
    table = np.zeros((len(laws), *shape, len(rows)))
    for place, law in enumerate(laws.values()):
        table[place][..., [rows.index(tuple(row)) for row in law.exponents.tolist()]] = law.coefficients
    dataset["coefficient"] = (
        ("law", "beat", "control", "monomial"),
        table,
        _UNITS | {"long_name": "of the law's monomials"},
    )
    dataset["error_coordinates"] = (
        "law",
        [law.coordinates for law in laws.values()],
        {"long_name": "attitude errors: rotation relative to the nominal, or euler differences"},
    )
    open_ends = np.broadcast_to([-np.inf, np.inf], (*shape, 2))
    room = np.stack([open_ends if law.room is None else law.room for law in laws.values()])
    for side, name in enumerate(("lower", "upper")):
        words = f"{'least' if name == 'lower' else 'largest'} increment, where the law cuts itself off"
        dataset[f"increment_{name}"] = (("law", "beat", "control"), room[..., side], _INCREMENT | {"long_name": words})
    if any(law.reach is not None for law in laws.values()):
        empty = np.zeros((shape[0], 8, 8))  # everything is within reach
        dataset["reach"] = (
            ("law", "beat", "reach_row", "state"),
            np.stack([empty if law.reach is None else law.reach for law in laws.values()]),
            {"units": "1 over state units", "long_name": "within one over a part's states, the law is its polynomial"},
        )


def _product(names: tuple[str, ...], powers: tuple[int, ...]) -> str:
    """A product in words: "V alpha^2"; units in brackets, "(m/s) rad^2"."""
    factors = []
    for name, power in zip(names, powers, strict=True):
        if power:
            base = f"({name})" if "/" in name and sum(powers) > 1 else name
            factors.append(base if power == 1 else f"{base}^{power}")
    return " ".join(factors)
