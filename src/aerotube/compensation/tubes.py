"""Tubes: measuring, and certifying, where a law leaves the errors at the end of a beat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.aircraft.base import Aircraft
from aerotube.compensation import boundary, exact_map
from aerotube.compensation.bounds import NONE, SHARES, Bound
from aerotube.compensation.certify import Work, rigorous_bounds, sampled_bounds
from aerotube.compensation.closed_loop import BatchLaw, end_errors
from aerotube.compensation.polynomial import enough, least_volume, size
from aerotube.compensation.sets import InitialEllipsoid, initial_ellipsoid
from aerotube.compensation.settings import Part, SynthesisSettings
from aerotube.compensation.sizes import certified_size as certified_size
from aerotube.compensation.worst_points import Sampling
from aerotube.nominal import Nominal
from aerotube.tube import DisturbanceSet

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Tubes:
    """Trajectory tubes of every beat, part by part, in the law's error coordinates.

    Attributes
    ----------
    parts : tuple of Part
    initial_shape, initial_rho : ndarray (T, parts, n, n), (T, parts)
        Initial ellipsoids around the disturbance set.
    metric : ndarray (T, parts, n, n)
        The metric E1 in which size is measured.
    size, size_nominal : ndarray (T, parts)
        Bound of the size in that metric, with the law and without it, of the kind that `certificate` says.
    terminal_shape, terminal_rho : ndarray (T, parts, n, n), (T, parts)
        Terminal ellipsoids, with the law, of the same kind.
    nominal_shape, nominal_rho : ndarray (T, parts, n, n), (T, parts)
        The same without compensation.
    certificate, certificate_nominal : ndarray (T, parts) of str
        What stands behind the numbers with the law and without it:

        "solver's word"
            the solver's own values, which failed the check;
        "polynomial only"
            checked, for the polynomials through the values of the closed loop at the nodes, at the extreme parameters,
            the other parts' errors zero, measured exactly, in still air;
        "sampled"
            the true map over the whole set (parameters inside their ranges, the other parts' errors anywhere in their
            ellipsoids, the measurement errors and gusts that were asked for) exceeds them on no more than a share of
            the set, with a confidence that `sampling` states (`aerotube.compensation.sampled`);
        "rigorous"
            the true map over the whole set does not exceed them (`aerotube.compensation.rigorous`);
        "none"
            there is no tube, and the numbers are NaN.
    polynomial_size : ndarray (T, parts)
        Bound of the polynomials' size with the law, to which the rest was added.
    shares : ndarray (T, parts, 5)
        What each of `aerotube.compensation.SHARES` adds to it: together ``size - polynomial_size``. NaN where nothing
        was looked at beyond the polynomials.
    control : ndarray (T, parts)
        What the nonlinearity of the control's effect, which the law's program leaves out, can have added to the
        polynomials' size, of which it is a part. NaN where it was not looked at.
    boundary : ndarray (T, parts) of bool
        Whether the boundary of the initial ellipsoid is enough; the programs are on the whole ellipsoid otherwise.
    sampling : Sampling
        Number, confidence and seed of the samples of "sampled" tubes.
    certify_seconds : ndarray (T, parts)
        Time of what was added to the polynomials' bounds, one part of one beat, with the law; NaN where there is none.
    messages : tuple of str
        One sentence for each tube whose certificate is less than was asked for.
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
    certificate: NDArray[np.str_]
    certificate_nominal: NDArray[np.str_]
    polynomial_size: Array
    shares: Array
    control: Array
    boundary: NDArray[np.bool_]
    sampling: Sampling
    certify_seconds: Array
    messages: tuple[str, ...] = ()


