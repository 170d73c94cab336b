"""What an aircraft is to the rest of the package."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerotube.aircraft.compiled import Realise, Step, VirtualStep
from aerotube.errors import InputError

Array = NDArray[np.float64]
Components = tuple[Any, ...]

RIGID_BODY_STATES = ("u", "v", "w", "q0", "q1", "q2", "q3", "p", "q", "r", "north", "east", "altitude")
RIGID_BODY_UNITS = ("m/s", "m/s", "m/s", "1", "1", "1", "1", "rad/s", "rad/s", "rad/s", "m", "m", "m")
CONTROLS = ("elevator", "throttle", "aileron", "rudder")

STILL_AIR = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def frozen(values: ArrayLike) -> Array:
    """The values as an array that cannot be changed in place, fit to be shared by all aircraft of a class."""
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


class Range(NamedTuple):
    """Bounds of a quantity within which an aircraft's model is backed by data, in the unit in which it is told."""

    quantity: str
    unit: str
    low: float
    high: float


class Aircraft(ABC):
    """An aircraft: names, units, ranges and equations of motion.

    A new aircraft is one file: a subclass that gives the names and limits as class or instance attributes and
    writes `rates` in plain NumPy, component by component, so that the same lines run on floats, arrays and
    Taylor polynomials (`aerotube.numerics.select` in place of ``if`` where a branch depends on a state).

    States are the thirteen of a rigid body (`RIGID_BODY_STATES`: velocity in body axes, unit quaternion from
    body to earth, body rates, position with altitude up), followed by those an aircraft may add. Everything is
    in SI units and radians; throttle runs from 0 to 1.

    Virtual controls are what a synthesis moves in place of the controls, so that the dynamics are close to
    affine in them: increments added to the nominal control, unless an aircraft says otherwise.
    """

    name: str
    state_names: tuple[str, ...] = RIGID_BODY_STATES
    state_units: tuple[str, ...] = RIGID_BODY_UNITS
    control_names: tuple[str, ...] = CONTROLS
    control_units: tuple[str, ...] = ("rad", "1", "rad", "rad")
    control_lower: Array
    control_upper: Array
    parameter_names: tuple[str, ...] = ("inverse_mass",)
    parameter_nominal: Array = frozen([1.0])
    domain: tuple[Range, ...] = ()
    gravity: float = 9.80665  # m/s2

    @property
    def virtual_names(self) -> tuple[str, ...]:
        """Names of the virtual controls."""
        return self.control_names

    @property
    def virtual_units(self) -> tuple[str, ...]:
        """Units of the virtual controls."""
        return self.control_units

    @abstractmethod
    def rates(
        self,
        state: Sequence[Any],
        control: Sequence[Any],
        parameters: Sequence[Any] | None = None,
        wind: Sequence[Any] | None = None,
    ) -> Components:
        """Time derivatives of the states.

        Parameters
        ----------
        state, control, parameters : sequences of components
            In the order of `state_names`, `control_names`, `parameter_names`; each component a float, an array
            or a Taylor polynomial. Nominal parameters if none are given.
        wind : sequence of 6 components, optional
            Velocity u, v, w (m/s) and rotation p, q, r (rad/s) of the air relative to the earth, body axes. It
            enters the aerodynamics only. Still air if not given.

        Returns
        -------
        tuple of components
            In the order of `state_names`.
        """

    def rates_virtual(
        self,
        state: Sequence[Any],
        control: Sequence[Any],
        increment: Sequence[Any],
        parameters: Sequence[Any] | None = None,
        wind: Sequence[Any] | None = None,
    ) -> Components:
        """Time derivatives of the states under a nominal control and an increment of the virtual controls.

        Parameters
        ----------
        increment : sequence of components
            In the order of `virtual_names`; the other arguments are those of `rates`.
        """
        moved = tuple(nominal + change for nominal, change in zip(control, increment, strict=True))
        return self.rates(state, moved, parameters, wind)

    def increment_limits(self, state: Sequence[Any], control: Sequence[Any]) -> tuple[Components, Components]:
        """Component-wise :meth:`virtual_limits`: what :meth:`realise` allows at a state around a nominal control.

        Parameters
        ----------
        state, control : sequences of components
            Each a float, an array or a Taylor model.

        Returns
        -------
        lower, upper : tuple of components
            Least and largest increment of each virtual control.
        """
        span = tuple(zip(control, self.control_lower, self.control_upper, strict=True))
        return tuple(low - a for a, low, _ in span), tuple(high - a for a, _, high in span)

    def virtual_limits(self, state: ArrayLike, control: ArrayLike) -> tuple[Array, Array]:
        """Increments of the virtual controls that the control limits leave around a nominal control.

        Parameters
        ----------
        state : array (..., n)
        control : array (..., m)
            The nominal control, within its limits.

        Returns
        -------
        lower, upper : array (..., m)
            ``lower <= 0 <= upper``.
        """
        x, a = self._checked(state, control)
        lower, upper = self.increment_limits(split(x), split(a))
        low, high = (np.stack(np.broadcast_arrays(*parts), axis=-1) for parts in (lower, upper))
        return np.minimum(low, 0.0), np.maximum(high, 0.0)

    def realise(self, state: ArrayLike, control: ArrayLike, increment: ArrayLike) -> Array:
        """Controls, within their limits, that give an increment of the virtual controls at a state.

        Parameters
        ----------
        state : array (..., n)
        control : array (..., m)
            The nominal control.
        increment : array (..., m)
            Of the virtual controls; what the limits do not allow is cut off.

        Returns
        -------
        array (..., m)
        """
        _, control = self._checked(state, control)
        moved = control + np.asarray(increment, dtype=np.float64)
        return np.clip(moved, self.control_lower, self.control_upper)

    def settled(self, control: Sequence[Any]) -> Components:
        """Values at which the states beyond the thirteen rest under a control; none unless an aircraft adds some."""
        return ()

    def compiled_step(self) -> Step | None:
        """A step compiled to machine code, for real-time use; None where an aircraft has none.

        Returns
        -------
        callable or None
            ``step(states (runs, n), controls (runs, m), parameters (runs, p), wind (runs, 6), dt, substeps)`` to
            states (runs, n); see `aerotube.aircraft.compiled.compiled_step`, which makes it.
        """
        return None

    def compiled_virtual_step(self) -> VirtualStep | None:
        """The same under increments of the virtual controls, of `rates_virtual`; None where an aircraft has none.

        Returns
        -------
        callable or None
            See `aerotube.aircraft.compiled.compiled_virtual_step`, which makes it.
        """
        return None

    def compiled_realise(self) -> Realise | None:
        """`realise` for rows of states, compiled, without the clipping; None where an aircraft has none.

        Returns
        -------
        callable or None
            See `aerotube.aircraft.compiled.compiled_realise`, which makes it.
        """
        return None

    def domain_values(self, state: Sequence[Any]) -> Components:
        """The quantities that `domain` bounds, in its order and units, from the components of states."""
        return ()

    def in_domain(self, state: ArrayLike) -> NDArray[np.bool_]:
        """Where the model is backed by data.

        Parameters
        ----------
        state : array (..., n)

        Returns
        -------
        array of bool (...)
            False wherever a state is outside the range of the model's tables, or not finite.
        """
        x = components_last(state, self.state_names, "state", self.name)
        inside = np.isfinite(x).all(axis=-1)
        with np.errstate(invalid="ignore", divide="ignore"):
            for bounds, value in zip(self.domain, self.domain_values(split(x)), strict=True):
                inside = inside & (bounds.low <= value) & (value <= bounds.high)
        return np.asarray(inside)

    def domain_violation(self, state: ArrayLike) -> str | None:
        """The first departure from the model's range among states (..., n), as a sentence; None if there is none."""
        x = components_last(state, self.state_names, "state", self.name)
        inside = self.in_domain(x)
        if inside.all():
            return None
        index = tuple(int(i) for i in np.argwhere(~inside)[0])
        where = f" (state {', '.join(map(str, index))})" if index else ""
        worst = x[index]
        for name, value in zip(self.state_names, worst, strict=True):
            if not np.isfinite(value):
                return f"{name} is {value}{where}: the state of the aircraft {self.name} is not finite"
        with np.errstate(invalid="ignore", divide="ignore"):
            values = self.domain_values(split(worst))
        for bounds, value in zip(self.domain, values, strict=True):
            if not bounds.low <= value <= bounds.high:
                unit = f" {bounds.unit}" if bounds.unit else ""
                return (
                    f"{bounds.quantity} is {float(value):.6g}{unit}{where}, outside the range "
                    f"{bounds.low:.6g} to {bounds.high:.6g}{unit} of the model of the aircraft {self.name}"
                )
        return None

    def _checked(self, state: ArrayLike, control: ArrayLike) -> tuple[Array, Array]:
        return (
            components_last(state, self.state_names, "state", self.name),
            components_last(control, self.control_names, "control", self.name),
        )


