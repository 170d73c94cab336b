r"""The error map of a beat: how an error at its start becomes an error at its end (Eq. 2 and 11).

.. math:: x^+ = \Phi(\bar s_t \boxplus x,\ \bar a_t + \hat a,\ \sigma) \boxminus \bar s_{t+1}

with :math:`\Phi` one Runge-Kutta step and :math:`\boxplus, \boxminus` the error coordinates. The increment
:math:`\hat a` is one of the aircraft's virtual controls. Three views of the same map: its values at any points,
its linearisation, and its Taylor polynomial.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.dynamics.error_kernels import difference_each
from aerotube.dynamics.errors import ErrorCoordinates
from aerotube.dynamics.step import step, step_components
from aerotube.numerics.taylor import Taylor, TaylorSpace

if TYPE_CHECKING:
    from aerotube.nominal import Nominal

Array = NDArray[np.float64]


def error_map(
    aircraft: Aircraft,
    nominal: Nominal,
    beats: Sequence[int] | NDArray[np.intp],
    coordinates: ErrorCoordinates,
    error: Array,
    increment: Array | None = None,
    parameters: Array | None = None,
) -> Array:
    """Errors at the end of beats, from errors at their start.

    Parameters
    ----------
    aircraft : Aircraft
    nominal : Nominal
    beats : sequence of int, length b
        Indices of beats, ``0 <= beat < nominal.beats``.
    coordinates : ErrorCoordinates
    error : ndarray (b, ..., 8)
        Errors at the start of each beat.
    increment : ndarray (b, ..., 4), optional
        Increments of the virtual controls; none by default.
    parameters : ndarray (b, ..., p), optional
        Uncertain parameters; nominal by default.

    Returns
    -------
    ndarray (b, ..., 8)
        Batch axes broadcast.
    """
    beats = np.asarray(beats)
    error = np.asarray(error, dtype=float)
    depth = max(np.ndim(a) for a in (error, increment, parameters) if a is not None) - 2

    def per_beat(values: Array) -> Array:
        return values.reshape(len(beats), *(1,) * depth, values.shape[-1])

    before, after, count = nominal.states[beats], nominal.states[beats + 1], len(beats)
    flat = np.ascontiguousarray(error).reshape(count, -1, 8)
    start = coordinates.retract_each(before, flat).reshape(*error.shape[:-1], before.shape[1])
    end = step(
        aircraft,
        start,
        per_beat(nominal.controls[beats]),
        nominal.dt,
        parameters=parameters,
        increment=increment,
    )
    flat = np.ascontiguousarray(end).reshape(count, -1, end.shape[-1])
    return np.asarray(difference_each(flat, after, coordinates.kind == "relative").reshape(*end.shape[:-1], 8))


@dataclass(frozen=True)
class TaylorMap:
    """Taylor polynomials of the error map at a batch of beats, about zero error.

    Attributes
    ----------
    space : TaylorSpace
        The monomials, in the variables ``errors + increments + parameters`` listed below.
    coefficients : ndarray (b, 8, ncoef)
        Coefficients of each component of the error at the end of the beat.
    errors, increments, parameters : tuple of int
        Which error components, virtual controls and parameters are variables, in the order of the space's
        variables. Parameters enter as differences from the values the map was expanded at; every other error and
        increment is held at zero.
    """

    space: TaylorSpace
    coefficients: Array
    errors: tuple[int, ...]
    increments: tuple[int, ...]
    parameters: tuple[int, ...]

    def __call__(self, points: Array) -> Array:
        """Values at points (b, u, nvar): ndarray (b, u, 8)."""
        return np.asarray(self.space.monomials(points) @ np.swapaxes(self.coefficients, 1, 2))


def taylor_map(
    aircraft: Aircraft,
    nominal: Nominal,
    beats: Sequence[int] | NDArray[np.intp],
    coordinates: ErrorCoordinates,
    order: int = 3,
    errors: Sequence[int] = range(8),
    increments: Sequence[int] = range(4),
    parameters: Sequence[int] = (),
    at: Sequence[float] | NDArray[np.float64] | None = None,
) -> TaylorMap:
    """Taylor polynomials of the error map, by forward Taylor arithmetic through the aircraft's own equations.

    Parameters
    ----------
    beats : sequence of int, length b
    order : int
        Total degree; the paper's choice is 3 (Section 2.2.1).
    errors, increments, parameters : sequences of int
        The variables; see :class:`TaylorMap`.
    at : sequence of float or ndarray (b,), optional
        Values of the aircraft's parameters, one for all beats or one for each; nominal by default.

    Returns
    -------
    TaylorMap

    Notes
    -----
    Tables interpolated linearly contribute the slope of the piece the nominal lies on, and no curvature.
    """
    beats = np.asarray(beats)
    errors, increments, parameters = tuple(errors), tuple(increments), tuple(parameters)
    space = TaylorSpace(len(errors) + len(increments) + len(parameters), order)
    zero = np.zeros(len(beats))
    error: list[Any] = [zero] * 8
    increment: list[Any] = [zero] * 4
    sigma: list[Any] = [zero + value for value in (aircraft.parameter_nominal if at is None else at)]
    targets = [(error, i) for i in errors] + [(increment, i) for i in increments] + [(sigma, i) for i in parameters]
    for variable, (components, i) in enumerate(targets):
        components[i] = space.variable(variable, components[i])
    start = coordinates.retract_components(list(nominal.states[beats].T), error)
    end = step_components(
        aircraft,
        start,
        list(nominal.controls[beats].T),
        nominal.dt,
        parameters=sigma,
        increment=increment if increments else None,
    )
    difference = coordinates.difference_components(end, list(nominal.states[beats + 1].T))
    coefficients = np.zeros((len(beats), 8, len(space.exponents)))
    for i, component in enumerate(difference):
        if isinstance(component, Taylor):
            coefficients[:, i] = component.coefficients
        else:
            coefficients[:, i, 0] = component
    return TaylorMap(space, coefficients, errors, increments, parameters)


@dataclass(frozen=True)
class Linearisation:
    """First-order error map of every beat: ``x+ = A x + B du + offset``.

    Attributes
    ----------
    A : ndarray (T, 8, 8)
    B : ndarray (T, 8, 4)
        With respect to the increments of the virtual controls.
    offset : ndarray (T, 8)
        Error at the end of a beat that starts without one; zero where the nominal is a trajectory of this
        aircraft.
    """

    A: Array
    B: Array
    offset: Array


def linearise(
    aircraft: Aircraft,
    nominal: Nominal,
    coordinates: ErrorCoordinates,
    parameters: Sequence[float] | NDArray[np.float64] | None = None,
) -> Linearisation:
    """Linearise the error map at every beat of a nominal trajectory.

    Parameters
    ----------
    aircraft : Aircraft
    nominal : Nominal
    coordinates : ErrorCoordinates
    parameters : sequence of float, optional
        Values of the aircraft's parameters; nominal by default.

    Returns
    -------
    Linearisation
    """
    polynomial = taylor_map(aircraft, nominal, np.arange(nominal.beats), coordinates, order=1, at=parameters)
    by_variable = {tuple(e): i for i, e in enumerate(polynomial.space.exponents)}
    unit = np.eye(12, dtype=int)
    first = polynomial.coefficients[:, :, [by_variable[tuple(row)] for row in unit]]
    constant = polynomial.coefficients[:, :, by_variable[(0,) * 12]]
    return Linearisation(A=first[:, :, :8].copy(), B=first[:, :, 8:].copy(), offset=constant.copy())


# Steps of the errors (m/s, rad, rad/s) and, over half their range, of the increments: what curvature and what rounding
# leave of a difference over them are both about a part in a hundred million.
_STEPS = np.array([1e-2, *[3e-5] * 7])
_SHARE = 1e-4


def slopes(
    aircraft: Aircraft,
    nominal: Nominal,
    beats: Sequence[int] | NDArray[np.intp],
    coordinates: ErrorCoordinates,
    parameters: Array,
) -> Linearisation:
    """Linearise the error map at some beats by central differences of its values.

    The same as :func:`linearise` to about eight digits (and where a table has a kink, the mean of its two slopes), in a
    hundredth of the time for an aircraft with a compiled step.

    Parameters
    ----------
    aircraft : Aircraft
    nominal : Nominal
    beats : sequence of int, length b
    coordinates : ErrorCoordinates
    parameters : ndarray (b, p)
        Values of the aircraft's parameters at each.

    Returns
    -------
    Linearisation
        Of those beats.
    """
    beats = np.asarray(beats)
    lower, upper = aircraft.virtual_limits(nominal.states[beats], nominal.controls[beats])
    reach = np.concatenate([np.broadcast_to(_STEPS, (len(beats), 8)), 0.5 * _SHARE * (upper - lower)], axis=1)
    moves = np.zeros((len(beats), 25, 12))
    twelve = np.arange(12)
    moves[:, twelve, twelve], moves[:, 12 + twelve, twelve] = reach, -reach
    end = error_map(
        aircraft, nominal, beats, coordinates, moves[..., :8], moves[..., 8:], np.asarray(parameters)[:, None]
    )
    slope = np.swapaxes((end[:, :12] - end[:, 12:24]) / (2.0 * reach[:, :, None]), 1, 2)
    return Linearisation(A=slope[:, :, :8].copy(), B=slope[:, :, 8:].copy(), offset=end[:, 24].copy())
