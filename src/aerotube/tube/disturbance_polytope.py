"""Disturbances in a polytope: bounds on errors together, such as on speed and pitch at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import InitVar, dataclass, field

import numpy as np
from numpy.typing import NDArray

from aerotube.dynamics.errors import ERROR_NAMES
from aerotube.errors import ComputationError, InputError
from aerotube.tube.disturbance import Array, DisturbanceSet, check_relative
from aerotube.tube.lowner import least_volume_around_points

_MOST_SIDES = 10_000
_STRIDES = 200  # of the random walk: its points forget where they started after some n^2


@dataclass(frozen=True)
class DisturbancePolytope(DisturbanceSet):
    """Errors with ``normals x <= offsets``.

    Attributes
    ----------
    normals : ndarray (m, 8)
        Row by row, in the units of ``[V, alpha, q, theta, beta, p, r, phi]``, SI and radians.
    offsets : ndarray (m,)
        All positive: the undisturbed state is inside.
    relative : mapping of str to float
        As of `DisturbanceBox`.
    vertices : ndarray (k, 8)
        Found from the inequalities, unless they are `known`.

    Raises
    ------
    InputError
        If arrays do not fit, an offset is not positive, an error is not bounded, or a relative change not in [0, 1).
    ComputationError
        If the vertices cannot be told for rounding.
    """

    normals: Array
    offsets: Array
    relative: Mapping[str, float] = field(default_factory=dict)
    vertices: Array = field(init=False, repr=False, compare=False)
    known: InitVar[Array | None] = None

    def __post_init__(self, known: Array | None) -> None:
        normals, offsets = np.array(self.normals, dtype=float), np.array(self.offsets, dtype=float)
        if normals.ndim != 2 or normals.shape[1] != 8 or offsets.shape != normals.shape[:1]:
            raise InputError(
                f"disturbance: a polytope needs normals (m, 8) and offsets (m,); got {normals.shape} and "
                f"{offsets.shape}."
            )
        if not np.isfinite(normals).all() or not (np.isfinite(offsets) & (offsets > 0)).all():
            raise InputError(
                "disturbance: a polytope's normals must be finite and its offsets positive, so that the undisturbed "
                "state is inside."
            )
        widths = _half_widths(normals, offsets)
        vertices = known if known is not None else _vertices(normals * widths / offsets[:, None]) * widths
        check_relative(self.relative)
        for name, value in {
            "normals": normals, "offsets": offsets, "half_widths": widths, "vertices": vertices, "_found": {},
        }.items():  # fmt: skip
            object.__setattr__(self, name, value)

    @classmethod
    def from_vertices(cls, vertices: Array, relative: Mapping[str, float] | None = None) -> DisturbancePolytope:
        """Convex hull of points (k, 8) about the origin; InputError if it is flat or the origin not inside it."""
        from scipy.spatial import ConvexHull, QhullError

        points = np.asarray(vertices, dtype=float)
        if points.ndim != 2 or points.shape[1] != 8 or not np.isfinite(points).all():
            raise InputError(f"disturbance: a polytope's vertices are of shape {points.shape}; give finite (k, 8).")
        unit = np.maximum(np.abs(points).max(axis=0), np.finfo(float).tiny)
        try:
            hull = ConvexHull(points / unit)
        except (QhullError, ValueError):
            raise InputError(
                "disturbance: the polytope's vertices lie in a plane or are too few; give at least nine that span "
                "all eight errors."
            ) from None
        facets = np.unique(np.round(hull.equations, 12), axis=0)
        if len(facets) > _MOST_SIDES:
            raise InputError(
                f"disturbance: the hull of {len(points)} points has {len(facets)} sides; give fewer points, or their "
                "ellipsoid."
            )
        return cls(facets[:, :-1] / unit, -facets[:, -1], relative or {}, known=points[hull.vertices])

    def support(self, directions: Array) -> Array:
        """Largest ``d' x``, at a vertex; see `DisturbanceSet.support`."""
        return np.asarray((np.asarray(directions, dtype=float) @ self.vertices.T).max(axis=-1))

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Whether points lie in the polytope; see `DisturbanceSet.contains`."""
        return np.asarray((points @ self.normals.T <= self.offsets * (1.0 + 1e-9)).all(axis=-1))

    def sample(self, count: int, generator: np.random.Generator) -> Array:
        """Nearly uniform points, each the end of a random walk of its own from the origin.

        Hit and run (R. L. Smith, *Operations Research* 32 (1984) 1296-1308); see `DisturbanceSet.sample`.
        """
        rows = self.normals * self.half_widths / self.offsets[:, None]
        points = np.zeros((count, 8))
        for _ in range(_STRIDES):
            direction = generator.standard_normal((count, 8))
            slope, room = direction @ rows.T, 1.0 - points @ rows.T
            with np.errstate(divide="ignore"):
                reach = np.maximum(room, 0.0) / slope
            ahead = np.where(slope > 0, reach, np.inf).min(axis=1)
            behind = np.where(slope < 0, reach, -np.inf).max(axis=1)
            points += (behind + (ahead - behind) * generator.random(count))[:, None] * direction
        return np.asarray(points * self.half_widths)

    def least_volume(self, errors: Sequence[int]) -> tuple[Array, float]:
        """Around the vertices, see :mod:`aerotube.tube.lowner` and `DisturbanceSet.least_volume`."""
        found: dict[tuple[int, ...], tuple[Array, float]] = vars(self)["_found"]
        key = tuple(errors)
        if key not in found:
            found[key] = least_volume_around_points(self.corners(errors))
        return found[key]

    def least_size(self, errors: Sequence[int], shapes: Array) -> Array:
        """The largest value at a vertex; see `DisturbanceSet.least_size`."""
        points = self.vertices[:, list(errors)]
        return np.asarray(np.einsum("vi,bij,vj->bv", points, shapes, points, optimize=True).max(axis=1))

    def corners(self, errors: Sequence[int]) -> Array:
        """Vertices of the projection; see `DisturbanceSet.corners`."""
        from scipy.spatial import ConvexHull

        points = self.vertices[:, list(errors)]
        if len(errors) == 8:
            return points
        if len(errors) == 1:
            return np.array([points.min(axis=0), points.max(axis=0)])
        return points[ConvexHull(points / self.half_widths[list(errors)]).vertices]


def _half_widths(normals: Array, offsets: Array) -> Array:
    """Half-widths of the smallest centred box around a polytope, by linear programs: ndarray (8,)."""
    from scipy.optimize import linprog

    # errors differ in size by their units: each column in the unit in which its rows have it
    unit = 1.0 / np.maximum(np.abs(normals / offsets[:, None]).max(axis=0), np.finfo(float).tiny)
    rows, widths = normals * unit / offsets[:, None], np.zeros(8)
    for i, name in enumerate(ERROR_NAMES):
        for sign in (1.0, -1.0):
            direction = np.zeros(8)
            direction[i] = -sign
            found = linprog(direction, A_ub=rows, b_ub=np.ones(len(rows)), bounds=(None, None))
            if found.status != 0:
                raise InputError(
                    f"disturbance: the polytope does not bound {name}; add an inequality that does, on either side."
                )
            widths[i] = max(widths[i], -found.fun * unit[i])
    return widths


def _vertices(rows: Array) -> Array:
    """Vertices of ``rows x <= 1``: ndarray (k, 8)."""
    from scipy.spatial import HalfspaceIntersection, QhullError

    try:
        found = HalfspaceIntersection(np.column_stack([rows, -np.ones(len(rows))]), np.zeros(rows.shape[1]))
    except QhullError:
        raise ComputationError(
            "disturbance: the vertices of the polytope cannot be told from its inequalities, too many of which meet in "
            "a point; give its vertices instead (DisturbancePolytope.from_vertices)."
        ) from None
    points = found.intersections[np.isfinite(found.intersections).all(axis=1)]
    points = points[(points @ rows.T <= 1.0 + 1e-7).all(axis=1)]
    return points[np.sort(np.unique(np.round(points, 8), axis=0, return_index=True)[1])]
