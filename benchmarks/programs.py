"""The programs that are timed, made from the beats of the built-in manoeuvre (Table 2).

``*-map`` programs hold the exact error map sampled at nodes, as the main job solves them. ``*-paper`` programs are the
paper's Eq. 14 with its limits the right way round: the increment form (Eq. 4) with the error map's third-order Taylor
polynomial, the terminal shape free above its Riccati start, the mass a variable with a multiplier, and each side of
each control's limit a constraint on the initial ellipsoid with a multiplier of degree two.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from aerotube import scenario, sos
from aerotube.compensation import exact_map
from aerotube.compensation.forecast import forecast
from aerotube.compensation.settings import COUPLED, DECOUPLED, Part
from aerotube.compensation.synthesis import effort_weights
from aerotube.dynamics import ErrorCoordinates, error_map, linearise
from aerotube.dynamics.error_map import taylor_map
from aerotube.preparation import Prepared, prepare
from aerotube.tube import ellipsoid, parameter_ranges, riccati, tracking_weights
from benchmarks.neutral import Array, IntArray, Linear, Lmi, Norm, Program, Sos, from_data, monomials

LONGITUDINAL, LATERAL = DECOUPLED
WHOLE = COUPLED[0]

#: Beats in an order in which every beginning is spread over the manoeuvre.
SPREAD = (0, 30, 15, 45, 8, 38, 22, 52, 4, 34, 19, 49, 12, 42, 26, 56, 2, 32, 17, 47)


@dataclass(frozen=True)
class Entry:
    """A program of the table.

    Attributes
    ----------
    words : str
        What it is.
    make : callable
        From beats to programs.
    beats : tuple of int
        Beats to be solved.
    """

    words: str
    make: Callable[[Sequence[int]], list[Program]]
    beats: tuple[int, ...]


@lru_cache(maxsize=2)
def manoeuvre(interpolation: str) -> Prepared:
    """The built-in scenario with linear or smooth tables."""
    names = ("aircraft.interpolation", "aircraft.synthesis_interpolation")
    return prepare(scenario.load(overrides=dict.fromkeys(names, interpolation)))


def map_data(part: Part, degree: int, beats: Sequence[int]) -> tuple[sos.Structure, sos.Data]:
    """The exact-map program of a part as the main job sets it up (noise-free setting), for some beats."""
    made = manoeuvre("linear")
    aircraft, nominal, settings = made.model, made.nominal, made.settings["noise_free"]
    coordinates, chosen = ErrorCoordinates(settings.attitude), np.asarray(beats)
    widths = coordinates.box(nominal.states[:-1], made.disturbance.half_widths)
    linear = linearise(aircraft, nominal, coordinates)
    ends = np.sort(parameter_ranges(aircraft, made.disturbance.relative).T, axis=0)
    moved = error_map(
        aircraft,
        nominal,
        np.arange(nominal.beats),
        coordinates,
        np.zeros((nominal.beats, 1, 8)),
        parameters=np.broadcast_to(ends, (nominal.beats, *ends.shape)),
    )
    effort = effort_weights(aircraft, nominal, settings.control_weight)
    expected = forecast(
        linear,
        tracking_weights(nominal.states, coordinates),
        effort,
        widths,
        0.5 * (moved[:, 1:] - moved[:, :1]),
        settings.noise_weight,
        (part,) if part is WHOLE else DECOUPLED,
    )
    own, controls = list(part.errors), list(part.controls)
    structure = exact_map.structure(len(own), len(controls), 2, degree, settings.size, settings.limits)
    nodes = structure.nodes("tube/0")
    whitening = ellipsoid.whitening(*ellipsoid.least_volume_around_box(widths[chosen][:, own]))
    error = np.zeros((len(chosen), 1, len(nodes), 8))
    error[..., own] = np.einsum("bij,uj->bui", whitening, nodes)[:, None]
    end = error_map(
        aircraft,
        nominal,
        chosen,
        coordinates,
        error,
        parameters=np.broadcast_to(ends[:, None, :], (len(chosen), 2, 1, ends.shape[1])),
    )
    lower, upper = aircraft.virtual_limits(nominal.states[:-1], nominal.controls)
    inverse = np.linalg.inv(whitening)
    moment = inverse @ expected.moment[chosen][:, own][:, :, own] @ np.swapaxes(inverse, 1, 2)
    data = exact_map.BeatData(
        map_values=np.ascontiguousarray(end[..., own]),
        input_map=np.stack(
            [linearise(aircraft, nominal, coordinates, vertex).B[chosen][:, own][..., controls] for vertex in ends], 1
        ),
        whitening=whitening,
        shape=expected.cost[1:][chosen][:, own][:, :, own],
        half_widths=widths[chosen][:, own],
        limit=np.minimum(-lower, upper)[chosen][:, controls],
        measurement_error=settings.measurement_error,
        expected=moment + settings.least_expected / len(own) * np.eye(len(own)),
        noise=np.zeros((len(chosen), len(own), len(own))),
        control_weight=effort[chosen][:, controls][:, :, controls],
    )
    scaling = exact_map.scale(data)
    return structure, exact_map.program_data(structure, data, scaling, settings.size, settings.limits)


def map_programs(part: Part, degree: int, beats: Sequence[int]) -> list[Program]:
    """Exact-map programs in monomials."""
    structure, data = map_data(part, degree, beats)
    return [from_data(f"beat {beat}", structure, data, i) for i, beat in enumerate(beats)]


def paper_programs(part: Part, law_degree: int, beats: Sequence[int]) -> list[Program]:
    """Programs in the paper's own form, with a law of degree 1 or 3."""
    made = manoeuvre("smooth")
    aircraft, nominal = made.model, made.nominal
    coordinates = ErrorCoordinates("euler")
    own, controls = list(part.errors), list(part.controls)
    low, high = parameter_ranges(aircraft, made.disturbance.relative)[0]
    centre = (0.5 * (low + high), *aircraft.parameter_nominal[1:])
    linear = linearise(aircraft, nominal, coordinates, centre)
    shapes = riccati(
        linear.A[:, own][:, :, own],
        linear.B[:, own][:, :, controls],
        tracking_weights(nominal.states, coordinates)[1:, own][:, :, own],
        effort_weights(aircraft, nominal, made.settings["noise_free"].control_weight)[:, controls][:, :, controls],
    )
    lower, upper = aircraft.virtual_limits(nominal.states[:-1], nominal.controls)
    maps = taylor_map(
        aircraft, nominal, list(beats), coordinates, 3, errors=own, increments=(), parameters=(0,), at=centre
    )
    out = []
    for position, beat in enumerate(beats):
        shape, terminal = shapes[beat], shapes[min(beat + 1, nominal.beats - 1)]
        rho = ellipsoid.least_size_around_box(shape, made.disturbance.half_widths[own])
        whitening = ellipsoid.whitening(shape, rho)
        span = 0.5 * (upper - lower)[beat, controls]
        out.append(
            increment_program(
                f"beat {beat}",
                _whitened_increment(maps.coefficients[position, own], maps.space, whitening, 0.5 * (high - low)),
                np.linalg.solve(whitening, linear.B[beat][np.ix_(own, controls)] * span),
                whitening.T @ terminal @ whitening / rho,
                -lower[beat, controls] / span,
                upper[beat, controls] / span,
                law_degree,
            )
        )
    return out


