"""Tubes: measuring, and certifying, where a law leaves the errors at the end of a beat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.aircraft.base import Aircraft
from aerotube.compensation import exact_map
from aerotube.compensation.closed_loop import BatchLaw, end_errors
from aerotube.compensation.sets import initial_ellipsoid
from aerotube.compensation.settings import Part, SynthesisSettings
from aerotube.dynamics import ErrorCoordinates
from aerotube.nominal import Nominal
from aerotube.tube import DisturbanceBox

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Tubes:
    """Trajectory tubes of every beat, part by part, in the law's error coordinates.

    Attributes
    ----------
    parts : tuple of Part
    initial_shape, initial_rho : ndarray (T, parts, n, n), (T, parts)
        Initial ellipsoids: of least volume around the disturbance box.
    metric : ndarray (T, parts, n, n)
        The metric E1 the synthesis measured size in.
    size, size_nominal : ndarray (T, parts)
        Least ``rho`` in that metric, with the law and without it, certified.
    terminal_shape, terminal_rho : ndarray (T, parts, n, n), (T, parts)
        Terminal ellipsoids of least volume, with the law, certified; ``rho`` is one but for the certificate's
        margin.
    nominal_shape, nominal_rho : ndarray (T, parts, n, n), (T, parts)
        The same without compensation.
    certificate : str
        What stands behind these numbers: ``"polynomial only"`` says that they are checked, and hold for the
        polynomials through the values of the closed loop at the nodes, on the boundary of the initial ellipsoid
        and at the extreme parameters; not, as yet, for what lies between.
    """

    parts: tuple[Part, ...]
    initial_shape: Array
    initial_rho: Array
    metric: Array
    size: Array
    size_nominal: Array
    terminal_shape: Array
    terminal_rho: Array
    nominal_shape: Array
    nominal_rho: Array
    certificate: str


def measure(
    aircraft: Aircraft,
    nominal: Nominal,
    disturbance: DisturbanceBox,
    law: BatchLaw,
    metric: Sequence[Array],
    settings: SynthesisSettings,
    *,
    beats: range | None = None,
    workers: int = 1,
) -> tuple[Tubes, tuple[sos.Certificate, ...]]:
    """Sizes and terminal ellipsoids of tubes, with a law and without it.

    Parameters
    ----------
    aircraft : Aircraft
    nominal : Nominal
    disturbance : DisturbanceBox
    law : BatchLaw
    metric : sequence of ndarray (b, n, n)
        In which the size of each part is measured.
    settings : SynthesisSettings
        Parts, degree and backend of the programs.
    beats : range, optional
        All by default.
    workers : int
        Threads that solve.

    Returns
    -------
    tubes : Tubes
        NaN where there is none.
    evidence : tuple of sos.Certificate
        Of the sizes with the law, one for each part.
    """
    chosen = np.arange(nominal.beats) if beats is None else np.asarray(beats)
    vertices = disturbance.parameter_vertices(aircraft)
    found: list[dict[str, Array]] = []
    evidence = []
    for part, shape in zip(settings.parts, metric, strict=True):
        initial = initial_ellipsoid(disturbance, law.coordinates, nominal.states[chosen], part)
        nodes = exact_map.size_structure(len(part.errors), len(vertices), settings.degree).nodes("tube/0")
        points = np.einsum("bij,uj->bui", initial.whitening, nodes)
        sample = partial(end_errors, aircraft, nominal, chosen, law.coordinates, part, points, vertices)
        tubes, certificate = _measure_part(sample(law), sample(), shape, settings, workers)
        found.append({"initial_shape": initial.shape, "initial_rho": initial.rho} | tubes)
        evidence.append(certificate)
    stacked = {name: np.stack([one[name] for one in found], axis=1) for name in found[0]}
    return Tubes(settings.parts, **stacked, certificate="polynomial only"), tuple(evidence)


def certified_size(
    aircraft: Aircraft,
    nominal: Nominal,
    disturbance: DisturbanceBox,
    law: BatchLaw | None,
    metric: Sequence[Array],
    settings: SynthesisSettings,
    *,
    beats: range | NDArray[np.intp] | None = None,
    workers: int = 1,
) -> Array:
    """Sizes of the tubes with a law, and nothing else of what :func:`measure` gives: for use in flight.

    Parameters
    ----------
    law : BatchLaw or None
        None: the nominal controls alone.

    Returns
    -------
    ndarray (b, parts)
        NaN where no size could be certified. The other arguments are those of :func:`measure`.
    """
    chosen = np.arange(nominal.beats) if beats is None else np.asarray(beats)
    coordinates = ErrorCoordinates(settings.attitude) if law is None else law.coordinates
    vertices = disturbance.parameter_vertices(aircraft)
    sizes = []
    for part, shape in zip(settings.parts, metric, strict=True):
        initial = initial_ellipsoid(disturbance, coordinates, nominal.states[chosen], part)
        nodes = exact_map.size_structure(len(part.errors), len(vertices), settings.degree).nodes("tube/0")
        points = np.einsum("bij,uj->bui", initial.whitening, nodes)
        end = end_errors(aircraft, nominal, chosen, coordinates, part, points, vertices, law)
        structure = exact_map.size_structure(end.shape[3], end.shape[1], settings.degree)
        problem, unit = exact_map.size_data(structure, end, shape)
        # less is asked of the solver: what it leaves, the certificate adds, and the size stays a bound
        found = sos.solve(structure, problem, backend=settings.backend, workers=workers, tolerance=1e-4)
        sizes.append((found["rho"] + 1.01 * np.maximum(_deficit(found), 0.0) + 1e-14) * unit)
    return np.stack(sizes, axis=1)


def _measure_part(
    with_law: Array, without: Array, metric: Array, settings: SynthesisSettings, workers: int
) -> tuple[dict[str, Array], sos.Certificate]:
    """Tubes of one part, from its errors (b, k, U, n) at the end of the beats."""
    closed_shape, closed_rho = _least_volume(with_law, settings, workers)
    open_shape, open_rho = _least_volume(without, settings, workers)
    size, evidence = _least_rho(with_law, metric, settings, workers)
    tubes = {
        "metric": metric,
        "size": size,
        "size_nominal": _least_rho(without, metric, settings, workers)[0],
        "terminal_shape": closed_shape,
        "terminal_rho": closed_rho,
        "nominal_shape": open_shape,
        "nominal_rho": open_rho,
    }
    return tubes, evidence


def _least_rho(end: Array, metric: Array, settings: SynthesisSettings, workers: int) -> tuple[Array, sos.Certificate]:
    structure = exact_map.size_structure(end.shape[3], end.shape[1], settings.degree)
    problem, unit = exact_map.size_data(structure, end, metric)
    certificate = _lifted(sos.solve(structure, problem, backend=settings.backend, workers=workers))
    return np.asarray(np.where(certificate.holds, certificate.solution["rho"] * unit, np.nan)), certificate


def _least_volume(end: Array, settings: SynthesisSettings, workers: int) -> tuple[Array, Array]:
    structure = exact_map.volume_structure(end.shape[3], end.shape[1], settings.degree)
    problem, unit = exact_map.volume_data(structure, end)
    solution = sos.solve(structure, problem, backend="aerotube", workers=workers)
    form, rho = solution["E"], 1.0 + _deficit(solution)
    finite = np.asarray(np.isfinite(form).all((1, 2)))
    form = np.where(finite[:, None, None], form, 0.0)
    there = finite & (np.linalg.eigvalsh(0.5 * (form + np.swapaxes(form, 1, 2)))[:, 0] > 0)
    shape = np.swapaxes(unit, 1, 2) @ form @ unit
    return np.where(there[:, None, None], shape, np.nan), np.where(there, rho, np.nan)


def _deficit(solution: sos.Solution) -> Array:
    """What must be added to a tube's ``rho`` for it to hold whatever the solver said: ndarray (b,).

    The certificate bounds from below what the solver claims to be positive; NaN where there is no answer at all.
    """
    margins = solution.certificate().margins
    deficit = -np.min([margin for name, margin in margins.items() if name.startswith("tube/")], axis=0)
    return np.asarray(np.where(np.isfinite(solution.values).all(-1) & np.isfinite(deficit), deficit, np.nan))


def _lifted(solution: sos.Solution) -> sos.Certificate:
    """The certificate of a size program, its ``rho`` raised by as much as makes it hold (and a percent more)."""
    lift = np.nan_to_num(1.01 * np.maximum(_deficit(solution), 0.0)) + 1e-14
    values = solution.values + lift[:, None]
    return replace(solution, values=values, objective=solution.objective + lift).certificate()