def state_derivatives(
    aircraft: Aircraft,
    state: ArrayLike,
    control: ArrayLike,
    parameters: ArrayLike | None = None,
    wind: ArrayLike | None = None,
) -> Array:
    """Time derivatives of states, in SI units.

    Parameters
    ----------
    aircraft : Aircraft
    state : array (..., n)
        In the order of ``aircraft.state_names``; n is 13 for a rigid body.
    control : array (..., m)
        In the order of ``aircraft.control_names``.
    parameters : array (..., p), optional
        In the order of ``aircraft.parameter_names``; nominal if not given.
    wind : array (..., 6), optional
        Velocity (m/s) and rotation (rad/s) of the air relative to the earth in body axes; still air if not given.

    Returns
    -------
    array (..., n)
        Of the broadcast batch shape.

    Raises
    ------
    InputError
        If the last axis of an argument has the wrong length.
    """
    x, a = aircraft._checked(state, control)
    nominal = aircraft.parameter_nominal if parameters is None else parameters
    sigma = components_last(nominal, aircraft.parameter_names, "parameters", aircraft.name)
    air = components_last(STILL_AIR if wind is None else wind, STILL_AIR, "wind", aircraft.name)
    rates = aircraft.rates(split(x), split(a), split(sigma), split(air))
    return np.stack(np.broadcast_arrays(*rates), axis=-1)


def components_last(values: ArrayLike, names: Sequence[Any], what: str, aircraft: str) -> Array:
    """The values as an array whose last axis has one component a name; InputError if it has not."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != len(names):
        raise InputError(
            f"{what} of the aircraft {aircraft} has shape {array.shape}; "
            f"its last axis must have {len(names)} components"
        )
    return array


def split(array: Array) -> Components:
    """The components along the last axis, each contiguous."""
    if array.ndim == 1:
        return tuple(array.tolist())
    return tuple(np.ascontiguousarray(array[..., i]) for i in range(array.shape[-1]))
