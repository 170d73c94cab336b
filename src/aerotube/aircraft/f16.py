"""The low-fidelity F-16: the public wind-tunnel model of the flight-dynamics textbooks.

Elevator deflection is positive trailing edge down (nose down), aileron positive to roll left, rudder positive to
turn the nose left. Forces and moments are in body axes.

Uncertain quantities are ratios of true to nominal values: mass, inertia (all moments alike), lift, and what deflected
controls add to the coefficients. The parameters that stand for mass and inertia are the inverse ratios: the rates are
then affine in each parameter with the others held, so that any convex measure of them is largest at the corners of a
box of parameters. A Runge-Kutta step composes rates, and is so only nearly: measured along the manoeuvre of Table 2
at 50 ms, in the tracking metric and pointwise on the ellipsoid around its disturbances, parameters inside their box
exceed its corners by at most 4e-5 of the tube's size (inertia of plus or minus 20 percent; 9e-6 at 10 percent), and not
at all for the others, one at a time or all together.

References: L. T. Nguyen et al., NASA TP-1538, 1979; B. L. Stevens, F. L. Lewis, E. N. Johnson, *Aircraft Control
and Simulation*, 3rd ed., appendix A. The elevator's range is that of "Fast Tube-Based Robust Compensation Control
for Fixed-Wing UAVs"; the tables reach 25 degrees.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable
from numpy.typing import ArrayLike

from aerotube.aircraft.atmosphere import air_density, speed_of_sound
from aerotube.aircraft.base import (
    RIGID_BODY_STATES,
    RIGID_BODY_UNITS,
    STILL_AIR,
    Aircraft,
    Array,
    Components,
    Range,
    frozen,
    split,
)
from aerotube.aircraft.compiled import (
    Realise,
    Step,
    VirtualStep,
    compiled_realise,
    compiled_step,
    compiled_virtual_step,
)
from aerotube.aircraft.f16_aerodynamics import (
    CHORD,
    REFERENCE_CENTRE,
    SPAN,
    WING_AREA,
    AerodynamicTables,
    aerodynamic_tables,
    coefficients,
)
from aerotube.aircraft.f16_engine import (
    power_from_throttle,
    power_from_thrust,
    power_rate,
    throttle_from_power,
    thrust_from_power,
    thrust_levels,
    thrust_table,
)
from aerotube.aircraft.rigid_body import Inertia, flow_angles, rigid_body_rates
from aerotube.aircraft.units import FOOT, POUND_FORCE, SLUG
from aerotube.errors import InputError
from aerotube.numerics import Table2, select
from aerotube.numerics.tables import Interpolation

GRAVITY = 32.17 * FOOT  # m/s2, as the source rounds it
MASS = 20500.0 * POUND_FORCE / GRAVITY  # kg
INERTIA = Inertia(*(SLUG * FOOT**2 * np.array([9496.0, 55814.0, 63100.0, 982.0])).tolist())
ENGINE_MOMENTUM = 160.0 * SLUG * FOOT**2  # kg m2/s

#: Quantities that may be uncertain, and the parameters that stand for them.
UNCERTAIN = {
    "mass": "inverse_mass",
    "inertia": "inverse_inertia",
    "lift": "lift",
    "control_effectiveness": "control_effectiveness",
}


class Airframe(NamedTuple):
    """The numbers of one F-16, in a form that compiled code can take."""

    aerodynamics: AerodynamicTables
    thrust: Table2
    inertia: Inertia
    lever: float  # centre of gravity ahead of the tables' reference, over the chord
    engine_momentum: float  # kg m2/s


@register_jitable(forceinline=True)
def air_data(state: Components, wind: Components) -> Components:
    """Airspeed (m/s), angle of attack, sideslip (rad) and Mach number."""
    u, v, w = state[0] - wind[0], state[1] - wind[1], state[2] - wind[2]
    airspeed, attack, sideslip = flow_angles((u, v, w))
    return airspeed, attack, sideslip, airspeed / speed_of_sound(state[12])


@register_jitable(forceinline=True)
def airframe_rates(
    airframe: Airframe,
    state: Components,
    control: Components,
    inverse_mass: Any,
    wind: Components,
    air: Components,
    thrust: Any,
    inverse_inertia: Any = None,
    lift: Any = None,
    effectiveness: Any = None,
) -> Components:
    """Rates of the thirteen states at a thrust (N); `air` is what `air_data` gives; None is nominal."""
    airspeed, attack, sideslip, _mach = air
    rotation = (state[7] - wind[3], state[8] - wind[4], state[9] - wind[5])
    cx, cy, cz, cl, cm, cn = coefficients(
        airframe.aerodynamics,
        (airspeed, attack, sideslip),
        rotation,
        control,
        airframe.lever,
        lift,
        effectiveness,
    )
    force = (0.5 * WING_AREA) * (air_density(state[12]) * (airspeed * airspeed))
    per_mass = inverse_mass * (1.0 / MASS)
    acceleration = force * per_mass
    specific_force = (acceleration * cx + thrust * per_mass, acceleration * cy, acceleration * cz)
    if inverse_inertia is None:
        moment = (SPAN * force * cl, CHORD * force * cm, SPAN * force * cn)
        return rigid_body_rates(state, specific_force, moment, airframe.inertia, airframe.engine_momentum, GRAVITY)
    # what the inertia couples does not depend on its scale; moments and the engine's momentum are per inertia
    per_inertia = force * inverse_inertia
    moment = (SPAN * per_inertia * cl, CHORD * per_inertia * cm, SPAN * per_inertia * cn)
    momentum = airframe.engine_momentum * inverse_inertia
    return rigid_body_rates(state, specific_force, moment, airframe.inertia, momentum, GRAVITY)


@register_jitable(forceinline=True)
def settled_rates(
    airframe: Airframe,
    state: Components,
    control: Components,
    thrust_increment: Any,
    inverse_mass: Any,
    wind: Components,
    inverse_inertia: Any = None,
    lift: Any = None,
    effectiveness: Any = None,
) -> Components:
    """Rates of the thirteen states, the engine following its throttle at once."""
    air = air_data(state, wind)
    levels = thrust_levels(airframe.thrust, air[3], state[12])
    thrust = thrust_from_power(power_from_throttle(control[1]), levels) + thrust_increment
    return airframe_rates(
        airframe, state, control, inverse_mass, wind, air, thrust, inverse_inertia, lift, effectiveness
    )


@register_jitable(forceinline=True)
def lagging_rates(
    airframe: Airframe,
    state: Components,
    control: Components,
    inverse_mass: Any,
    wind: Components,
    inverse_inertia: Any = None,
    lift: Any = None,
    effectiveness: Any = None,
) -> Components:
    """Rates of the thirteen states and of the engine's power (percent), which lags behind its command."""
    u, v, w, q0, q1, q2, q3, p, q, r, north, east, altitude, power = state
    body = (u, v, w, q0, q1, q2, q3, p, q, r, north, east, altitude)
    air = air_data(body, wind)
    thrust = thrust_from_power(power, thrust_levels(airframe.thrust, air[3], altitude))
    rates = airframe_rates(
        airframe, body, control, inverse_mass, wind, air, thrust, inverse_inertia, lift, effectiveness
    )
    return (*rates, power_rate(power, power_from_throttle(control[1])))


