"""The programs that are timed, made from the beats of the built-in manoeuvre (Table 2).

``*-map`` programs hold the exact error map sampled at nodes, at both extremes of the mass. ``*-paper`` programs are the
paper's Eq. 14 with its limits the right way round: the increment form (Eq. 4) with the error map's third-order Taylor
polynomial, the terminal shape free above its Riccati start, the mass a variable with a multiplier, and each side of
each control's limit a constraint on the initial ellipsoid with a multiplier of degree two.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal
from unittest import mock

import numpy as np

from aerotube import scenario, sos
from aerotube.compensation import increment
from aerotube.compensation.groundwork import effort_weights
from aerotube.compensation.settings import COUPLED, DECOUPLED, Part
from aerotube.compensation.synthesis import synthesise
from aerotube.dynamics import ErrorCoordinates, linearise
from aerotube.preparation import Prepared, prepare
from aerotube.tube import ellipsoid, parameter_ranges, riccati, tracking_weights
from benchmarks.neutral import Array, Program, from_data

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
    """The exact-map program of a part for all beats, as a synthesis hands it to the solver (noise-free setting).

    With a sum of squares for each extreme of the mass; the main job's default has one, for their mean.
    """
    made = manoeuvre("linear")
    algorithm: Literal["coupled", "decoupled"] = "coupled" if part is WHOLE else "decoupled"
    settings = replace(made.settings["noise_free"], degree=degree, algorithm=algorithm, extremes="each")
    solve = sos.solve

    def record(structure: sos.Structure, data: sos.Data, **options: Any) -> sos.Solution:
        if any(variable.name == "K" for variable in structure.variables):
            raise _Recorded(structure, data)
        return solve(structure, data, **options)

    # The synthesis's own program, whatever it comes to be, and not a copy of its making.
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
    ranges = parameter_ranges(aircraft, made.disturbance.relative)
    linear = linearise(aircraft, nominal, coordinates, ranges.mean(1))
    shapes = riccati(
        linear.A[:, own][:, :, own],
        linear.B[:, own][:, :, controls],
        tracking_weights(nominal.states, coordinates)[1:, own][:, :, own],
        effort_weights(aircraft, nominal, made.settings["noise_free"].control_weight)[:, controls][:, :, controls],
    )
    lower, upper = (x[list(beats)][:, controls] for x in aircraft.virtual_limits(nominal.states[:-1], nominal.controls))
    span = 0.5 * (upper - lower)
    chosen = np.array(beats)
    rho = ellipsoid.least_size_around_box(shapes[chosen], made.disturbance.half_widths[own])
    whitening = ellipsoid.whitening(shapes[chosen], rho)
    terminal = shapes[np.minimum(chosen + 1, nominal.beats - 1)]
    data = increment.IncrementData(
        increment=increment.sampled(aircraft, nominal, chosen, coordinates, part, ranges, whitening),
        input_map=np.linalg.solve(whitening, linear.B[chosen][:, own][:, :, controls] * span[:, None]),
        terminal=np.swapaxes(whitening, 1, 2) @ terminal @ whitening / rho[:, None, None],
        room_below=-lower / span,
        room_above=upper / span,
    )
    shape = increment.Shape(len(own), len(controls), 1, law_degree)
    problem = increment.program_data(shape, data)
    return [from_data(f"beat {beat}", problem.structure, problem, i) for i, beat in enumerate(beats)]


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
