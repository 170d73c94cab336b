"""Disturbances in an ellipsoid: errors that are not all at their worst together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from aerotube.errors import InputError
from aerotube.tube import ellipsoid
from aerotube.tube.disturbance import Array, DisturbanceSet, check_relative


@dataclass(frozen=True)
class DisturbanceEllipsoid(DisturbanceSet):
    """Errors with ``x' shape x <= 1``.

    Attributes
    ----------
    shape : ndarray (8, 8)
        Symmetric, positive definite, in the units of ``[V, alpha, q, theta, beta, p, r, phi]``, SI and radians.
    relative : mapping of str to float
        As of `DisturbanceBox`.

    Raises
    ------
    InputError
        If the shape is not symmetric and positive definite, or a relative change not in [0, 1).
    """

    shape: Array
    relative: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shape = np.array(self.shape, dtype=float)
        if shape.shape != (8, 8) or not np.isfinite(shape).all():
            raise InputError(f"disturbance: the ellipsoid's shape is {shape.shape}; give a finite matrix of 8 by 8.")
        unit = 1.0 / np.sqrt(np.where(np.diag(shape) > 0.0, np.diag(shape), 1.0))
        scaled = shape * unit[:, None] * unit
        if np.abs(scaled - scaled.T).max() > 1e-9 or np.linalg.eigvalsh(scaled)[0] <= 1e-14:
            raise InputError(
                "disturbance: the ellipsoid's shape is not symmetric and positive definite; give one that bounds "
                "every error."
            )
        shape = 0.5 * (shape + shape.T)
        object.__setattr__(self, "shape", shape)
        object.__setattr__(self, "half_widths", ellipsoid.half_widths(shape, np.ones(())))
        check_relative(self.relative)

    @classmethod
    def from_half_axes(cls, half_axes: Array, relative: Mapping[str, float] | None = None) -> DisturbanceEllipsoid:
        """Ellipsoid with its axes along the eight errors, of half-lengths (8,)."""
        return cls(np.diag(np.asarray(half_axes, dtype=float) ** -2.0), relative or {})

    def support(self, directions: Array) -> Array:
        """Largest ``d' x``, exactly; see `DisturbanceSet.support`."""
        return ellipsoid.support(self.shape, np.ones(()), directions)

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Whether points lie in the ellipsoid; see `DisturbanceSet.contains`."""
        return ellipsoid.contains(self.shape, np.ones(()), points)

    def sample(self, count: int, generator: np.random.Generator) -> Array:
        """Uniform points; see `DisturbanceSet.sample`."""
        return ellipsoid.sample(self.shape, np.ones(()), count, generator)

    def least_volume(self, errors: Sequence[int]) -> tuple[Array, float]:
        """The projection itself; see `DisturbanceSet.least_volume`."""
        return ellipsoid.projection(self.shape, tuple(errors)), 1.0

    def least_size(self, errors: Sequence[int], shapes: Array) -> Array:
        """The largest generalised eigenvalue; see `DisturbanceSet.least_size`."""
        own = ellipsoid.projection(self.shape, tuple(errors))
        return ellipsoid.least_size_around_ellipsoid(shapes, own, np.ones(()))

    def corners(self, errors: Sequence[int]) -> None:
        """None: no finite number of points spans an ellipsoid."""
        return