@register_jitable(forceinline=True)
def moved_rates(
    airframe: Airframe,
    state: Components,
    control: Components,
    increment: Components,
    inverse_mass: Any,
    wind: Components,
    inverse_inertia: Any = None,
    lift: Any = None,
    effectiveness: Any = None,
) -> Components:
    """`settled_rates` under increments of elevator, thrust, aileron and rudder."""
    moved = (control[0] + increment[0], control[1], control[2] + increment[2], control[3] + increment[3])
    return settled_rates(airframe, state, moved, increment[1], inverse_mass, wind, inverse_inertia, lift, effectiveness)


# As compiled steps take them; with engine lag without increments, whose throttle would have to be found in every stage.


@register_jitable(forceinline=True)
def quick_step_rates(
    airframe: Airframe,
    state: Components,
    control: Components,
    increment: Components,
    parameters: Components,
    wind: Components,
) -> Components:
    """`moved_rates` as a compiled step takes them."""
    return moved_rates(airframe, state, control, increment, parameters[0], wind)


@register_jitable(forceinline=True)
def lagging_step_rates(
    airframe: Airframe,
    state: Components,
    control: Components,
    _increment: Components,
    parameters: Components,
    wind: Components,
) -> Components:
    """`lagging_rates` as a compiled step takes them."""
    return lagging_rates(airframe, state, control, parameters[0], wind)


