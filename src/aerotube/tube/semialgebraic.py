r"""Disturbances where polynomials are not negative: the paper's sets, with its sum-of-squares programs (Eq. 6 and 9).

With :math:`g_i \ge 0` on the set, :math:`\rho - x'Ex - \sum_i L_i g_i` and all :math:`L_i` sums of squares, the
ellipsoid :math:`x'Ex \le \rho` holds the set. With E held the least :math:`\rho` is a linear objective; with
:math:`\rho` held, :math:`-\log\det E` gives the ellipsoid of least volume. Multipliers of the sides of a box that
holds the set are among the :math:`L_i`, so that programs are bounded (and, of a degree high enough, exact: Putinar).

Only errors that share an inequality, directly or through others, need to be in one program: the rest of the set is a
product. Every answer is that of the solver with what its certificate takes off added, so that it holds regardless.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.dynamics.errors import ERROR_NAMES
from aerotube.errors import ComputationError, InputError
from aerotube.tube.disturbance import Array, DisturbanceSet, check_relative, checked_widths

_DRAWS = 100_000  # points tried at a time
_ROUNDS = 100
_TOLERANCE = 1e-8  # sets are measured once and for all that follows: more exactly than laws are found


@dataclass(frozen=True)
class SemialgebraicSet(DisturbanceSet):
    """Errors in a box at which polynomials are not negative.

    Attributes
    ----------
    half_widths : ndarray (8,)
        Of the box, SI and radians, all positive; the tighter it is, the better the programs (see `tightened`).
    inequalities : tuple of sos.Polynomial
        Of the eight errors ``[V, alpha, q, theta, beta, p, r, phi]``, SI and radians: exponents (k, 8) and
        coefficients (k,) each.
    relative : mapping of str to float
        As of `DisturbanceBox`.
    degree : int, optional
        Of the sum-of-squares programs, even: the higher, the tighter and the slower. The least that holds every
        inequality by default.

    Raises
    ------
    InputError
        If a width is not positive, a polynomial not one of eight errors, the degree odd or too low, a relative change
        not in [0, 1), or (on first use) no point of the set can be found.
    """

    half_widths: Array
    inequalities: tuple[sos.Polynomial, ...]
    relative: Mapping[str, float] = field(default_factory=dict)
    degree: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "half_widths", checked_widths(self.half_widths))
        object.__setattr__(self, "inequalities", tuple(self.inequalities))
        for i, g in enumerate(self.inequalities):
            if g.exponents.shape[1] != 8 or g.degree == 0:
                raise InputError(
                    f"disturbance: inequality {i} has {g.exponents.shape[1]} variables and degree {g.degree}; give a "
                    f"polynomial of the eight errors {', '.join(ERROR_NAMES)} that depends on one."
                )
        highest = max((g.degree for g in self.inequalities), default=2)
        least = max(2, highest + highest % 2)
        degree = self.degree or least
        if degree % 2 or degree < least:
            raise InputError(f"disturbance: the degree {degree} is odd or too low; give an even one from {least}.")
        object.__setattr__(self, "degree", degree)
        check_relative(self.relative)
        object.__setattr__(self, "_found", {})

    def support(self, directions: Array) -> Array:
        """Bound of the largest ``d' x``, by a program for each direction; see `DisturbanceSet.support`."""
        directions = np.asarray(directions, dtype=float)
        flat, total = directions.reshape(-1, 8), np.zeros(directions.size // 8)
        for group in self._groups():
            own = flat[:, group]
            if not self._touching(group):
                total += np.abs(own) @ self.half_widths[group]
            elif own.any():
                structure, unit = self._program("size", group, 1)
                size = np.maximum(np.abs(own) @ self.half_widths[group], np.finfo(float).tiny)
                values = structure.nodes("inside") @ (own * unit / size[:, None]).T
                total += size * self._least(structure, values.T, "support")
        return total.reshape(directions.shape[:-1])

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Whether points lie in the set; see `DisturbanceSet.contains`."""
        points = np.asarray(points, dtype=float)
        inside = (np.abs(points) <= self.half_widths * (1.0 + 1e-9)).all(axis=-1)
        for g in self.inequalities:
            size = np.abs(g.coefficients) @ np.prod(self.half_widths**g.exponents, axis=1)
            inside &= g(points) >= -1e-9 * size
        return np.asarray(inside)

    def sample(self, count: int, generator: np.random.Generator) -> Array:
        """Uniform points: those of the box that are inside; see `DisturbanceSet.sample`.

        Raises
        ------
        ComputationError
            If hardly any point of the box is.
        """
        points = np.zeros((count, 8))
        for group in self._groups():
            filled = 0
            for _ in range(_ROUNDS):
                tried = np.zeros((_DRAWS if self._touching(group) else count, 8))
                tried[:, group] = self.half_widths[group] * generator.uniform(-1.0, 1.0, (len(tried), len(group)))
                inside = np.ones(len(tried), dtype=bool)
                for g in self._touching(group):
                    inside &= g(tried) >= 0.0
                found = tried[inside][: count - filled, group]
                points[filled : filled + len(found), group] = found
                filled += len(found)
                if filled == count:
                    break
            else:
                raise ComputationError(
                    f"disturbance: of {_ROUNDS * _DRAWS} points of the box only {filled} are in the set; give a "
                    "tighter box."
                )
        return points

    def least_volume(self, errors: Sequence[int]) -> tuple[Array, float]:
        """By a program whose objective is ``-log det E``; see `DisturbanceSet.least_volume`."""
        found: dict[Any, tuple[Array, float]] = vars(self)["_found"]
        key = ("volume", *errors)
        if key not in found:
            found[key] = self._least_volume(errors)
        return found[key]

    def least_size(self, errors: Sequence[int], shapes: Array) -> Array:
        """By the program of Eq. 9 with the shape held; see `DisturbanceSet.least_size`."""
        group, own = self._group_around(errors)
        structure, unit = self._program("size", group, 1)
        scaled = shapes * unit[own][:, None] * unit[own]
        size = np.trace(scaled, axis1=1, axis2=2)
        z = structure.nodes("inside")[:, own]
        values = np.einsum("ui,bij,uj->bu", z, scaled / size[:, None, None], z, optimize=True)
        return np.asarray(size * self._least(structure, values, "size"))

    def corners(self, errors: Sequence[int]) -> None:
        """None: such a set has no corners that span it in general."""
        return

    def tightened(self) -> SemialgebraicSet:
        """The same set in the smallest box that its own programs can tell."""
        reach = np.maximum(self.support(np.eye(8)), self.support(-np.eye(8)))
        return SemialgebraicSet(np.minimum(reach, self.half_widths), self.inequalities, self.relative, self.degree)

    def _touching(self, group: Sequence[int]) -> list[sos.Polynomial]:
        """The inequalities in which an error of a group occurs."""
        return [g for g in self.inequalities if _variables(g) & set(group)]

    def _groups(self) -> list[list[int]]:
        """The errors, those that share an inequality together."""
        groups = [{i} for i in range(8)]
        for g in self.inequalities:
            joined = [group for group in groups if group & _variables(g)]
            groups = [group for group in groups if group not in joined] + [set().union(*joined)]
        return [sorted(group) for group in sorted(groups, key=min)]

    def _group_around(self, errors: Sequence[int]) -> tuple[list[int], list[int]]:
        """All errors tied to some, and the places of the latter among them."""
        group = sorted(i for own in self._groups() if set(own) & set(errors) for i in own)
        return group, [group.index(i) for i in errors]

    def _program(self, kind: str, group: list[int], dimension: int) -> tuple[sos.Structure, Array]:
        """Structure over a group of errors, and the unit of each: the box is inside the unit ball."""
        programs: dict[Any, sos.Structure] = vars(self)["_found"]
        unit = np.sqrt(len(group)) * self.half_widths[group]
        key = (kind, dimension, *group)
        if key not in programs:
            program = sos.Program()
            if kind == "volume":
                program.symmetric("E", dimension)
                program.logdet("volume", size=dimension)
            else:
                program.scalar("bound")
            weights = [_in_unit(g, group, unit) for g in self._touching(group)] + _sides(len(group))
            try:
                program.sos("inside", sos.Ball(len(group)), degree=self.degree, weights=weights)
            except ValueError as error:
                raise InputError(f"disturbance: the set of inequalities cannot be used: {error}") from None
            programs[key] = program.compile()
        return programs[key], unit

    def _least(self, structure: sos.Structure, values: Array, what: str) -> Array:
        """Least bound of functions on the set, from their values (b, U) at the nodes: ndarray (b,)."""
        data = structure.data(objective=np.ones(1), constraints={"inside": (-values, np.ones((values.shape[1], 1)))})
        solution = sos.solve(structure, data, tolerance=_TOLERANCE)
        return np.asarray(solution["bound"] + _deficit(solution, what))

    def _least_volume(self, errors: Sequence[int]) -> tuple[Array, float]:
        group, own = self._group_around(errors)
        n = len(own)
        structure, unit = self._program("volume", group, n)
        E, z = structure.variable("E"), structure.nodes("inside")[:, own]
        rows, columns = np.tril_indices(n)
        linear = np.zeros((len(z), structure.size))
        linear[:, E.slice] = -z[:, rows] * z[:, columns] * np.where(rows == columns, 1.0, 2.0)
        forms, grid = np.zeros((structure.size, n, n)), np.indices((n, n))
        forms[E.index, grid[0], grid[1]] = 1.0
        data = structure.data(
            objective=np.zeros(structure.size),
            constraints={"inside": (np.ones(len(z)), linear), "volume": (np.zeros((n, n)), forms)},
        )
        solution = sos.solve(structure, data, tolerance=_TOLERANCE)
        rho = 1.0 + float(_deficit(solution, "volume"))
        form = np.asarray(solution["E"]) / (unit[own][:, None] * unit[own])
        return 0.5 * (form + form.T), rho


def _variables(g: sos.Polynomial) -> set[int]:
    return set(np.flatnonzero(g.exponents[g.coefficients != 0.0].any(axis=0)).tolist())


def _in_unit(g: sos.Polynomial, group: list[int], unit: Array) -> sos.Polynomial:
    """A polynomial of some of the errors, in the unit of each, with coefficients of order one."""
    used = g.coefficients != 0.0
    exponents = g.exponents[used][:, group]
    coefficients = g.coefficients[used] * np.prod(unit**exponents, axis=1)
    return sos.Polynomial(exponents, coefficients / np.abs(coefficients).max())


def _sides(count: int) -> list[sos.Polynomial]:
    """The sides of the cube in the unit ball: ``1 - count z_i^2``."""
    zero = np.zeros(count, dtype=np.int64)
    return [
        sos.Polynomial(np.stack([zero, 2 * np.eye(count, dtype=np.int64)[i]]), np.array([1.0, -count]))
        for i in range(count)
    ]


def _deficit(solution: sos.Solution, what: str) -> Array:
    """What must be added to a bound for it to hold whatever the solver said; ComputationError if nothing does."""
    margin = np.asarray(solution.certificate().margins["inside"])
    if not np.isfinite(solution.values).all() or not np.isfinite(margin).all():
        raise ComputationError(
            f"disturbance: no {what} of the semialgebraic set could be certified ({solution.describe()}); raise the "
            "degree, or give a tighter box."
        )
    return np.asarray(np.maximum(-margin, 0.0))
