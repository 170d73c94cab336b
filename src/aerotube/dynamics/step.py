"""One step of the aircraft: the map of Eq. 1, by the classical Runge-Kutta method, the control held."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.dynamics.components import Components, join, split

Array = NDArray[np.float64]
Rates = Callable[[Sequence[Any]], Sequence[Any]]


def rk4(rates: Rates, state: Sequence[Any], dt: float) -> list[Any]:
    """Advance a state by one classical Runge-Kutta step, component-wise.

    Parameters
    ----------
    rates : callable
        Components of the state to components of its time derivative.
    state : sequence of floats, arrays or Taylor polynomials
    dt : float
        Length of the step, s.

    Returns
    -------
    list of components
    """
    k1 = rates(state)
    k2 = rates([x + (0.5 * dt) * k for x, k in zip(state, k1, strict=True)])
    k3 = rates([x + (0.5 * dt) * k for x, k in zip(state, k2, strict=True)])
    k4 = rates([x + dt * k for x, k in zip(state, k3, strict=True)])
    sixth = dt / 6.0
    return [x + sixth * (a + 2.0 * (b + c) + d) for x, a, b, c, d in zip(state, k1, k2, k3, k4, strict=True)]


def step_components(
    aircraft: Aircraft,
    state: Sequence[Any],
    control: Sequence[Any],
    dt: float,
    parameters: Sequence[Any] | None = None,
    wind: Sequence[Any] | None = None,
    increment: Sequence[Any] | None = None,
    substeps: int = 1,
) -> list[Any]:
    """Component-wise :func:`step`; components are floats, arrays or Taylor polynomials.

    Parameters
    ----------
    increment : sequence of components, optional
        Increments of the virtual controls on top of ``control`` (thrust instead of throttle, for example).
    """

    def rates(x: Sequence[Any]) -> Sequence[Any]:
        if increment is None:
            return aircraft.rates(x, control, parameters, wind)
        return aircraft.rates_virtual(x, control, increment, parameters, wind)

    x = list(state)
    for _ in range(substeps):
        x = rk4(rates, x, dt / substeps)
    q0, q1, q2, q3 = x[3:7]
    scale = 1.0 / np.sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
    x[3:7] = [q0 * scale, q1 * scale, q2 * scale, q3 * scale]
    return x


def step(
    aircraft: Aircraft,
    state: Array,
    control: Array,
    dt: float,
    parameters: Array | None = None,
    wind: Array | None = None,
    increment: Array | None = None,
    substeps: int = 1,
) -> Array:
    """State after one step of length ``dt`` with the control held (Eq. 1), by RK4, the quaternion renormalised.

    By the aircraft's compiled step where it has one.

    Parameters
    ----------
    aircraft : Aircraft
    state : ndarray (..., 13 or more)
        Full states, SI.
    control : ndarray (..., 4)
        Controls, in the aircraft's units.
    dt : float
        Step, s.
    parameters : ndarray (..., p), optional
        Uncertain parameters; nominal by default.
    wind : ndarray (..., 6), optional
        Velocity and rotation of the air in body axes, m/s and rad/s.
    increment : ndarray (..., 4), optional
        Increments of the virtual controls, see :meth:`Aircraft.rates_virtual`.
    substeps : int
        Runge-Kutta steps the interval is divided into.

    Returns
    -------
    ndarray (..., 13 or more)
        Batch axes of all arguments broadcast.
    """
    parameters_given = aircraft.parameter_nominal if parameters is None else parameters
    wind_given = np.zeros(6) if wind is None else wind
    if increment is None and (quick := aircraft.compiled_step()) is not None:
        rows, batch = _rows(state, control, parameters_given, wind_given)
        made = np.asarray(quick(rows[0], rows[1], rows[2], rows[3], dt, substeps))
        return made.reshape(*batch, made.shape[-1])
    if increment is not None and (moved := aircraft.compiled_virtual_step()) is not None:
        rows, batch = _rows(state, control, increment, parameters_given, wind_given)
        made = np.asarray(moved(rows[0], rows[1], rows[2], rows[3], rows[4], dt, substeps))
        return made.reshape(*batch, made.shape[-1])

    def optional(values: Array | None) -> Components | None:
        return None if values is None else split(values)

    return join(
        step_components(
            aircraft,
            split(state),
            split(control),
            dt,
            optional(parameters),
            optional(wind),
            optional(increment),
            substeps,
        )
    )


def _rows(*given: Array) -> tuple[list[Array], tuple[int, ...]]:
    """Arrays broadcast but for their last axes, as contiguous rows; and the batch axes."""
    arrays = [np.asarray(values, dtype=float) for values in given]
    batch = np.broadcast_shapes(*(array.shape[:-1] for array in arrays))
    rows = []
    for array in arrays:
        full = array if array.shape[:-1] == batch else np.broadcast_to(array, (*batch, array.shape[-1]))
        rows.append(np.ascontiguousarray(full).reshape(-1, array.shape[-1]))
    return rows, batch