def _whitened_increment(coefficients: Array, space: Any, whitening: Array, half_range: float) -> tuple[IntArray, Array]:
    """Coefficients (n, k) of ``T^-1 (x+(T z, s) - T z)`` in monomials of (z, s), by interpolation."""
    n = len(whitening)
    exponents = space.exponents
    points = sos.Product(sos.Ball(n), sos.Interval()).sample(4 * len(exponents), seed=3)
    start = points[:, :n] @ whitening.T
    end = space.monomials(np.column_stack([start, half_range * points[:, n:]])) @ coefficients.T
    values = np.linalg.solve(whitening, (end - start).T).T
    return exponents, np.asarray(np.linalg.lstsq(monomials(points, exponents), values, rcond=None)[0].T, dtype=float)


def increment_program(
    name: str,
    increment: tuple[IntArray, Array],
    input_map: Array,
    terminal: Array,
    room_below: Array,
    room_above: Array,
    law_degree: int,
) -> Program:
    """Minimise rho such that ``rho - 2 z'(F + B K phi(z)) - z'E z`` is SOS on the sphere times the interval of s.

    Parameters
    ----------
    name : str
    increment : exponents (k, n + 1) and coefficients (n, k)
        F, of degree 3 in (z, s).
    input_map : (n, m)
        B, for controls in units of their half range.
    terminal : (n, n)
        Lower bound of the terminal shape E.
    room_below, room_above : (m,)
        Increments that the limits leave, both positive.
    law_degree : int
        phi holds the monomials of degrees 1 to `law_degree`.
    """
    exponents, F = increment
    n, m = input_map.shape
    law = np.array([e for e in itertools.product(range(law_degree + 1), repeat=n) if 1 <= sum(e) <= law_degree])
    pairs = [(i, j) for i in range(n) for j in range(i + 1)]
    size = 1 + len(pairs) + m * len(law)
    first_gain = 1 + len(pairs)
    tube = _Collector(n + 1, size)
    tube.add(np.zeros(n + 1), 1.0, 0)
    unit = np.eye(n + 1, dtype=int)
    for index, (i, j) in enumerate(pairs):
        tube.add(unit[i] + unit[j], -1.0 if i == j else -2.0, 1 + index)
    for i in range(n):
        for exponent, value in zip(exponents, F[i], strict=True):
            tube.add(unit[i] + exponent, -2.0 * value)
        for k in range(m):
            for j, exponent in enumerate(law):
                tube.add(unit[i] + [*exponent, 0], -2.0 * input_map[i, k], first_gain + k * len(law) + j)
    constraints: list[Sos | Lmi | Linear | Norm] = [tube.sos("tube", (("sphere", n), ("ball", 1)))]
    for k in range(m):
        for side, sign, room in (("below", 1.0, room_below[k]), ("above", -1.0, room_above[k])):
            limit = _Collector(n, size)
            limit.add(np.zeros(n), room)
            for j, exponent in enumerate(law):
                limit.add(exponent, sign, first_gain + k * len(law) + j)
            constraints.append(limit.sos(f"{side}/{k}", (("ball", n),)))
    forms = np.zeros((size, n, n))
    for index, (i, j) in enumerate(pairs):
        forms[1 + index, i, j] = forms[1 + index, j, i] = 1.0
    constraints.append(Lmi("terminal", -terminal, forms))
    objective = np.zeros(size)
    objective[0] = 1.0
    return Program(name, objective, tuple(constraints))