def measure(
    aircraft: Aircraft,
    nominal: Nominal,
    disturbance: DisturbanceSet,
    law: BatchLaw,
    metric: Sequence[Array],
    settings: SynthesisSettings,
    *,
    beats: range | None = None,
    parts: Sequence[Part] | None = None,
    workers: int = 1,
) -> tuple[Tubes, tuple[sos.Certificate, ...]]:
    """Sizes and terminal ellipsoids of tubes, with a law and without it.

    Parameters
    ----------
    aircraft : Aircraft
    nominal : Nominal
    disturbance : DisturbanceSet
    law : BatchLaw
    metric : sequence of ndarray (b, n, n)
        In which the size of each part is measured.
    settings : SynthesisSettings
        Certificate asked for, what tubes must withstand, degree and backend of the programs.
    beats : range, optional
        All by default.
    parts : sequence of Part, optional
        Of the tubes; those of the settings by default. Where they are others, each has the metric whose blocks are
        those of the settings' parts within it: ``COUPLED`` gives a decoupled law one tube for all eight errors.
    workers : int
        Threads that solve; the numbers do not depend on it.

    Returns
    -------
    tubes : Tubes
        NaN where there is none.
    evidence : tuple of sos.Certificate
        Of the polynomials' sizes with the law, one for each part.
    """
    chosen = np.arange(nominal.beats) if beats is None else np.asarray(beats)
    wanted = settings.parts if parts is None else tuple(parts)
    forms = tuple(metric) if wanted == settings.parts else regrouped(metric, settings.parts, wanted)
    work = Work.of(aircraft, nominal, disturbance, law.coordinates, chosen, wanted, forms, settings, workers)
    initial = [initial_ellipsoid(disturbance, law.coordinates, nominal.states[chosen], part) for part in wanted]
    made = {}
    for name, flown in (("", law), ("nominal", None)):
        made[name] = [
            _Measured(work, index, ellipsoid, flown, settings.backend) for index, ellipsoid in enumerate(initial)
        ]
    if settings.certificate != "polynomial only":
        _raise(work, made, law, settings.certificate)
    for measured in (*made[""], *made["nominal"]):
        measured.finish()
    with_law, without = made[""], made["nominal"]

    def stacked(name: str, of: list[_Measured]) -> Array:
        return np.stack([getattr(one, name) for one in of], axis=1)

    tubes = Tubes(
        parts=wanted,
        initial_shape=np.stack([one.shape for one in initial], axis=1),
        initial_rho=np.stack([one.rho for one in initial], axis=1),
        metric=np.stack(forms, axis=1),
        size=stacked("size", with_law),
        size_nominal=stacked("size", without),
        terminal_shape=stacked("shape", with_law),
        terminal_rho=stacked("rho", with_law),
        nominal_shape=stacked("shape", without),
        nominal_rho=stacked("rho", without),
        certificate=np.stack([one.kind for one in with_law], axis=1),
        certificate_nominal=np.stack([one.kind for one in without], axis=1),
        polynomial_size=np.stack([np.where(one.kind == NONE, np.nan, one.polynomial.rho) for one in with_law], axis=1),
        shares=stacked("shares", with_law),
        control=stacked("control", with_law),
        boundary=np.stack([one.polynomial.boundary for one in with_law], axis=1),
        sampling=work.sampling,
        certify_seconds=stacked("seconds", with_law),
        messages=tuple(message for one in (*with_law, *without) for message in one.messages),
    )
    return tubes, tuple(one.polynomial.certificate for one in with_law)


def regrouped(metric: Sequence[Array], given: Sequence[Part], wanted: Sequence[Part]) -> tuple[Array, ...]:
    """Metrics (b, n, n) of other parts: blocks of those of the given parts, zero between them."""
    whole = np.zeros((len(metric[0]), 8, 8))
    for part, form in zip(given, metric, strict=True):
        whole[:, np.array(part.errors)[:, None], part.errors] = form
    return tuple(whole[:, np.array(part.errors)[:, None], part.errors] for part in wanted)


