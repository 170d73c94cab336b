"""Disturbance sets: what a tube must withstand at the start of a beat."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.dynamics.errors import ERROR_NAMES
from aerotube.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DisturbanceBox:
    """Independent bounds on each error and each uncertain quantity (Table 2).

    Attributes
    ----------
    half_widths : ndarray (8,)
        Largest difference of ``[V, alpha, q, theta, beta, p, r, phi]`` (Euler angles) either way, SI and
        radians; all positive.
    relative : mapping of str to float
        Largest relative change, either way, of an uncertain quantity: ``{"mass": 0.05}`` is five percent.

    Raises
    ------
    InputError
        If a width is not positive, or a relative change not in [0, 1).
    """

    half_widths: Array
    relative: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        widths = np.asarray(self.half_widths, dtype=float)
        if widths.shape != (8,):
            raise InputError(f"disturbance: {widths.shape} half-widths given; give eight, {', '.join(ERROR_NAMES)}.")
        for name, width in zip(ERROR_NAMES, widths, strict=True):
            if not (np.isfinite(width) and width > 0):
                raise InputError(f"disturbance: the half-width of {name} is {width}; give a positive number.")
        for name, change in self.relative.items():
            if not 0 <= change < 1:
                raise InputError(f"disturbance: the relative change of {name} is {change}; give one in [0, 1).")
        object.__setattr__(self, "half_widths", widths)

    def parameter_vertices(self, aircraft: Aircraft) -> Array:
        """Extreme values of the aircraft's uncertain parameters.

        Where the map is affine in the parameters, a convex measure of its result is largest at one of these; where
        it is nearly so, they are where the worst case is taken.

        Parameters
        ----------
        aircraft : Aircraft

        Returns
        -------
        ndarray (k, p)
            ``k`` is two to the number of quantities with a nonzero change.

        Raises
        ------
        InputError
            If the aircraft does not know a quantity.
        """
        ranges = parameter_ranges(aircraft, self.relative)
        choices = [(low,) if low == high else (low, high) for low, high in ranges]
        return np.array(list(itertools.product(*choices)), dtype=float).reshape(-1, len(ranges))


def parameter_ranges(aircraft: Aircraft, relative: Mapping[str, float]) -> Array:
    """Ranges of an aircraft's parameters when named quantities change by relative amounts.

    A parameter called ``inverse_x`` is the ratio of the nominal to the true value of the quantity ``x``.

    Parameters
    ----------
    aircraft : Aircraft
    relative : mapping of str to float
        Quantity to largest relative change either way.

    Returns
    -------
    ndarray (p, 2)
        Lower and upper end of each parameter.

    Raises
    ------
    InputError
        If the aircraft does not know a quantity.
    """
    nominal = np.asarray(aircraft.parameter_nominal, dtype=float)
    ranges = np.stack([nominal, nominal], axis=-1)
    for name, change in relative.items():
        if f"inverse_{name}" in aircraft.parameter_names:
            i = aircraft.parameter_names.index(f"inverse_{name}")
            ranges[i] = nominal[i] / (1 + change), nominal[i] / (1 - change)
        elif name in aircraft.parameter_names:
            i = aircraft.parameter_names.index(name)
            ranges[i] = nominal[i] * (1 - change), nominal[i] * (1 + change)
        else:
            known = ", ".join(n.removeprefix("inverse_") for n in aircraft.parameter_names)
            raise InputError(f"disturbance: this aircraft has no uncertain {name}; it has {known}.")
    return ranges
