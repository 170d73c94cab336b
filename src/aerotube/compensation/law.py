"""Compensation laws: what a flight evaluates every beat."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from aerotube.compensation import monomials
from aerotube.dynamics.errors import ERROR_NAMES, ErrorCoordinates
from aerotube.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LinearLaw:
    """Increments of the virtual controls, linear in the error: ``du = K_t x``.

    Attributes
    ----------
    gains : ndarray (T, 4, 8)
        From SI errors to increments of the virtual controls.
    coordinates : ErrorCoordinates
        In which the error is measured.
    room : ndarray (T, 4, 2), optional
        Least and largest increment, where the law saturates of its own accord; None: it never does.
    """

    gains: Array
    coordinates: ErrorCoordinates
    room: Array | None = None

    @property
    def coefficients(self) -> Array:
        """Coefficients (T, 4, 8) of its monomials, which are the errors; as of :class:`PolynomialLaw`."""
        return self.gains

    @property
    def exponents(self) -> NDArray[np.int64]:
        """Powers (8, 8) of the errors in each monomial."""
        return np.eye(8, dtype=np.int64)

    @property
    def unwhitening(self) -> None:
        """It is linear everywhere."""
        return None

    def increment(self, beat: int, error: Array) -> Array:
        """Increments at a beat.

        Parameters
        ----------
        beat : int
        error : ndarray (..., 8)
            Measured error in the law's coordinates.

        Returns
        -------
        ndarray (..., 4)

        Raises
        ------
        InputError
            If there is no such beat, or the errors are not eight.
        """
        error = _checked(beat, error, len(self.gains))
        return _kept(error @ self.gains[beat].T, None if self.room is None else self.room[beat])

    def increments(self, beats: NDArray[np.intp], error: Array) -> Array:
        """Increments at many beats.

        Parameters
        ----------
        beats : ndarray (b,) of int
        error : ndarray (b, ..., 8)

        Returns
        -------
        ndarray (b, ..., 4)
        """
        rows = np.broadcast_to(error, (len(beats), *np.shape(error)[1:])).reshape(len(beats), -1, 8)
        made = rows @ np.swapaxes(self.gains[beats], 1, 2)
        return _each_kept(made.reshape(len(beats), *np.shape(error)[1:-1], 4), self.room, beats)


@dataclass(frozen=True)
class PolynomialLaw:
    """Increments of the virtual controls, polynomial in the error, without a constant term.

    A polynomial that is good on a set may do anything beyond it. There the law is that of the error brought back to
    the set's boundary, part by part, times how far the error is out: it goes on as straight as a linear law. (Were
    the linear terms alone to go on, so would gains that terms of the opposite sign temper on the set.)

    Attributes
    ----------
    coefficients : ndarray (T, 4, M)
        From products of SI errors to increments of the virtual controls.
    exponents : ndarray (M, 8) of int
        Powers of the eight errors in each monomial; the first eight are the errors themselves.
    coordinates : ErrorCoordinates
        In which the error is measured.
    room : ndarray (T, 4, 2), optional
        As of :class:`LinearLaw`.
    unwhitening : ndarray (T, 8, 8), optional
        The law is the polynomial where ``|(unwhitening x)_part| <= 1`` for each part; everywhere without it.
    parts : tuple of tuple of int
        Indices of each part's errors.
    """

    coefficients: Array
    exponents: NDArray[np.int64]
    coordinates: ErrorCoordinates
    room: Array | None = None
    unwhitening: Array | None = None
    parts: tuple[tuple[int, ...], ...] = ()

    @property
    def gains(self) -> Array:
        """The linear part, from SI errors to increments: ndarray (T, 4, 8)."""
        return self.coefficients[:, :, :8]

    @property
    def degree(self) -> int:
        """Highest total degree."""
        return int(self.exponents.sum(1).max())

    @cached_property
    def _factors(self) -> list[tuple[int, int]]:
        """For each monomial beyond the errors themselves, an earlier one and the error that together make it."""
        rows = [tuple(row) for row in self.exponents.tolist()]
        out = []
        for row in rows[8:]:
            last = max(i for i in range(8) if row[i])
            out.append((rows.index(tuple(p - (i == last) for i, p in enumerate(row))), last))
        return out

    def _monomials(self, error: Array, z: Array | None) -> Array:
        """Values (M, ...) of the monomials at errors, and whitened errors, (..., 8).

        The first axis is the monomials', so that each is contiguous.
        """
        first = np.moveaxis(np.asarray(error, dtype=float), -1, 0)
        table = np.empty((len(self.exponents), *first.shape[1:]))
        table[:8] = first
        beyond = [] if z is None else [np.maximum(np.linalg.norm(z[..., list(p)], axis=-1), 1.0) for p in self.parts]
        for part, factor in zip(self.parts, beyond, strict=False):
            table[list(part)] /= factor
        for row, (earlier, last) in enumerate(self._factors, start=8):
            table[row] = table[earlier] * table[last]
        for part, factor in zip(self.parts, beyond, strict=False):
            table[self.exponents[:, list(part)].any(axis=1)] *= factor
        return table

    def increment(self, beat: int, error: Array) -> Array:
        """Increments (..., 4) at a beat, for errors (..., 8); see :meth:`LinearLaw.increment`."""
        error = _checked(beat, error, len(self.coefficients))
        z = None if self.unwhitening is None else error @ self.unwhitening[beat].T
        made = np.tensordot(self.coefficients[beat], self._monomials(error, z), axes=1)
        return _kept(np.moveaxis(made, 0, -1), None if self.room is None else self.room[beat])

    def increments(self, beats: NDArray[np.intp], error: Array) -> Array:
        """Increments (b, ..., 4) at many beats, for errors (b, ..., 8); see :meth:`LinearLaw.increments`."""
        z = None if self.unwhitening is None else np.einsum("bij,b...j->b...i", self.unwhitening[beats], error)
        made = np.einsum("bim,mb...->b...i", self.coefficients[beats], self._monomials(error, z), optimize=True)
        return _each_kept(made, self.room, beats)


def assembled(
    parts: list[tuple[tuple[int, ...], tuple[int, ...], Array]],
    degree: int,
    beats: int,
    chosen: NDArray[np.intp],
    coordinates: ErrorCoordinates,
    room: Array | None = None,
    unwhitening: Array | None = None,
) -> LinearLaw | PolynomialLaw:
    """One law from those of the parts.

    Parameters
    ----------
    parts : list of (errors, controls, coefficients)
        Indices of a part's errors and controls, and coefficients (b, m, M) of the monomials of degree 1 to `degree`
        in its errors, as :func:`aerotube.compensation.monomials.exponents` lists them.
    degree : int
    beats : int
        T; the law is zero at beats that are not among the chosen.
    chosen : ndarray (b,) of int
    coordinates : ErrorCoordinates
    room : ndarray (T, 4, 2), optional
    unwhitening : ndarray (T, 8, 8), optional
        Where a law of higher degree is the polynomial; see :class:`PolynomialLaw`.

    Returns
    -------
    LinearLaw or PolynomialLaw
        Linear for degree 1.
    """
    rows = [tuple(row) for row in np.eye(8, dtype=int).tolist()]
    columns = []
    for errors, _, _ in parts:
        powers = monomials.exponents(len(errors), degree)
        full = np.zeros((len(powers), 8), dtype=int)
        full[:, errors] = powers
        names = [tuple(row) for row in full.tolist()]
        rows += [name for name in names if name not in rows]
        columns.append([rows.index(name) for name in names])
    table = np.zeros((beats, 4, len(rows)))
    for (_, controls, coefficients), column in zip(parts, columns, strict=True):
        table[chosen[:, None, None], np.array(controls)[:, None], np.array(column)] = coefficients
    if degree == 1:
        return LinearLaw(table, coordinates, room)
    blocks = tuple(errors for errors, _, _ in parts)
    return PolynomialLaw(table, np.array(rows, dtype=np.int64), coordinates, room, unwhitening, blocks)


def _checked(beat: int, error: Array, beats: int) -> Array:
    """Errors as an array; InputError for a beat that there is not, or another number of errors than eight."""
    if not 0 <= beat < beats:
        raise InputError(f"law: it has the beats 0 to {beats - 1}; {beat} is none of them.")
    error = np.asarray(error)
    if error.shape[-1:] != (8,):
        raise InputError(
            f"law: errors of shape {error.shape} were given; their last axis must hold eight, {', '.join(ERROR_NAMES)}."
        )
    return error


def _kept(increment: Array, room: Array | None) -> Array:
    return np.asarray(increment if room is None else np.clip(increment, room[:, 0], room[:, 1]))


def _each_kept(increment: Array, room: Array | None, beats: NDArray[np.intp]) -> Array:
    if room is None:
        return np.asarray(increment)
    own = room[beats].reshape(len(beats), *(1,) * (increment.ndim - 2), 4, 2)
    return np.clip(increment, own[..., 0], own[..., 1])
