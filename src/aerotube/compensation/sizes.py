"""Sizes of tubes alone, for those who have no time for the rest: a gauge and a flight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.aircraft.base import Aircraft
from aerotube.compensation import boundary, exact_map
from aerotube.compensation.bounds import NONE
from aerotube.compensation.certify import Work, sampled_sizes
from aerotube.compensation.closed_loop import BatchLaw, end_errors
from aerotube.compensation.polynomial import ball_size_structure, deficit, enough
from aerotube.compensation.sets import initial_ellipsoid
from aerotube.compensation.settings import Part, SynthesisSettings
from aerotube.dynamics import ErrorCoordinates
from aerotube.nominal import Nominal
from aerotube.tube import DisturbanceSet

Array = NDArray[np.float64]


def certified_size(
    aircraft: Aircraft,
    nominal: Nominal,
    disturbance: DisturbanceSet,
    law: BatchLaw | None,
    metric: Sequence[Array],
    settings: SynthesisSettings,
    *,
    beats: range | NDArray[np.intp] | None = None,
    workers: int = 1,
) -> Array:
    """Sizes of the tubes with a law, and nothing else of what :func:`.measure` gives: for the gauge.

    Parameters
    ----------
    law : BatchLaw or None
        None: the nominal controls alone.

    Returns
    -------
    ndarray (b, parts)
        For the polynomial only; NaN where no size could be certified. The other arguments are those of
        :func:`.measure`.
    """
    chosen = np.arange(nominal.beats) if beats is None else np.asarray(beats)
    coordinates = ErrorCoordinates(settings.attitude) if law is None else law.coordinates
    vertices = disturbance.parameter_vertices(aircraft)
    sizes = []
    for part, shape in zip(settings.parts, metric, strict=True):
        initial = initial_ellipsoid(disturbance, coordinates, nominal.states[chosen], part)
        n = len(part.errors)

        def end(nodes: Array, part: Part = part, whitening: Array = initial.whitening) -> Array:
            points = np.einsum("bij,uj->bui", whitening, nodes)
            return end_errors(aircraft, nominal, chosen, coordinates, part, points, vertices, law)

        inside, structure = end(boundary.nodes(n, settings.degree)), ball_size_structure
        ends = inside
        if enough(inside, shape, settings.degree).all():
            structure = exact_map.size_structure
            ends = end(structure(n, len(vertices), settings.degree).nodes("tube/0"))
        compiled = structure(n, len(vertices), settings.degree)
        problem, unit = exact_map.size_data(compiled, ends, shape)
        # less is asked of the solver: what it leaves, the certificate adds, and the size stays a bound
        found = sos.solve(compiled, problem, backend=settings.backend, workers=workers, tolerance=1e-4)
        sizes.append((found["rho"] + 1.01 * np.maximum(deficit(found), 0.0) + 1e-14) * unit)
    return np.stack(sizes, axis=1)


def flown_size(
    aircraft: Aircraft,
    nominal: Nominal,
    disturbance: DisturbanceSet,
    law: BatchLaw | None,
    metric: Sequence[Array],
    settings: SynthesisSettings,
    *,
    beats: range | NDArray[np.intp] | None = None,
    workers: int = 1,
) -> tuple[Array, NDArray[np.str_]]:
    """Sizes of the tubes with a law, and what stands behind them: as much of :func:`.measure` as a flight has time for.

    Parameters
    ----------
    law : BatchLaw or None
        None: the nominal controls alone.
    settings : SynthesisSettings
        Where they ask for tubes of the polynomials only, these are given. Otherwise the sizes are sampled (rigorous
        ones take too long), on as many samples and by the same search and margin as in :func:`.measure`, but the
        polynomials' programs are not solved; only where a sample's flight was not finite, a polynomial's size stands
        in.

    Returns
    -------
    size : ndarray (b, parts)
        NaN where there is none. The other arguments are those of :func:`.measure`.
    certificate : ndarray (b, parts) of str
        "sampled", "polynomial only" or "none".
    """
    chosen = np.arange(nominal.beats) if beats is None else np.asarray(beats)
    coordinates = ErrorCoordinates(settings.attitude) if law is None else law.coordinates
    size = np.full((len(chosen), len(settings.parts)), np.inf)
    if settings.certificate != "polynomial only":
        forms = tuple(metric)
        work = Work.of(aircraft, nominal, disturbance, coordinates, chosen, settings.parts, forms, settings, workers)
        size = sampled_sizes(work, law)
    kind = np.where(np.isfinite(size), "sampled", NONE).astype("<U15")
    rows = np.flatnonzero(~np.isfinite(size).all(1))
    if len(rows):
        forms = tuple(form[rows] for form in metric)
        instead = certified_size(
            aircraft, nominal, disturbance, law, forms, settings, beats=chosen[rows], workers=workers
        )
        missing = ~np.isfinite(size[rows])
        size[rows] = np.where(missing, instead, size[rows])
        kind[rows] = np.where(missing, np.where(np.isfinite(instead), "polynomial only", NONE), kind[rows])
    return size, kind