@register_jitable(forceinline=True)
def quick_uncertain_rates(
    airframe: Airframe,
    state: Components,
    control: Components,
    increment: Components,
    parameters: Components,
    wind: Components,
) -> Components:
    """`moved_rates` with every parameter."""
    mass, inertia, lift, effectiveness = parameters
    return moved_rates(airframe, state, control, increment, mass, wind, inertia, lift, effectiveness)


@register_jitable(forceinline=True)
def lagging_uncertain_rates(
    airframe: Airframe,
    state: Components,
    control: Components,
    _increment: Components,
    parameters: Components,
    wind: Components,
) -> Components:
    """`lagging_rates` with every parameter."""
    mass, inertia, lift, effectiveness = parameters
    return lagging_rates(airframe, state, control, mass, wind, inertia, lift, effectiveness)


@register_jitable(forceinline=True)
def settled_throttle(levels: Components, nominal: Any, increment: Any) -> Any:
    """Throttle whose settled thrust is that of the nominal throttle plus an increment (N), 0 to 1."""
    thrust = thrust_from_power(power_from_throttle(nominal), levels) + increment
    power = power_from_thrust(thrust, levels)
    bounded = select(power < 0.0, 0.0 * power, select(power > 100.0, 0.0 * power + 100.0, power))
    return throttle_from_power(bounded)


@register_jitable(forceinline=True)
def realised_controls(thrust: Table2, state: Components, control: Components, increment: Components) -> Components:
    """Controls that give increments of elevator, thrust, aileron and rudder, as far as the throttle goes."""
    levels = thrust_levels(thrust, air_data(state, STILL_AIR)[3], state[12])
    throttle = settled_throttle(levels, control[1], increment[1])
    return (control[0] + increment[0], throttle, control[2] + increment[2], control[3] + increment[3])