class _Collector:
    """Adds up terms of a polynomial that is affine in the decisions."""

    def __init__(self, coordinates: int, size: int) -> None:
        self._size = size
        self._rows: dict[tuple[int, ...], Array] = {(0,) * coordinates: np.zeros(1 + size)}

    def add(self, exponent: Any, value: float, variable: int = -1) -> None:
        power = tuple(int(p) for p in exponent)
        self._rows.setdefault(power, np.zeros(1 + self._size))[1 + variable] += value

    def sos(self, name: str, factors: tuple[tuple[str, int], ...]) -> Sos:
        table = np.array(list(self._rows.values()))
        return Sos(name, factors, 4, np.array(list(self._rows), dtype=np.int64), table[:, 0], table[:, 1:])


def synthetic_map(states: int, degree: int, seed: int = 1) -> Program:
    """Exact-map program of a made-up system of any number of states, half as many controls, two extremes."""
    generator = np.random.default_rng(seed)
    controls = max(1, states // 2)
    structure = exact_map.structure(states, controls, 2, degree, "mean-square", "ellipsoid")
    nodes = structure.nodes("tube/0")
    rotation = np.linalg.qr(generator.standard_normal((states, states)))[0]
    change = 0.05 * generator.standard_normal((2, states, states)) / np.sqrt(states)
    bend = 0.05 * generator.standard_normal((states, states, states)) / states
    values = np.einsum("kij,uj->kui", 0.95 * rotation + change, nodes) + np.einsum("ijl,uj,ul->ui", bend, nodes, nodes)
    identity = np.eye(states)[None]
    inputs = generator.standard_normal((1, 1, states, controls)) / np.sqrt(states)
    data = exact_map.BeatData(
        map_values=values[None],
        input_map=np.repeat(inputs, 2, axis=1),
        whitening=identity,
        shape=identity,
        half_widths=np.full((1, states), states**-0.5),
        limit=np.full((1, controls), 0.3),
        measurement_error=0.0,
        expected=identity / states,
        noise=0.0 * identity,
        control_weight=1e-3 * np.eye(controls)[None],
    )
    problem = exact_map.program_data(structure, data, exact_map.scale(data), "mean-square", "ellipsoid")
    return from_data(f"{states} states, degree {degree}", structure, problem, 0)


TABLE: dict[str, Entry] = {
    "lon-map": Entry("4 states, exact map, degree 4", lambda beats: map_programs(LONGITUDINAL, 4, beats), SPREAD),
    "lon-map-6": Entry("4 states, exact map, degree 6", lambda beats: map_programs(LONGITUDINAL, 6, beats), SPREAD),
    "lon-paper": Entry(
        "4 states, paper's form, cubic law", lambda beats: paper_programs(LONGITUDINAL, 3, beats), SPREAD
    ),
    "coupled-map": Entry("8 states, exact map, degree 4", lambda beats: map_programs(WHOLE, 4, beats), SPREAD[:6]),
    "coupled-paper-linear": Entry(
        "8 states, paper's form, linear law", lambda beats: paper_programs(WHOLE, 1, beats), SPREAD[:3]
    ),
    "coupled-paper-cubic": Entry(
        "8 states, paper's form, cubic law", lambda beats: paper_programs(WHOLE, 3, beats), SPREAD[:3]
    ),
}
