r"""The paper's own program of a law (its Eq. 14), with its limits the right way round.

The size at the end of a beat enters to first order in the step (Eq. 4): with :math:`F = x^+ - x` and
:math:`e_0 = x^T E_0 x = \rho_0` on the boundary of the initial ellipsoid,

.. math:: e_1(x^+) \approx e_0(x) + 2 x^T E_0 F + x^T (E_1 - E_0) x ,

so that :math:`\rho_1 - 2 x^T E_0 (F + B\hat a) - x^T E_1 x` is to be a sum of squares there. It drops
:math:`F^T E_1 F` and :math:`2 x^T (E_1 - E_0) F`, which is what makes it convex in the terminal shape and the law
together, and why a tube it claims need not hold. The map is its third-order Taylor polynomial in the error and the
uncertain parameters, each of which is a variable with a multiplier; so are the sides of each control's limit on the
initial ellipsoid (Eq. 12; the paper's Eq. 13 is its converse). The terminal shape is free above its Riccati start
(Eq. 8). The multiplier of :math:`e_0 = \rho_0` is not needed where polynomials live on the sphere.

In whitened errors z, in which the initial ellipsoid is the unit ball, and controls in units of half their range.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.aircraft.base import Aircraft
from aerotube.compensation import monomials
from aerotube.compensation.forms import quadratic_forms
from aerotube.compensation.settings import Part
from aerotube.dynamics import ErrorCoordinates, taylor_map
from aerotube.nominal import Nominal

Array = NDArray[np.float64]

# The cubic map times the error itself.
_DEGREE = 4


@dataclass(frozen=True)
class Shape:
    """What the structure of a program depends on.

    Attributes
    ----------
    states, controls, parameters : int
        n, m and p.
    law_degree : int
        1 to 3.
    free : bool
        The terminal shape is a variable; held at its Riccati start otherwise (the second of three steps).
    """

    states: int
    controls: int
    parameters: int
    law_degree: int
    free: bool = True

    @property
    def domain(self) -> sos.Domain:
        """Boundary of the initial ellipsoid, times an interval for each parameter."""
        return sos.Product(sos.Sphere(self.states), *[sos.Interval()] * self.parameters)


@dataclass(frozen=True)
class IncrementData:
    """What the programs of a batch of beats are made from.

    Attributes
    ----------
    increment : ndarray (b, U, n)
        ``T^-1 (x+ - x)`` at the nodes of z and the parameters.
    input_map : ndarray (b, n, m)
        ``T^-1 B``, for controls in units of their half range.
    terminal : ndarray (b, n, n)
        Whitened terminal shape to start from, in units of ``rho_0``.
    room_below, room_above : ndarray (b, m)
        Increments that the limits leave, none negative, in units of the half range.
    """

    increment: Array
    input_map: Array
    terminal: Array
    room_below: Array
    room_above: Array


@lru_cache(maxsize=16)
def structure(shape: Shape) -> sos.Structure:
    """Structure of the program that finds the law: minimise ``rho`` over rho, E (where it is free) and K."""
    program = sos.Program()
    program.scalar("rho")
    if shape.free:
        program.symmetric("E", shape.states)
    program.matrix("K", (shape.controls, len(monomials.exponents(shape.states, shape.law_degree))))
    program.sos("tube", shape.domain, degree=_DEGREE)
    for k in range(shape.controls):
        for side in ("below", "above"):
            program.sos(f"{side}/{k}", sos.Ball(shape.states), degree=_DEGREE)
    if shape.free:
        program.lmi("terminal", shape.states)
    return program.compile()


@lru_cache(maxsize=16)
def terminal_structure(shape: Shape) -> sos.Structure:
    """Structure of the third step: with law and rho held, maximise ``log det E``."""
    program = sos.Program()
    program.symmetric("E", shape.states)
    program.sos("tube", shape.domain, degree=_DEGREE)
    program.lmi("terminal", shape.states)
    program.logdet("volume", shape.states)
    return program.compile()


def sampled(
    aircraft: Aircraft,
    nominal: Nominal,
    beats: NDArray[np.intp],
    coordinates: ErrorCoordinates,
    part: Part,
    ranges: Array,
    whitening: Array,
) -> Array:
    """Whitened increments at the nodes, from the third-order Taylor polynomial: ndarray (b, U, n).

    Parameters
    ----------
    aircraft : Aircraft
    nominal : Nominal
    beats : ndarray (b,) of int
    coordinates : ErrorCoordinates
    part : Part
    ranges : ndarray (parameters, 2)
        Of every parameter of the aircraft; those whose ends differ are variables.
    whitening : ndarray (b, n, n)
    """
    uncertain = np.flatnonzero(ranges[:, 0] != ranges[:, 1])
    n, p = len(part.errors), len(uncertain)
    points = structure(Shape(n, len(part.controls), p, 1)).nodes("tube")
    polynomial = taylor_map(
        aircraft,
        nominal,
        beats,
        coordinates,
        order=3,
        errors=part.errors,
        increments=(),
        parameters=tuple(uncertain.tolist()),
        at=ranges.mean(1),
    )
    start = np.einsum("bij,uj->bui", whitening, points[:, :n])
    half = 0.5 * (ranges[uncertain, 1] - ranges[uncertain, 0])
    sigma = np.broadcast_to(points[:, n:] * half, (len(beats), len(points), p))
    end = polynomial(np.concatenate([start, sigma], axis=-1))[..., part.errors]
    return np.asarray((end - start) @ np.swapaxes(np.linalg.inv(whitening), 1, 2))


def program_data(shape: Shape, data: IncrementData) -> sos.Data:
    """Data of :func:`structure` for a batch of beats."""
    compiled = structure(shape)
    batch, m = len(data.increment), shape.controls
    rho, K = compiled.variable("rho"), compiled.variable("K")
    powers = monomials.exponents(shape.states, shape.law_degree)
    z = compiled.nodes("tube")[:, : shape.states]
    linear = np.zeros((batch, len(z), compiled.size))
    linear[..., rho.index] = 1.0
    pushed = -2.0 * np.einsum("ui,bim->bum", z, data.input_map)
    linear[..., K.slice] = (pushed[..., None] * monomials.values(z, powers)[:, None]).reshape(batch, len(z), K.size)
    constant = -2.0 * np.einsum("ui,bui->bu", z, data.increment)
    constraints: dict[str, tuple[Array, ...]] = {}
    if shape.free:
        E = compiled.variable("E")
        linear[..., E.slice] = -quadratic_forms(z)
        constraints["terminal"] = (-data.terminal, _form(compiled.size, E))
    else:
        constant -= np.einsum("ui,bij,uj->bu", z, data.terminal, z)
    constraints["tube"] = (constant, linear)
    ball = compiled.nodes("below/0")
    table = monomials.values(ball, powers)
    for k in range(m):
        rows = np.zeros((len(ball), compiled.size))
        rows[:, K.index[k]] = table
        for side, sign, room in (("below", 1.0, data.room_below), ("above", -1.0, data.room_above)):
            constraints[f"{side}/{k}"] = (np.broadcast_to(room[:, k, None], (batch, len(ball))), sign * rows)
    objective = np.zeros(compiled.size)
    objective[rho.index] = 1.0
    return compiled.data(objective=objective, constraints=constraints)


def terminal_data(shape: Shape, data: IncrementData, law: Array, rho: Array) -> sos.Data:
    """Data of :func:`terminal_structure`, for laws K (b, m, M) and sizes (b,) that the second step found."""
    compiled = terminal_structure(shape)
    z = compiled.nodes("tube")[:, : shape.states]
    phi = monomials.values(z, monomials.exponents(shape.states, shape.law_degree))
    moved = data.increment + np.einsum("bim,bmp,up->bui", data.input_map, law, phi, optimize=True)
    constant = rho[:, None] - 2.0 * np.einsum("ui,bui->bu", z, moved)
    form = _form(compiled.size, compiled.variable("E"))
    zero = np.zeros((shape.states, shape.states))
    return compiled.data(
        objective=np.zeros(compiled.size),
        constraints={
            "tube": (constant, -quadratic_forms(z)),
            "terminal": (-data.terminal, form),
            "volume": (zero, form),
        },
    )


def _form(variables: int, E: sos.Variable) -> Array:
    n = E.shape[0]
    form = np.zeros((variables, n, n))
    rows, columns = np.indices((n, n))
    form[E.index, rows, columns] = 1.0
    return form
