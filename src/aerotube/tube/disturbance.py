"""Disturbance sets: what a tube must withstand at the start of a beat."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.dynamics.errors import ERROR_NAMES
from aerotube.errors import InputError
from aerotube.tube import ellipsoid

Array = NDArray[np.float64]


class DisturbanceSet(ABC):
    """Errors at the start of a beat, about the nominal at zero, and what is uncertain in the model.

    Errors are differences of ``[V, alpha, q, theta, beta, p, r, phi]`` (Euler angles), SI and radians. A set is a
    box, an ellipsoid, a polytope, or whatever polynomial inequalities describe; each says the same things of itself,
    of its projections onto some of the eight components too (a part of a decoupled synthesis sees only its own).

    Attributes
    ----------
    half_widths : ndarray (8,)
        Of a box, centred on zero, that holds the set.
    relative : mapping of str to float
        Largest relative change, either way, of each uncertain quantity: ``{"mass": 0.05}`` is five percent.
    """

    half_widths: Array
    relative: Mapping[str, float]

    def __getstate__(self) -> dict[str, object]:
        """All but what was found out about the set, which may be found out again."""
        return {name: value for name, value in vars(self).items() if name != "_found"}

    def __setstate__(self, state: dict[str, object]) -> None:
        """Restore what was saved."""
        for name, value in state.items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "_found", {})

    @abstractmethod
    def support(self, directions: Array) -> Array:
        """How far the set reaches: the largest ``d' x``, or a bound of it, for directions (..., 8): ndarray (...)."""

    @abstractmethod
    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Whether points (..., 8) lie in the set, up to rounding: ndarray (...) of bool."""

    @abstractmethod
    def sample(self, count: int, generator: np.random.Generator) -> Array:
        """Random points of the set, uniform or nearly so: ndarray (count, 8)."""

    @abstractmethod
    def least_volume(self, errors: Sequence[int]) -> tuple[Array, float]:
        """Ellipsoid of least volume around the projection onto some components.

        Parameters
        ----------
        errors : sequence of int, length n

        Returns
        -------
        shape : ndarray (n, n)
        rho : float
        """

    @abstractmethod
    def least_size(self, errors: Sequence[int], shapes: Array) -> Array:
        """Least ``rho`` for which ellipsoids of given shapes hold the projection (Eq. 9 with the shape held).

        Parameters
        ----------
        errors : sequence of int, length n
        shapes : ndarray (b, n, n)
            Positive definite.

        Returns
        -------
        ndarray (b,)
        """

    @abstractmethod
    def corners(self, errors: Sequence[int]) -> Array | None:
        """Points whose convex hull is that of the projection: ndarray (k, n); None where no finite number does."""

    def parameter_vertices(self, aircraft: Aircraft) -> Array:
        """Extreme values of the aircraft's uncertain parameters.

        Where the map is affine in each parameter, a convex measure of its result is largest at one of these; where
        it is nearly so, they are where the worst case is taken (`aerotube.aircraft.f16` says how near its own are, and
        `aerotube.compensation.uncertainty` has programs with the parameters as variables).

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


@dataclass(frozen=True)
class DisturbanceBox(DisturbanceSet):
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
        object.__setattr__(self, "half_widths", checked_widths(self.half_widths))
        check_relative(self.relative)

    def support(self, directions: Array) -> Array:
        """Largest ``d' x``, exactly; see `DisturbanceSet.support`."""
        return np.asarray(np.abs(directions) @ self.half_widths)

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Whether points lie in the box; see `DisturbanceSet.contains`."""
        return np.asarray((np.abs(points) <= self.half_widths * (1.0 + 1e-9)).all(axis=-1))

    def sample(self, count: int, generator: np.random.Generator) -> Array:
        """Uniform points; see `DisturbanceSet.sample`."""
        return np.asarray(self.half_widths * generator.uniform(-1.0, 1.0, (count, 8)))

    def least_volume(self, errors: Sequence[int]) -> tuple[Array, float]:
        """``diag(1 / w^2)`` and the number of components; see `DisturbanceSet.least_volume`."""
        shape, rho = ellipsoid.least_volume_around_box(self.half_widths[list(errors)])
        return shape, float(rho)

    def least_size(self, errors: Sequence[int], shapes: Array) -> Array:
        """The largest value at a corner; see `DisturbanceSet.least_size`."""
        widths = np.broadcast_to(self.half_widths[list(errors)], shapes.shape[:-1])
        return ellipsoid.least_size_around_box(shapes, widths)

    def corners(self, errors: Sequence[int]) -> Array:
        """All corners; see `DisturbanceSet.corners`."""
        widths = self.half_widths[list(errors)]
        return widths * np.array(list(itertools.product((-1.0, 1.0), repeat=len(widths))))


def checked_widths(half_widths: Array) -> Array:
    """Half-widths of a box of errors as an array (8,); InputError unless there are eight, all positive."""
    widths = np.asarray(half_widths, dtype=float)
    if widths.shape != (8,):
        raise InputError(f"disturbance: {widths.shape} half-widths given; give eight, {', '.join(ERROR_NAMES)}.")
    for name, width in zip(ERROR_NAMES, widths, strict=True):
        if not (np.isfinite(width) and width > 0):
            raise InputError(f"disturbance: the half-width of {name} is {width}; give a positive number.")
    return widths


def check_relative(relative: Mapping[str, float]) -> None:
    """InputError unless all relative changes are in [0, 1)."""
    for name, change in relative.items():
        if not 0 <= change < 1:
            raise InputError(f"disturbance: the relative change of {name} is {change}; give one in [0, 1).")


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
            raise InputError(
                f"disturbance: this aircraft has no uncertain {name}; it has {known} (an aircraft may have to be made "
                f"with more, such as F16(uncertain=['{name}']))."
            )
    return ranges