class _Measured:
    """Tubes of one part with a law or without, as they are made: the polynomials' bound first, then what is beyond."""

    def __init__(self, work: Work, index: int, initial: InitialEllipsoid, law: BatchLaw | None, backend: str) -> None:
        self.work, self.part, self.law = work, work.parts[index], law
        n, degree = len(self.part.errors), work.degree
        vertices = work.disturbance.parameter_vertices(work.aircraft)
        metric = work.metric[index]

        def end(nodes: Array) -> Array:
            points = np.einsum("bij,uj->bui", initial.whitening, nodes)
            return end_errors(
                work.aircraft, work.nominal, work.beats, work.coordinates, self.part, points, vertices, law
            )

        self.inside = end(boundary.nodes(n, degree))
        sufficient = enough(self.inside, metric, degree)
        self.on_ball = not sufficient.all()
        nodes = boundary.nodes(n, degree)
        ends = self.inside
        if not self.on_ball:
            nodes = exact_map.size_structure(n, len(vertices), degree).nodes("tube/0")
            ends = end(nodes)
        found = size(ends, metric, degree, nodes, self.on_ball, backend, work.workers)
        self.polynomial = replace(found, boundary=sufficient)
        count = len(work.beats)
        self.kind = np.full(count, NONE, dtype="<U15")
        self.kind[np.isfinite(found.rho)] = "solver's word"
        self.kind[found.certified] = "polynomial only"
        self.size = np.where(self.kind == NONE, np.nan, found.rho)
        self.shape, self.rho = np.full((count, n, n), np.nan), np.full(count, np.nan)
        self.shares, self.control = np.full((count, len(SHARES)), np.nan), np.full(count, np.nan)
        self.seconds = np.full(count, np.nan)
        self.messages: list[str] = []

    def raised(self, bound: Bound, kind: str, seconds: Array, asked: str) -> None:
        """Take over a bound where it holds and there is none of a better kind."""
        new = bound.holds & ~self.beyond
        self.kind[new] = kind
        for name in ("size", "shares", "control", "shape", "rho"):
            getattr(self, name)[new] = getattr(bound, name)[new]
        self.seconds[new] = seconds[new]
        whose = "" if self.law is not None else ", without compensation"
        if kind == asked:
            self.messages = [
                f"beat {self.work.beats[i]}, {self.part.name}{whose}: the tube is not {asked}: {bound.why}."
                for i in np.flatnonzero(~bound.holds)
            ]

    @property
    def beyond(self) -> NDArray[np.bool_]:
        """Beats that have a bound beyond the polynomials'."""
        return np.isin(self.kind, ("sampled", "rigorous"))

    def finish(self) -> None:
        """Find the terminal ellipsoids of the beats that have no bound beyond the polynomials'."""
        rows = np.flatnonzero(~self.beyond & (self.kind != NONE))
        if rows.size:
            shape, rho = least_volume(self.inside[rows], self.work.degree, self.work.workers)
            self.shape[rows], self.rho[rows] = shape, rho


def _raise(work: Work, made: dict[str, list[_Measured]], law: BatchLaw, asked: str) -> None:
    """Add what is beyond the polynomials, of the kind that was asked for, and of the next lower where that fails."""
    pairs = list(zip(made[""], made["nominal"], strict=True))
    sizes = [((a.polynomial, a.on_ball), (b.polynomial, b.on_ball)) for a, b in pairs]
    if asked == "rigorous":
        for pair, bounds in zip(pairs, rigorous_bounds(work, law, sizes), strict=True):
            for one, (bound, seconds) in zip(pair, bounds, strict=True):
                one.raised(bound, "rigorous", seconds, asked)
    if asked == "sampled" or not all(one.beyond.all() for pair in pairs for one in pair):
        for pair, bounds in zip(pairs, sampled_bounds(work, law, sizes), strict=True):
            for one, (bound, seconds) in zip(pair, bounds, strict=True):
                one.raised(bound, "sampled", seconds, asked)
