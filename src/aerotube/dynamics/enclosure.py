r"""Rigorous enclosures of the error map of a beat.

The error map of a beat under a law, :math:`x^+ = f(z)`, its errors, parameters, measurement errors and gusts being
affine in points z of a product of unit balls, is enclosed by Taylor models run through the aircraft's own equations:

.. math:: |f_i(z) - P_i(z)| \le r_i \quad \text{for all } z .

Numbers that are computed from constants alone before they meet a model are taken as they are rounded, and the set is
the one that its matrices, as they are, describe.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.dynamics.errors import ErrorCoordinates
from aerotube.dynamics.step import step_components
from aerotube.errors import ComputationError, InputError
from aerotube.numerics.taylor_model import SLACK, ModelSpace, TaylorModel

if TYPE_CHECKING:
    from aerotube.nominal import Nominal

Array = NDArray[np.float64]
ComponentLaw = Callable[[Sequence[Any]], Sequence[Any]]


@dataclass(frozen=True)
class BeatSet:
    """What a batch of beats must withstand: images of a product of unit balls.

    Attributes
    ----------
    names : tuple of str
        What each ball stands for: parts, parameters, "measurement", "wind".
    balls : tuple of int
        Their dimensions; k in all.
    error : ndarray (b, 8, k)
        Error at the start of the beat: ``x = error @ z``.
    parameters, parameter_reach : ndarray (p,), (p, k)
        Uncertain parameters: ``parameters + parameter_reach @ z``.
    measurement : ndarray (b, 8, k), optional
        Error of what the law sees, in error coordinates.
    wind : ndarray (b, 6, k), optional
        Velocity (m/s) and rotation (rad/s) of the air over the beat, body axes.
    """

    names: tuple[str, ...]
    balls: tuple[int, ...]
    error: Array
    parameters: Array
    parameter_reach: Array
    measurement: Array | None = None
    wind: Array | None = None

    def columns(self, name: str) -> slice:
        """The variables of a ball."""
        starts = np.cumsum((0, *self.balls))
        if name not in self.names:
            raise InputError(f"set of a beat: there is no ball {name!r}; there are {', '.join(self.names)}.")
        index = self.names.index(name)
        return slice(int(starts[index]), int(starts[index + 1]))


def beat_set(
    parts: Sequence[tuple[str, Sequence[int], Array]],
    parameter_names: Sequence[str],
    parameter_ranges: Array,
    measurement: ArrayLike | None = None,
    wind: ArrayLike | None = None,
) -> BeatSet:
    """Set of a batch of beats: an ellipsoid of errors a part, a range a parameter, boxes for the rest.

    Parameters
    ----------
    parts : sequence of (name, indices, whitening)
        Each part's error components, n of eight, and the map ndarray (b, n, n) of the unit ball onto its ellipsoid.
        Error components of no part are zero.
    parameter_names : sequence of str, length p
    parameter_ranges : ndarray (p, 2)
        Lower and upper ends.
    measurement : array (8,) or (b, 8), optional
        Largest measurement error of each error component; a component without one is measured exactly.
    wind : array (6,) or (b, 6), optional
        Largest wind of each component, m/s and rad/s.

    Returns
    -------
    BeatSet
    """
    ranges = np.asarray(parameter_ranges, dtype=float)
    names, balls = [name for name, _, _ in parts], [len(indices) for _, indices, _ in parts]
    uncertain = [i for i, (low, high) in enumerate(ranges) if low < high]
    names += [parameter_names[i] for i in uncertain]
    boxes = {"measurement": measurement, "wind": wind}
    given = {name: np.asarray(box, dtype=float) for name, box in boxes.items() if box is not None}
    spread = [(name, i, box[..., i]) for name, box in given.items() for i in range(box.shape[-1]) if box[..., i].any()]
    names += [f"{name} {i}" for name, i, _ in spread]
    balls += [1] * (len(uncertain) + len(spread))
    total, beats = sum(balls), len(parts[0][2])

    error, column = np.zeros((beats, 8, total)), 0
    for _, indices, whitening in parts:
        error[:, list(indices), column : column + len(indices)] = whitening
        column += len(indices)
    middle, reach = 0.5 * (ranges[:, 0] + ranges[:, 1]), np.zeros((len(ranges), total))
    for i in uncertain:
        # a little more than half the width, so that rounding leaves no end out
        reach[i, column] = 0.5 * (ranges[i, 1] - ranges[i, 0]) + 4e-16 * np.abs(ranges[i]).max()
        column += 1
    tables = {name: np.zeros((beats, box.shape[-1], total)) for name, box in given.items()}
    for name, i, size in spread:
        tables[name][:, i, column] = size
        column += 1
    return BeatSet(tuple(names), tuple(balls), error, middle, reach, tables.get("measurement"), tables.get("wind"))


def linear_law(gains: Array) -> ComponentLaw:
    """Law ``du = K x`` of a batch of beats, gains ndarray (b, 4, 8), on components."""

    def increments(error: Sequence[Any]) -> Sequence[Any]:
        used = [[j for j in range(8) if gains[:, i, j].any()] for i in range(4)]
        return [sum((gains[:, i, j] * error[j] for j in used[i]), np.zeros(len(gains))) for i in range(4)]

    return increments


def polynomial_law(coefficients: Array, exponents: NDArray[np.int64], room: Array | None = None) -> ComponentLaw:
    """Polynomial law of a batch of beats on components.

    Parameters
    ----------
    coefficients : ndarray (b, 4, M)
    exponents : ndarray (M, 8)
        Powers of the eight errors in each monomial, of total degree one at least.
    room : ndarray (b, 4, 2), optional
        Least and largest increment, beyond which the law saturates.

    Returns
    -------
    callable
    """
    powers = [tuple(int(p) for p in row) for row in exponents]
    order = sorted(
        (row for row in range(len(powers)) if coefficients[:, :, row].any()), key=lambda row: sum(powers[row])
    )

    def increments(error: Sequence[Any]) -> Sequence[Any]:
        made: dict[tuple[int, ...], Any] = {}

        def monomial(row: tuple[int, ...]) -> Any:
            if row not in made:
                last = max(i for i in range(8) if row[i])
                rest = tuple(p - (i == last) for i, p in enumerate(row))
                made[row] = error[last] if not any(rest) else monomial(rest) * error[last]
            return made[row]

        out = []
        for i in range(coefficients.shape[1]):
            total: Any = np.zeros(len(coefficients))
            for row in order:
                if coefficients[:, i, row].any():
                    total = total + coefficients[:, i, row] * monomial(powers[row])
            if room is not None:
                total = np.minimum(np.maximum(total, room[:, i, 0]), room[:, i, 1])
            out.append(total)
        return out

    return increments


@dataclass(frozen=True)
class ErrorEnclosure:
    """Polynomials and remainders of the error map of a batch of beats.

    Attributes
    ----------
    set : BeatSet
        Over which it holds.
    space : ModelSpace
    coefficients : ndarray (b, 8, size)
        Of each component of the error at the end of the beat, in the graded order of ``space.taylor``.
    remainder : ndarray (b, 8)
        Bound of what the polynomial leaves out, SI.
    """

    set: BeatSet
    space: ModelSpace
    coefficients: Array
    remainder: Array

    def __call__(self, points: Array) -> Array:
        """Values of the polynomials at points (b, u, k): ndarray (b, u, 8)."""
        return np.asarray(self.space.taylor.monomials(points) @ np.swapaxes(self.coefficients, 1, 2))

    def degree(self, *names: str) -> NDArray[np.int64]:
        """Degree of each monomial in the variables of some balls: ndarray (size,)."""
        degrees = np.zeros(self.space.size, dtype=np.int64)
        for name in names:
            degrees += self.space.taylor.exponents[:, self.set.columns(name)].sum(axis=1)
        return degrees

    def truncated(self, order: int) -> ErrorEnclosure:
        """The same enclosure with polynomials of lower order, the terms left out moved to the remainder."""
        smaller = ModelSpace(self.space.balls, order)
        beyond = self.space.model(np.where(np.arange(self.space.size) < smaller.size, 0.0, self.coefficients))
        remainder = (self.remainder + beyond.norms.sum(axis=-1)) * SLACK
        return ErrorEnclosure(self.set, smaller, self.coefficients[..., : smaller.size], remainder)


def enclose_error_map(
    aircraft: Aircraft,
    nominal: Nominal,
    beats: Sequence[int] | NDArray[np.intp],
    coordinates: ErrorCoordinates,
    over: BeatSet,
    law: ComponentLaw | None = None,
    order: int = 4,
) -> ErrorEnclosure:
    """Enclose the error map of beats over a whole set, a law in the loop.

    Parameters
    ----------
    aircraft : Aircraft
        Best with smooth tables: kinks of linear ones go to the remainder.
    nominal : Nominal
    beats : sequence of int, length b
    coordinates : ErrorCoordinates
    over : BeatSet
        Of those beats.
    law : callable, optional
        From the components of the measured error, polynomials here, to those of the increment of the virtual
        controls; none by default. What the aircraft's limits do not allow at the measured state is cut off, as in
        flight; where a law asks for it, by however much, goes to the remainder.
    order : int
        Total degree of the polynomials.

    Returns
    -------
    ErrorEnclosure

    Raises
    ------
    ComputationError
        Where the equations are not defined throughout the set.
    """
    beats = np.asarray(beats)
    space, zero = ModelSpace(over.balls, order), np.zeros(len(beats))

    def affine(middle: Any, reach: Array) -> Any:
        return space.affine(middle, reach) if reach.any() else space.constant(middle)

    error = [affine(zero, over.error[:, i]) for i in range(8)]
    seen = error
    if over.measurement is not None:
        seen = [space.affine(zero, over.error[:, i] + over.measurement[:, i]) for i in range(8)]
    sigma = [
        affine(zero + value, zero[:, None] + reach)
        for value, reach in zip(over.parameters, over.parameter_reach, strict=True)
    ]
    wind = None if over.wind is None else [affine(zero, over.wind[:, i]) for i in range(6)]
    try:
        before = [space.constant(x) for x in nominal.states[beats].T]
        control = [space.constant(a) for a in nominal.controls[beats].T]
        start, increment = coordinates.retract_components(before, error), None
        if law is not None:
            at = start if over.measurement is None else coordinates.retract_components(before, seen)
            limits = zip(law(seen), *aircraft.increment_limits(at, control), strict=True)
            increment = [np.minimum(np.maximum(move, low), high) for move, low, high in limits]
        end = step_components(aircraft, start, control, nominal.dt, parameters=sigma, wind=wind, increment=increment)
        final = coordinates.difference_components(end, [space.constant(x) for x in nominal.states[beats + 1].T])
    except ValueError as refusal:
        raise ComputationError(
            f"enclosure of the error map: {refusal}; the set of errors is too large for the aircraft's model there."
        ) from refusal
    models: list[TaylorModel] = [component + zero for component in final]
    remainder = np.stack([model.remainder for model in models], axis=1)
    if not np.isfinite(remainder).all():
        raise ComputationError("enclosure of the error map: it has no finite remainder; take a smaller set of errors.")
    return ErrorEnclosure(over, space, np.stack([model.coefficients for model in models], axis=1), remainder)
