"""The F-16's engine: throttle to power to thrust, the way back, and the lag of power.

Power is in percent: 0 idle, 50 military, 100 maximum thrust. `levels` are the thrusts (N) at those three powers,
as `thrust_levels` reads them from the tables. Components in, components out; callable from compiled code.

Reference: B. L. Stevens, F. L. Lewis, E. N. Johnson, *Aircraft Control and Simulation*, 3rd ed., appendix A
(subroutines TGEAR, PDOT, RTAU, THRUST).
"""

from __future__ import annotations

from typing import Any

from numba.extending import register_jitable

from aerotube.aircraft import f16_tables as published
from aerotube.aircraft.units import FOOT, POUND_FORCE
from aerotube.numerics import Table2, entry, lookup2, select, table2
from aerotube.numerics.tables import Interpolation

Components = tuple[Any, ...]

_KINK = 0.77  # throttle beyond which the power command is steeper
_SLOPE = 64.94  # percent per unit of throttle
_SLOPE_BEYOND = 217.38
_OFFSET_BEYOND = -117.38
_POWER_AT_KINK = _SLOPE * _KINK


def thrust_table(interpolation: Interpolation) -> Table2:
    """Idle, military and maximum thrust (N) over Mach number and altitude (m)."""
    levels = [published.THRUST_IDLE, published.THRUST_MILITARY, published.THRUST_MAXIMUM]
    in_newtons = [POUND_FORCE * level for level in levels]
    return table2(published.MACH, FOOT * published.ALTITUDE, in_newtons, interpolation)


@register_jitable(forceinline=True)
def thrust_levels(table: Table2, mach: Any, altitude: Any) -> Components:
    """Idle, military and maximum thrust (N) at a Mach number and altitude (m)."""
    levels = lookup2(table, mach, altitude)
    return entry(levels, 0), entry(levels, 1), entry(levels, 2)


@register_jitable(forceinline=True)
def power_from_throttle(throttle: Any) -> Any:
    """Power (percent) that a throttle setting commands. It drops by 0.0012 past the kink, as published."""
    return select(throttle <= _KINK, _SLOPE * throttle, _SLOPE_BEYOND * throttle + _OFFSET_BEYOND)


@register_jitable(forceinline=True)
def throttle_from_power(power: Any) -> Any:
    """Throttle setting that commands a power (percent); the lesser where two do."""
    beyond = (power - _OFFSET_BEYOND) * (1.0 / _SLOPE_BEYOND)
    return select(power <= _POWER_AT_KINK, power * (1.0 / _SLOPE), beyond)


@register_jitable(forceinline=True)
def thrust_from_power(power: Any, levels: Components) -> Any:
    """Thrust (N) at a power (percent)."""
    idle, military, maximum = levels
    share = 0.02 * power
    below = idle + (military - idle) * share
    beyond = military + (maximum - military) * (share - 1.0)
    return select(power < 50.0, below, beyond)


@register_jitable(forceinline=True)
def power_from_thrust(thrust: Any, levels: Components) -> Any:
    """Power (percent) that gives a thrust (N); outside 0 to 100 where no throttle does."""
    idle, military, maximum = levels
    below = 50.0 * (thrust - idle) / (military - idle)
    beyond = 50.0 + 50.0 * (thrust - military) / (maximum - military)
    return select(thrust < military, below, beyond)


@register_jitable(forceinline=True)
def power_rate(power: Any, command: Any) -> Any:
    """Rate (percent/s) of the power of a lagging engine under a power command (percent)."""
    high, high_command = power >= 50.0, command >= 50.0
    target = select(high_command, select(high, command, 60.0), select(high, 40.0, command))
    gap = target - power
    slow = select(gap <= 25.0, 1.0, select(gap >= 50.0, 0.1, 1.9 - 0.036 * gap))
    return select(high, 5.0, slow) * gap
