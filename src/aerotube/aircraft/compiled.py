"""Steps compiled from the same equations that run in NumPy, for one aircraft or a few at a time.

The equations are small functions that hand on states, tables and numbers, seventy of them at a time: they are inlined,
and the tables borrowed, or the handing on would take three times as long as the arithmetic.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.typing import NDArray

from aerotube.numerics import borrowed

Array = NDArray[np.float64]
Step = Callable[[Array, Array, Array, Array, float, int], Array]
VirtualStep = Callable[[Array, Array, Array, Array, Array, float, int], Array]
Realise = Callable[[Array, Array, Array], Array]

_components: Any = to_fixed_tuple  # a row of known length as a tuple

# Runge-Kutta's classical method: how far ahead the next stage lies, and what each stage weighs
_AHEAD = (0.5, 0.5, 1.0, 0.0)
_WEIGHTS = (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0)


@cache
def _sources() -> str:
    """Fingerprint of the source of everything that may be compiled into a step."""
    folder = Path(__file__).parent
    files = sorted([*folder.glob("*.py"), *(folder.parent / "numerics").glob("*.py")])
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


@cache
def _kernel(rates: Any, state_count: int, control_count: int, parameter_count: int, sources: str) -> Any:
    @njit(cache=True, nogil=True)
    def advance(
        model: Any,
        states: Array,
        controls: Array,
        increments: Array,
        parameters: Array,
        wind: Array,
        dt: float,
        substeps: int,
        result: Array,
    ) -> str:
        step, numbers = dt / substeps, borrowed(model)
        now, ahead, total = np.empty(state_count), np.empty(state_count), np.empty(state_count)
        for run in range(states.shape[0]):
            control = _components(controls[run], control_count)
            # one row stands for all
            increment = _components(increments[min(run, increments.shape[0] - 1)], control_count)
            sigma = _components(parameters[run], parameter_count)
            air = _components(wind[run], 6)
            for i in range(state_count):
                now[i] = states[run, i]
            for _ in range(substeps):
                for i in range(state_count):
                    ahead[i] = now[i]
                    total[i] = 0.0
                for stage in range(4):
                    slope = rates(numbers, _components(ahead, state_count), control, increment, sigma, air)
                    for i in range(state_count):
                        total[i] += _WEIGHTS[stage] * slope[i]
                        ahead[i] = now[i] + _AHEAD[stage] * step * slope[i]
                for i in range(state_count):
                    now[i] += step * total[i]
            length = np.sqrt(now[3] ** 2 + now[4] ** 2 + now[5] ** 2 + now[6] ** 2)
            for i in range(state_count):
                result[run, i] = now[i] / length if 3 <= i < 7 else now[i]
        # numba files compiled code under what its source closes over: with the fingerprint among that, code
        # compiled from equations that have changed since, in any file, is not taken from the cache
        return sources

    return advance


def compiled_step(rates: Any, model: Any, state_count: int, control_count: int, parameter_count: int) -> Step:
    """A compiled step of an aircraft whose rates are a pure function of components.

    Parameters
    ----------
    rates : function
        ``rates(model, state, control, increment, parameters, wind)``, tuples of components in and out, that numba can
        compile (decorated with ``numba.extending.register_jitable``). The increments are of the virtual controls, zero
        in this step.
    model : NamedTuple
        The numbers of the aircraft: floats, arrays and named tuples of them.
    state_count, control_count, parameter_count : int

    Returns
    -------
    callable
        ``step(states (runs, n), controls (runs, m), parameters (runs, p), wind (runs, 6), dt, substeps)`` to the
        states (runs, n) after `dt` seconds, by `substeps` steps of the classical Runge-Kutta method with controls
        and wind held, the quaternion renormalised at the end. Arrays are contiguous, of float64.
    """
    advance = compiled_virtual_step(rates, model, state_count, control_count, parameter_count)
    none = np.zeros((1, control_count))

    def step(states: Array, controls: Array, parameters: Array, wind: Array, dt: float, substeps: int) -> Array:
        return advance(states, controls, none, parameters, wind, dt, substeps)

    return step


def compiled_virtual_step(
    rates: Any, model: Any, state_count: int, control_count: int, parameter_count: int
) -> VirtualStep:
    """A compiled step under increments of the virtual controls; see :func:`compiled_step`.

    Returns
    -------
    callable
        ``step(states (runs, n), controls (runs, m), increments (runs or 1, m), parameters (runs, p), wind (runs, 6),
        dt, substeps)`` to the states (runs, n), the increments held.
    """
    kernel = _kernel(rates, state_count, control_count, parameter_count, _sources())
    columns = (state_count, control_count, parameter_count, 6)

    def step(
        states: Array, controls: Array, increments: Array, parameters: Array, wind: Array, dt: float, substeps: int
    ) -> Array:
        runs = len(states)
        shapes = (states.shape, controls.shape, parameters.shape, wind.shape)
        if shapes != tuple((runs, count) for count in columns) or substeps < 1:
            raise ValueError(
                f"a compiled step takes arrays of {runs} rows and {columns} columns and at least one substep; "
                f"it was given shapes {shapes} and {substeps} substeps"
            )
        if increments.shape not in ((runs, control_count), (1, control_count)):
            raise ValueError(f"a compiled step of {runs} rows was given increments of shape {increments.shape}")
        result = np.empty_like(states)
        kernel(model, states, controls, increments, parameters, wind, float(dt), substeps, result)
        return result

    return step


@cache
def _realise_kernel(realise: Any, sources: str) -> Any:
    @njit(cache=True, nogil=True)
    def controls(model: Any, states: Array, nominal: Array, increments: Array, result: Array) -> str:
        numbers = borrowed(model)
        for run in range(states.shape[0]):
            moved = realise(
                numbers,
                _components(states[run], 13),
                _components(nominal[run], 4),
                _components(increments[run], 4),
            )
            for i in range(4):
                result[run, i] = moved[i]
        return sources  # see `_kernel`

    return controls


def compiled_realise(realise: Any, model: Any) -> Realise:
    """Controls that give increments of the virtual controls, compiled.

    Parameters
    ----------
    realise : function
        ``realise(model, state, control, increment)``, tuples of components in and out, that numba can compile.
    model : NamedTuple
        The numbers it needs.

    Returns
    -------
    callable
        ``realise(states (runs, 13 or more), controls (runs, 4), increments (runs, 4))`` to controls (runs, 4), not yet
        clipped to their limits. Arrays are contiguous, of float64.
    """
    kernel = _realise_kernel(realise, _sources())

    def controls(states: Array, nominal: Array, increments: Array) -> Array:
        result = np.empty((len(states), 4))
        kernel(model, states, nominal, increments, result)
        return result

    return controls