class F16(Aircraft):
    """Low-fidelity F-16.

    Virtual controls: thrust (N) in place of throttle, an increment on the thrust that the nominal throttle gives
    at the actual state. Thrust has a kink in throttle at 0.77; the dynamics are affine in thrust.

    Parameters
    ----------
    xcg : float
        Centre of gravity as a fraction of the mean chord. The airframe is unstable aft of about 0.35.
    interpolation : {"linear", "smooth"}
        Reading of the tables: linear as published, or the natural quintic spline through the same nodes, which
        has the derivatives that expansions need.
    engine_momentum : float
        Angular momentum of the engine (kg m2/s); zero leaves the gyroscopic moment out.
    engine_lag : bool
        Append the engine's power (percent) to the states and let it lag behind the throttle. Thrust follows the
        throttle at once otherwise.
    uncertain : sequence of {"mass", "inertia", "lift", "control_effectiveness"}
        Quantities that have a parameter, see the module's text. The mass always has one, the first.

    Raises
    ------
    InputError
        If an option is out of range.
    """

    name = "f16"
    gravity = GRAVITY
    control_lower = frozen([-np.deg2rad(20.0), 0.0, -np.deg2rad(21.5), -np.deg2rad(30.0)])
    control_upper = frozen([np.deg2rad(20.0), 1.0, np.deg2rad(21.5), np.deg2rad(30.0)])

    domain = (
        Range("angle of attack", "deg", -10.0, 45.0),
        Range("sideslip", "deg", -30.0, 30.0),
        Range("Mach number", "", 0.0, 1.0),
        Range("altitude", "m", 0.0, 50000.0 * FOOT),
        Range("military less idle thrust", "N", 0.0, np.inf),
    )

    def __init__(
        self,
        xcg: float = 0.30,
        interpolation: Interpolation = "linear",
        engine_momentum: float = ENGINE_MOMENTUM,
        engine_lag: bool = False,
        uncertain: Sequence[str] = ("mass",),
    ) -> None:
        if not 0.0 <= xcg <= 1.0:
            raise InputError(f"xcg of the F-16 is {xcg}; give the fraction of the chord, between 0 and 1")
        if interpolation not in ("linear", "smooth"):
            raise InputError(f"interpolation of the F-16 is {interpolation!r}; choose 'linear' or 'smooth'")
        if not np.isfinite(engine_momentum):
            raise InputError(f"engine_momentum of the F-16 is {engine_momentum}; give it in kg m2/s, or 0")
        for quantity in uncertain:
            if quantity not in UNCERTAIN:
                raise InputError(f"the F-16 has no uncertain {quantity!r}; choose among {', '.join(UNCERTAIN)}")
        self.xcg = float(xcg)
        self.interpolation = interpolation
        self.engine_lag = bool(engine_lag)
        self.airframe = Airframe(
            aerodynamic_tables(interpolation),
            thrust_table(interpolation),
            INERTIA,
            REFERENCE_CENTRE - self.xcg,
            float(engine_momentum),
        )
        self.uncertain = tuple(name for name in UNCERTAIN if name == "mass" or name in uncertain)
        self.parameter_names = tuple(UNCERTAIN[name] for name in self.uncertain)
        self.parameter_nominal = frozen(np.ones(len(self.parameter_names)))
        if self.engine_lag:
            self.state_names = (*RIGID_BODY_STATES, "power")
            self.state_units = (*RIGID_BODY_UNITS, "percent")

    def __repr__(self) -> str:
        return (
            f"F16(xcg={self.xcg}, interpolation={self.interpolation!r}, "
            f"engine_momentum={self.airframe.engine_momentum:.6g}, engine_lag={self.engine_lag}, "
            f"uncertain={self.uncertain})"
        )

    @property
    def virtual_names(self) -> tuple[str, ...]:
        """Elevator, thrust, aileron, rudder."""
        return ("elevator", "thrust", "aileron", "rudder")

    @property
    def virtual_units(self) -> tuple[str, ...]:
        """Units of the virtual controls."""
        return ("rad", "N", "rad", "rad")

    def rates(
        self,
        state: Sequence[Any],
        control: Sequence[Any],
        parameters: Sequence[Any] | None = None,
        wind: Sequence[Any] | None = None,
    ) -> Components:
        """Time derivatives of the states; see `Aircraft.rates`."""
        x, a = tuple(state), tuple(control)
        inverse_mass, *others = self._parameters(parameters)
        air = STILL_AIR if wind is None else tuple(wind)
        if self.engine_lag:
            return lagging_rates(self.airframe, x, a, inverse_mass, air, *others)
        return settled_rates(self.airframe, x, a, 0.0, inverse_mass, air, *others)

    def rates_virtual(
        self,
        state: Sequence[Any],
        control: Sequence[Any],
        increment: Sequence[Any],
        parameters: Sequence[Any] | None = None,
        wind: Sequence[Any] | None = None,
    ) -> Components:
        """Time derivatives under increments of elevator (rad), thrust (N), aileron and rudder (rad).

        With engine lag the thrust increment is a command: the throttle moves to what would give it once settled.
        """
        x, a, d = tuple(state), tuple(control), tuple(increment)
        inverse_mass, *others = self._parameters(parameters)
        air = STILL_AIR if wind is None else tuple(wind)
        if not self.engine_lag:
            return moved_rates(self.airframe, x, a, d, inverse_mass, air, *others)
        throttle = settled_throttle(self._levels(x, air), a[1], d[1])
        moved = (a[0] + d[0], throttle, a[2] + d[2], a[3] + d[3])
        return lagging_rates(self.airframe, x, moved, inverse_mass, air, *others)

    def increment_limits(self, state: Sequence[Any], control: Sequence[Any]) -> tuple[Components, Components]:
        """Increments that the control limits leave; thrust from idle to maximum at each state's Mach and altitude."""
        (*lower,), (*upper,) = super().increment_limits(state, control)
        levels = self._levels(tuple(state), STILL_AIR)
        thrust = thrust_from_power(power_from_throttle(control[1]), levels)
        lower[1], upper[1] = levels[0] - thrust, levels[2] - thrust
        return tuple(lower), tuple(upper)

    def realise(self, state: ArrayLike, control: ArrayLike, increment: ArrayLike) -> Array:
        """Controls, within their limits, that give increments of elevator, thrust, aileron and rudder at a state."""
        x, a = self._checked(state, control)
        d = np.asarray(increment, dtype=np.float64)
        throttle = settled_throttle(self._levels(split(x), STILL_AIR), a[..., 1], d[..., 1])
        moved = np.broadcast_to(a + d, (*np.broadcast_shapes(a.shape[:-1], d.shape[:-1], throttle.shape), 4)).copy()
        moved[..., 1] = throttle
        return np.clip(moved, self.control_lower, self.control_upper)

    def settled(self, control: Sequence[Any]) -> Components:
        """Power (percent) at which the lagging engine rests; nothing without engine lag."""
        return (power_from_throttle(control[1]),) if self.engine_lag else ()

    def compiled_step(self) -> Step | None:
        """A step compiled to machine code, of this class's own equations; see `Aircraft.compiled_step`."""
        if type(self).rates is not F16.rates:
            return None
        plain = len(self.parameter_names) == 1
        rates: Any
        if self.engine_lag:
            rates = lagging_step_rates if plain else lagging_uncertain_rates
        else:
            rates = quick_step_rates if plain else quick_uncertain_rates
        every = compiled_step(rates, self.airframe, len(self.state_names), 4, 1 if plain else len(UNCERTAIN))
        if plain:
            return every

        def step(states: Array, controls: Array, parameters: Array, wind: Array, dt: float, substeps: int) -> Array:
            return every(states, controls, self._every_parameter(len(states), parameters), wind, dt, substeps)

        return step

    def compiled_virtual_step(self) -> VirtualStep | None:
        """The same under increments; None with engine lag. See `Aircraft.compiled_virtual_step`."""
        own = type(self).rates is F16.rates and type(self).rates_virtual is F16.rates_virtual
        if not own or self.engine_lag:
            return None
        states = len(self.state_names)
        if len(self.parameter_names) == 1:
            return compiled_virtual_step(quick_step_rates, self.airframe, states, 4, 1)
        every = compiled_virtual_step(quick_uncertain_rates, self.airframe, states, 4, len(UNCERTAIN))

        def step(
            states: Array, controls: Array, increments: Array, parameters: Array, wind: Array, dt: float, substeps: int
        ) -> Array:
            filled = self._every_parameter(len(states), parameters)
            return every(states, controls, increments, filled, wind, dt, substeps)

        return step

    def compiled_realise(self) -> Realise | None:
        """`realise` compiled, this class's own; see `Aircraft.compiled_realise`."""
        return (
            None if type(self).realise is not F16.realise else compiled_realise(realised_controls, self.airframe.thrust)
        )

    def domain_values(self, state: Sequence[Any]) -> Components:
        """Attack and sideslip (deg), Mach number, altitude (m), and by how much military thrust exceeds idle (N)."""
        x = tuple(state)
        _airspeed, attack, sideslip, mach = air_data(x, STILL_AIR)
        levels = thrust_levels(self.airframe.thrust, mach, x[12])
        return np.rad2deg(attack), np.rad2deg(sideslip), mach, x[12], levels[1] - levels[0]

    def _parameters(self, given: Sequence[Any] | None) -> Components:
        """Inverse mass, inverse inertia, lift and control effectiveness; None for one that is not uncertain."""
        if given is None:
            return (1.0, None, None, None)
        values = dict(zip(self.uncertain, given, strict=True))
        return tuple(values.get(name) for name in UNCERTAIN)

    def _every_parameter(self, rows: int, given: Array) -> Array:
        """Parameters (rows, 4) with one for what is not uncertain."""
        if given.shape != (rows, len(self.uncertain)):
            raise ValueError(f"a step with {len(self.uncertain)} parameters was given {given.shape} of them")
        filled = np.ones((rows, len(UNCERTAIN)))
        filled[:, [list(UNCERTAIN).index(name) for name in self.uncertain]] = given
        return filled

    def _levels(self, state: Components, wind: Components) -> Components:
        mach = air_data(state, wind)[3]
        return thrust_levels(self.airframe.thrust, mach, state[12])
