"""Laws as a flight carries them: numbers of one beat, and the form that all beats share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from aerotube.compensation import LinearLaw, PolynomialLaw, SynthesisSettings
from aerotube.compensation.closed_loop import BatchLaw
from aerotube.compensation.law import assembled
from aerotube.dynamics import ErrorCoordinates

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Form:
    """What the laws of a flight have in common.

    Attributes
    ----------
    exponents : ndarray (M, 8) of int
        Powers of the eight errors in each monomial; the first eight are the errors themselves.
    parts : tuple of tuple of int
        Indices of each part's errors.
    """

    exponents: NDArray[np.int64]
    parts: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, settings: SynthesisSettings) -> Form:
        """The form of the laws that these settings lead to."""
        if settings.law_degree == 1:
            return cls(np.eye(8, dtype=np.int64), tuple(part.errors for part in settings.parts))
        law = assembled(
            [(part.errors, part.controls, np.zeros((0, 1, 1))) for part in settings.parts],
            settings.law_degree,
            0,
            np.empty(0, dtype=np.intp),
            ErrorCoordinates(settings.attitude),
        )
        assert isinstance(law, PolynomialLaw)
        return cls(law.exponents, law.parts)

    @property
    def monomials(self) -> int:
        """M."""
        return len(self.exponents)

    @property
    def linear(self) -> bool:
        """Whether there is nothing but the errors themselves."""
        return self.monomials == 8

    @cached_property
    def factors(self) -> NDArray[np.int64]:
        """For each monomial beyond the errors, an earlier one and the error that together make it: (M - 8, 2)."""
        rows = [tuple(row) for row in self.exponents.tolist()]
        out = np.empty((len(rows) - 8, 2), dtype=np.int64)
        for place, row in enumerate(rows[8:]):
            last = max(i for i in range(8) if row[i])
            out[place] = rows.index(tuple(p - (i == last) for i, p in enumerate(row))), last
        return out

    @cached_property
    def part_of(self) -> NDArray[np.int64]:
        """The part that each error belongs to: (8,)."""
        out = np.zeros(8, dtype=np.int64)
        for number, errors in enumerate(self.parts):
            out[list(errors)] = number
        return out


@dataclass(frozen=True)
class Laws:
    """Laws of some beats, or, without the leading axis, of one.

    Attributes
    ----------
    coefficients : ndarray (b, 4, M)
        From monomials of the error to increments of the virtual controls.
    room : ndarray (b, 4, 2)
        Least and largest increment, at which a law that saturates cuts itself off; infinite where it does not.
    reach : ndarray (b, 8, 8), or (b, 0, 0) for linear laws
        See ``unwhitening`` of :class:`aerotube.compensation.PolynomialLaw`.
    """

    coefficients: Array
    room: Array
    reach: Array

    @classmethod
    def none(cls, form: Form, beats: int) -> Laws:
        """Zero laws of so many beats."""
        room = np.empty((beats, 4, 2))
        room[:] = [-np.inf, np.inf]
        side = 0 if form.linear else 8
        return cls(np.zeros((beats, 4, form.monomials)), room, np.zeros((beats, side, side)))

    @classmethod
    def linear(cls, form: Form, gains: Array) -> Laws:
        """Laws with these gains (b, 4, 8) alone."""
        out = cls.none(form, len(gains))
        out.coefficients[:, :, :8] = gains
        return out

    def __getitem__(self, beats: int | slice | NDArray[np.intp]) -> Laws:
        """Of some beats."""
        return Laws(*(np.ascontiguousarray(x[beats]) for x in (self.coefficients, self.room, self.reach)))

    def batch(self, form: Form, coordinates: ErrorCoordinates) -> BatchLaw:
        """As laws that are certified and simulated."""
        room = self.room if np.isfinite(self.room).any() else None
        if form.linear:
            return LinearLaw(self.coefficients, coordinates, room)
        return PolynomialLaw(self.coefficients, form.exponents, coordinates, room, self.reach, form.parts)
