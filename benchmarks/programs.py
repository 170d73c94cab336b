"""The programs that are timed, made from the beats of the built-in manoeuvre (Table 2).

``*-map`` programs hold the exact error map sampled at nodes, as the main job solves them. ``*-paper`` programs are the
paper's Eq. 14 with its limits the right way round: the increment form (Eq. 4) with the error map's third-order Taylor
polynomial, the terminal shape free above its Riccati start, the mass a variable with a multiplier, and each side of
each control's limit a constraint on the initial ellipsoid with a multiplier of degree two.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any
from unittest import mock

import numpy as np

from aerotube import scenario, sos
from aerotube.compensation.groundwork import effort_weights
from aerotube.compensation.settings import COUPLED, DECOUPLED, Part
from aerotube.compensation.synthesis import synthesise
from aerotube.dynamics import ErrorCoordinates, linearise
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


class _Recorded(Exception):
    """Carries a program out of the synthesis, at the moment it would be solved."""


def map_data(part: Part, degree: int) -> tuple[sos.Structure, sos.Data]:
    """The exact-map program of a part for all beats, as the main job hands it to the solver (noise-free setting)."""
    made = manoeuvre("linear")
    settings = replace(
        made.settings["noise_free"], degree=degree, algorithm="coupled" if part is WHOLE else "decoupled"
    )
    solve = sos.solve

    def record(structure: sos.Structure, data: sos.Data, **options: Any) -> sos.Solution:
        if any(variable.name == "K" for variable in structure.variables):
            raise _Recorded(structure, data)
        return solve(structure, data, **options)

    # The main job's own program, whatever it comes to be, and not a copy of its making.
    with mock.patch.object(sos, "solve", record):
        try:
            synthesise(made.model, made.nominal, made.disturbance, settings)
        except _Recorded as found:
            structure, data = found.args
            return structure, _some(data, settings.parts.index(part) * made.nominal.beats, made.nominal.beats)
    raise RuntimeError(f"the synthesis of {part.name} solved no program for a gain K; see benchmarks/programs.py.")


def _some(data: sos.Data, start: int, count: int) -> sos.Data:
    """Some programs of a batch: the halves of the decoupled algorithm are solved in one, the longitudinal first."""
    structure = data.structure
    shapes = {c.name: c.shapes(structure.size) for c in structure.constraints}

    def own(array: Array, shape: tuple[int, ...]) -> Array:
        return array if array.ndim == len(shape) else array[start : start + count]

    return structure.data(
        objective=own(data.objective, (structure.size,)),
        constraints={
            name: [own(array, shapes[name][key]) for key, array in arrays.items()]
            for name, arrays in data.constraints.items()
        },
    )


def map_programs(part: Part, degree: int, beats: Sequence[int]) -> list[Program]:
    """Exact-map programs in monomials."""
    structure, data = map_data(part, degree)
    return [from_data(f"beat {beat}", structure, data, beat) for beat in beats]


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
    """Exact-map program of a made-up system of any number of states, half as many controls, two extremes.

    Minimise ``tr N / n + tr S / n`` such that ``z'Nz - r'r - 2 r'B K z`` is SOS on the sphere for both extremes,
    ``[[S, K'], [K, I]] >= 0``, and the rows of K are at most 0.3 long. B has orthonormal columns.
    """
    generator = np.random.default_rng(seed)
    controls = max(1, states // 2)
    program = sos.Program()
    N, S = program.symmetric("N", states), program.symmetric("S", states)
    K = program.matrix("K", (controls, states))
    for k in range(2):
        program.sos(f"tube/{k}", sos.Sphere(states), degree=degree)
    program.lmi("effort", states + controls)
    for i in range(controls):
        program.norm(f"limit/{i}", states)
    structure = program.compile()
    z, m = structure.nodes("tube/0"), structure.size
    rotation = np.linalg.qr(generator.standard_normal((states, states)))[0]
    bend = 0.05 * generator.standard_normal((states, states, states)) / states
    B = np.linalg.qr(generator.standard_normal((states, controls)))[0]
    rows, columns = np.indices((states, states))
    constraints: dict[str, tuple[Array, ...]] = {}
    for k in range(2):
        change = 0.05 * generator.standard_normal((states, states)) / np.sqrt(states)
        r = z @ (0.95 * rotation + change).T + np.einsum("ijl,uj,ul->ui", bend, z, z)
        linear = np.zeros((len(z), m))
        for place, value in zip(N.index.ravel(), (z[:, :, None] * z[:, None, :]).reshape(len(z), -1).T, strict=True):
            linear[:, place] += value
        linear[:, K.slice] = (-2.0 * (r @ B)[:, :, None] * z[:, None, :]).reshape(len(z), -1)
        constraints[f"tube/{k}"] = (-np.sum(r * r, axis=1), linear)
    corner = np.zeros((states + controls, states + controls))
    corner[states:, states:] = np.eye(controls)
    forms = np.zeros((m, *corner.shape))
    forms[S.index, rows, columns] = 1.0
    rows, columns = np.indices((controls, states))
    forms[K.index, states + rows, columns] = forms[K.index, columns, states + rows] = 1.0
    constraints["effort"] = (corner, forms)
    for i in range(controls):
        pick = np.zeros((states, m))
        pick[np.arange(states), K.index[i]] = 1.0
        constraints[f"limit/{i}"] = (pick, np.zeros(states), np.zeros(m), np.asarray(0.3))
    objective = np.zeros(m)
    objective[np.diagonal(N.index)] = objective[np.diagonal(S.index)] = 1.0 / states
    data = structure.data(objective=objective, constraints=constraints)
    return from_data(f"{states} states, degree {degree}", structure, data, 0)


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
