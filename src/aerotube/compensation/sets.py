r"""From a disturbance set to what a part's programs need of it: its initial ellipsoid and its corners.

Disturbances are differences of Euler angles; a law may work in other error coordinates. A box has its own image there
(a box around it, :meth:`~aerotube.dynamics.ErrorCoordinates.box`). The image of any other set :math:`S` lies in
:math:`LS \oplus R`: a linear image, since all components but the two of the attitude stay as they are and these, to
first order, are only scaled, and a small box for what that leaves out. Ellipsoids of least volume turn with :math:`L`,
so that one program serves all beats; a box added to an ellipsoid makes it larger by what the box's farthest corner
measures in it.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerotube.compensation.settings import Part
from aerotube.dynamics import ErrorCoordinates
from aerotube.numerics import attitude
from aerotube.tube import DisturbanceBox, DisturbanceSet, ellipsoid

Array = NDArray[np.float64]

_TILTS = (3, 7)  # the two components of the attitude
_MOST_SUMS = 20_000  # sums of corners whose hull is looked for
_MOST_DIMENSIONS = 4  # in which hulls are looked for: in eight they have too many sides


@dataclass(frozen=True)
class InitialEllipsoid:
    """Initial ellipsoids ``x' shape x <= rho`` of a part, of a batch of beats.

    Attributes
    ----------
    widths : ndarray (b, n)
        Half-widths, in the law's error coordinates, of a box that holds the disturbances.
    shape, rho : ndarray (b, n, n), (b,)
    whitening : ndarray (b, n, n)
        ``x = whitening @ z`` is on the boundary for unit z.
    corners : ndarray (b, k, n)
        Points whose convex hull holds the disturbances; none (k = 0) where that is best said by the ellipsoid.
    """

    widths: Array
    shape: Array
    rho: Array
    whitening: Array
    corners: Array

    def seen_corners(self, measurement: Array) -> Array:
        """Corners of the errors as they are measured, with measurement errors in a box of half-widths (b, n).

        Returns
        -------
        ndarray (b, k, n)
            With their opposites, points whose convex hull holds the sums of disturbances and measurement errors (and
            their opposites); none where there are none of the disturbances, or more than would serve a program.
        """
        count, n = self.corners.shape[1:]
        if not count:
            return self.corners
        seen = self.corners
        if count == 2**n and (np.abs(self.corners) == self.widths[:, None]).all():
            seen = self.corners * (1.0 + measurement / self.widths)[:, None]
        elif measurement.any():
            if count * 2**n > _MOST_SUMS:
                return self.corners[:, :0]
            signs = np.array(list(itertools.product((-1.0, 1.0), repeat=n)))
            seen = _sums(self.corners, signs * measurement[:, None])
        return _half_hulls(seen, self.widths + measurement)

    def seen_growth(self, measurement: Array) -> Array:
        """Factors (b,) by which the ellipsoid grows when its errors are measured with errors in a box (b, n)."""
        return np.asarray(1.0 + np.sqrt(ellipsoid.least_size_around_box(self.shape, measurement) / self.rho))


def initial_ellipsoid(
    disturbance: DisturbanceSet,
    coordinates: ErrorCoordinates,
    states: Array,
    part: Part,
    shape: Array | None = None,
) -> InitialEllipsoid:
    """Ellipsoids around a part's disturbances.

    Parameters
    ----------
    disturbance : DisturbanceSet
    coordinates : ErrorCoordinates
    states : ndarray (b, 13)
        Nominal states at the start of the beats.
    part : Part
    shape : ndarray (b, n, n), optional
        Shape of the ellipsoids, of which the least that holds the disturbances is taken: the paper's rule (Eq. 9 with
        E held). Of least volume without it.

    Returns
    -------
    InitialEllipsoid

    Raises
    ------
    ComputationError
        If an ellipsoid around the set cannot be found.
    """
    errors = list(part.errors)
    if isinstance(disturbance, DisturbanceBox):
        widths = coordinates.box(states, disturbance.half_widths)[:, errors]
        if shape is None:
            shape, rho = ellipsoid.least_volume_around_box(widths)
        else:
            rho = ellipsoid.least_size_around_box(shape, widths)
        signs = np.array(list(itertools.product((-1.0, 1.0), repeat=len(errors))))
        return InitialEllipsoid(widths, shape, rho, ellipsoid.whitening(shape, rho), signs * widths[:, None])
    scale, margin = (x[:, errors] for x in linear_image(coordinates, states, disturbance.half_widths))
    if shape is None:
        own, size = disturbance.least_volume(errors)
        shape, rho = own / (scale[:, :, None] * scale[:, None, :]), np.full(len(states), size)
    else:
        rho = disturbance.least_size(errors, shape * scale[:, :, None] * scale[:, None, :])
    rho = (np.sqrt(rho) + np.sqrt(ellipsoid.least_size_around_box(shape, margin))) ** 2
    corners = disturbance.corners(errors)
    moved = np.zeros((len(states), 0, len(errors)))
    if corners is not None:
        moved = corners * scale[:, None]
        if margin.any():
            free = np.flatnonzero(margin.any(axis=0))
            around = np.zeros((2 ** len(free), len(errors)))
            around[:, free] = list(itertools.product((-1.0, 1.0), repeat=len(free)))
            moved = _sums(moved, around * margin[:, None])
    widths = scale * disturbance.half_widths[errors] + margin
    return InitialEllipsoid(widths, shape, rho, ellipsoid.whitening(shape, rho), moved)


def linear_image(coordinates: ErrorCoordinates, states: Array, half_widths: Array) -> tuple[Array, Array]:
    """How error coordinates see differences of Euler angles: scaled, and by how much not quite.

    Parameters
    ----------
    coordinates : ErrorCoordinates
    states : ndarray (b, 13)
        Nominal states.
    half_widths : ndarray (8,)
        Of a box that holds the differences.

    Returns
    -------
    scale : ndarray (b, 8)
        Where the nominal stands on its nose, and a roll difference is no tilt at all, a tenth is taken.
    margin : ndarray (b, 8)
        Half-widths of a box that holds what scaling leaves out; zero but for the two components of the attitude.
    """
    scale, margin = np.ones((len(states), 8)), np.zeros((len(states), 8))
    if coordinates.kind == "euler":
        return scale, margin
    roll, pitch, yaw = attitude.euler_from_quaternion(tuple(states[:, i, None] for i in range(3, 7)))
    scale[:, 7] = np.maximum(np.abs(np.cos(pitch[:, 0])), 0.1)
    side = np.linspace(-1.0, 1.0, 17)
    tilts = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2) * half_widths[list(_TILTS)]
    moved = np.repeat(states[:, None], len(tilts), axis=1)
    quaternion = attitude.quaternion_from_euler(roll + tilts[:, 1], pitch + tilts[:, 0], yaw)
    for i in range(4):
        moved[..., 3 + i] = quaternion[i]
    image = coordinates.difference(moved, states[:, None])
    for column, i in enumerate(_TILTS):
        beyond = np.abs(image[..., i] - scale[:, i, None] * tilts[:, column]).max(axis=1)
        margin[:, i] = 1.02 * beyond  # it is smooth and all but quadratic: the grid misses less than this
    return scale, margin


def _sums(first: Array, second: Array) -> Array:
    """All sums of points (b, k, n) and (b, l, n): ndarray (b, k l, n)."""
    return np.asarray((first[:, :, None] + second[:, None]).reshape(len(first), -1, first.shape[-1]))


def _half_hulls(points: Array, unit: Array) -> Array:
    """Corners of the hulls of points (b, k, n) and their opposites, one of each pair: ndarray (b, l, n)."""
    from scipy.spatial import ConvexHull

    scaled = points / unit[:, None]
    leading = np.sign(np.take_along_axis(scaled, np.abs(scaled).argmax(axis=2)[..., None], axis=2))
    scaled = scaled * leading
    kept = []
    for own in scaled:
        half = np.unique(np.round(own, 12), axis=0)
        if half.shape[1] in range(2, _MOST_DIMENSIONS + 1):
            used = ConvexHull(np.concatenate([half, -half])).vertices
            half = half[np.unique(used[used < len(half)])]
        kept.append(half)
    most = max(len(half) for half in kept)
    # beats that have fewer say some twice
    filled = [np.concatenate([half, np.repeat(half[:1], most - len(half), axis=0)]) for half in kept]
    return np.asarray(np.stack(filled) * unit[:, None])
