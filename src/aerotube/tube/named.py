"""Disturbance sets by their kind's name, said in multiples of half-widths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from aerotube import sos
from aerotube.dynamics.errors import ERROR_NAMES
from aerotube.errors import InputError
from aerotube.tube.disturbance import DisturbanceBox, DisturbanceSet, checked_widths
from aerotube.tube.disturbance_ellipsoid import DisturbanceEllipsoid
from aerotube.tube.disturbance_polytope import DisturbancePolytope
from aerotube.tube.semialgebraic import SemialgebraicSet

Kind = Literal["box", "ellipsoid", "polytope", "semialgebraic"]


def disturbance_set(
    kind: Kind,
    half_widths: ArrayLike,
    relative: Mapping[str, float],
    *,
    matrix: ArrayLike | None = None,
    inequalities: Sequence[Mapping[tuple[int, ...], float]] = (),
    texts: Sequence[str] = (),
) -> DisturbanceSet:
    """Make a disturbance set.

    Parameters
    ----------
    kind : {"box", "ellipsoid", "polytope", "semialgebraic"}
    half_widths : ndarray (8,)
        Of ``[V, alpha, q, theta, beta, p, r, phi]``, SI and radians: of the box; the ellipsoid's half axes; of the
        box that inequalities cut the others from.
    relative : mapping of str to float
        As of `DisturbanceBox`.
    matrix : ndarray (8, 8), optional
        The ellipsoid is ``y' matrix y <= 1`` for errors y in units of the half-widths; the unit matrix by default.
    inequalities : sequence of mapping of exponents (8,) to coefficients
        Polynomials of errors in units of the half-widths, as of `aerotube.inequality.parse`, that are not negative on
        the set; linear ones for a polytope.
    texts : sequence of str, optional
        The inequalities as they were written, to be quoted in a mistake.

    Returns
    -------
    DisturbanceSet

    Raises
    ------
    InputError
        If the set cannot be made of these: see the sets themselves.
    """
    widths = checked_widths(np.asarray(half_widths, dtype=float))
    if kind == "box":
        return DisturbanceBox(widths, relative)
    if kind == "ellipsoid":
        form = np.eye(8) if matrix is None else np.asarray(matrix, dtype=float)
        return DisturbanceEllipsoid(form / (widths[:, None] * widths), relative)
    if kind == "semialgebraic":
        return SemialgebraicSet(widths, tuple(_polynomial(terms, widths) for terms in inequalities), relative)
    normals, offsets = [np.eye(8), -np.eye(8)], [np.ones(16)]
    for i, terms in enumerate(inequalities):
        which = f'"{texts[i]}"' if texts else f"inequality {i}"
        if max(map(sum, terms)) > 1:
            raise InputError(
                f"disturbance: {which} of the polytope is not linear; write it without powers and products, or "
                "name the set semialgebraic."
            )
        row = [-terms.get(tuple(int(i == j) for j in range(8)), 0.0) for i in range(8)]
        offset = terms.get((0,) * 8, 0.0)
        if not offset > 0:
            raise InputError(
                f"disturbance: {which} of the polytope does not leave the undisturbed state inside; it must "
                f"hold with room where all of {', '.join(ERROR_NAMES)} are zero."
            )
        normals.append(np.array([row]))
        offsets.append(np.array([offset]))
    return DisturbancePolytope(np.concatenate(normals) / widths, np.concatenate(offsets), relative)


def _polynomial(terms: Mapping[tuple[int, ...], float], widths: np.ndarray) -> sos.Polynomial:
    exponents = np.array(list(terms), dtype=np.int64)
    return sos.Polynomial(exponents, np.array(list(terms.values())) / np.prod(widths**exponents, axis=1))
