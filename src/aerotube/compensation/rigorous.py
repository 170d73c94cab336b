r"""Rigorous bounds of tubes, from Taylor models of the error map over the whole set.

The map is the aircraft's equations under increments of its virtual controls, held over the beat and realised exactly
(a thrust, not the throttle that gives it). With P its polynomial and the remainder r of its enclosure,

* the size of P for the part's own errors at the extremes of the parameters is sampled exactly as a polynomial
  (`aerotube.dynamics.size_samples`) and certified as a sum of squares, with the Gram matrices of the program that was
  solved for the interpolant of the true map, to which it is close;
* all that is left of the map is added in the norm of the metric (`aerotube.dynamics.excess`);
* the terminal ellipsoid is one around the sum of an ellipsoid of least volume for the part's own terms of low degree,
  of what each other ball does linearly, and of a box that bounds the rest component by component.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from aerotube.compensation import boundary
from aerotube.compensation.bounds import Bound
from aerotube.compensation.covers import sum_around
from aerotube.compensation.polynomial import Size, least_volume, size_of_values
from aerotube.compensation.settings import Part
from aerotube.dynamics import ErrorEnclosure, Excess, SizeSamples, excess, size_samples
from aerotube.dynamics.remainder import component_norms

Array = NDArray[np.float64]

WIDER = 1.0 + 1e-9  # a terminal ellipsoid's allowance for the rounding of its own making


@dataclass(frozen=True)
class Pieces:
    """What the bound of a part is put together from, of a batch of beats.

    Attributes
    ----------
    holds : ndarray (b,) of bool
        Where there is an enclosure and the boundary is enough for its polynomial (or not needed).
    samples : SizeSamples
        At the nodes of the size program.
    left : Excess
    own : ndarray (b, k, U, n)
        The part's own terms of low degree at the nodes of the ball.
    cover : ndarray (b, n, n)
        P of an ellipsoid ``{x : x' P^-1 x <= 1}`` that holds everything else.
    """

    holds: NDArray[np.bool_]
    samples: SizeSamples
    left: Excess
    own: Array
    cover: Array


def pieces(
    enclosure: ErrorEnclosure,
    part: Part,
    others: Sequence[str],
    parameters: Sequence[str],
    metric: Array,
    nodes: Array,
    on_ball: bool,
    degree: int,
    without_law: ErrorEnclosure | None = None,
) -> Pieces:
    """Take an enclosure apart for one part.

    Parameters
    ----------
    enclosure : ErrorEnclosure
    part : Part
    others, parameters : sequence of str
        Names of its balls of the other parts' errors and of the parameters.
    metric : ndarray (b, n, n)
    nodes : ndarray (U, n)
        Of the size program.
    on_ball : bool
        Whether they are of the ball; the boundary need not be enough then.
    degree : int
        Of the programs.
    without_law : ErrorEnclosure, optional
        Of the same set: asks for `Excess.control`.

    Returns
    -------
    Pieces
    """
    n, errors = len(part.errors), part.errors
    left = excess(enclosure, metric, part.name, errors, others, parameters, without_law)
    samples = size_samples(enclosure, metric, part.name, errors, parameters, nodes, degree)
    inside = boundary.nodes(n, degree)
    holds = np.ones(len(metric), dtype=bool)
    if not on_ball:
        values = size_samples(enclosure, metric, part.name, errors, parameters, inside, degree).values
        holds = np.asarray((boundary.least_laplacian(values, n, degree) >= 0.0).all(axis=1))
    own, cover = _terminal(enclosure, part, others, parameters, inside, degree)
    return Pieces(holds, samples, left, own, cover)


def _terminal(
    enclosure: ErrorEnclosure, part: Part, others: Sequence[str], parameters: Sequence[str], nodes: Array, degree: int
) -> tuple[Array, Array]:
    """Own terms of low degree at the nodes, and the cover of the rest; see `Pieces`."""
    errors, space = list(part.errors), enclosure.space
    degrees, own = enclosure.degree(*enclosure.set.names), enclosure.degree(part.name)
    kept = (enclosure.degree(part.name, *parameters) == degrees) & (own <= degree // 2)
    for name in parameters:
        kept &= enclosure.degree(name) <= 1
    corners = np.array(list(product((-1.0, 1.0), repeat=len(parameters))))
    points = np.zeros((len(corners), len(nodes), space.taylor.variables))
    points[..., enclosure.set.columns(part.name)] = nodes
    for column, name in enumerate(parameters):
        points[..., enclosure.set.columns(name)] = corners[:, None, column, None]
    monomials = space.taylor.monomials(points) * kept
    coefficients = enclosure.coefficients[:, errors]
    ends = np.einsum("bit,kut->bkui", coefficients, monomials, optimize=True)

    rest, covers = ~kept, []
    for name in enclosure.set.names:
        if name == part.name or name in parameters:
            continue
        columns = enclosure.set.columns(name)
        first = np.arange(1 + columns.start, 1 + columns.stop)
        linear = coefficients[:, :, first]
        covers.append(linear @ np.swapaxes(linear, 1, 2))
        rest[first] = False
    box = component_norms(enclosure, errors, rest) + enclosure.remainder[:, errors]
    for i in range(len(errors)):
        side = np.zeros((len(box), len(errors), len(errors)))
        side[:, i, i] = box[:, i] ** 2
        covers.append(side)
    return ends, sum_around(np.stack(covers))


def joined(chunks: Sequence[Pieces]) -> Pieces:
    """Pieces of several batches of beats as one."""

    def along(values: Sequence[object]) -> object:
        first = values[0]
        if isinstance(first, np.ndarray):
            return np.concatenate(values)  # type: ignore[arg-type]
        return type(first)(*(along([getattr(value, f.name) for value in values]) for f in fields(first)))  # type: ignore[arg-type]

    return Pieces(*(along([getattr(chunk, f.name) for chunk in chunks]) for f in fields(Pieces)))  # type: ignore[arg-type]


def bound(found: Pieces, size: Size, degree: int, workers: int) -> Bound:
    """Rigorous bounds of the tubes of a part.

    Parameters
    ----------
    found : Pieces
    size : Size
        Of the interpolant, at the same nodes.
    degree : int
    workers : int

    Returns
    -------
    Bound
    """
    rho, certified = size_of_values(size, found.samples.values)
    rho = rho + found.samples.left_out + found.samples.rounding
    left, none = found.left, np.zeros_like(rho)
    apart = Excess(left.remainder, none, none, none, none, none, none)
    steps = [apart.bound(rho)]
    for names in (("parameters",), ("coupling", "coupling_size"), ("measurement",), ("gusts",)):
        apart = replace(apart, **{name: getattr(left, name) for name in names})
        steps.append(apart.bound(rho))
    shares = np.diff(np.stack([size.rho, *steps], axis=1), axis=1)
    root = np.sqrt(np.maximum(size.rho, 0.0))
    control = size.rho - np.maximum(root - left.control, 0.0) ** 2
    shape, own = least_volume(found.own, degree, workers)
    there = np.isfinite(own)
    identity = np.eye(shape.shape[-1])
    inner = own[:, None, None] * np.linalg.inv(np.where(there[:, None, None], shape, identity))
    cover = sum_around(np.stack([np.where(there[:, None, None], inner, identity), found.cover]))
    holds = found.holds & certified & there & np.isfinite(steps[-1])
    return Bound(
        holds,
        steps[-1],
        shares,
        control,
        np.asarray(np.linalg.inv(cover)),
        np.full(len(rho), WIDER),
        "the enclosure of its map gave no bound",
    )
