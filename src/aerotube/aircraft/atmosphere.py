"""The atmosphere of the flight-dynamics textbooks: density and speed of sound over altitude.

Reference: B. L. Stevens, F. L. Lewis, E. N. Johnson, *Aircraft Control and Simulation*, 3rd ed., appendix A
(subroutine ADC), which fits the US Standard Atmosphere of 1962.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import register_jitable

from aerotube.aircraft.units import FOOT, RANKINE, SLUG
from aerotube.numerics import select

_LAPSE = 0.703e-5 / FOOT  # 1/m, fall of temperature over that at sea level
_SEA_LEVEL_TEMPERATURE = 519.0 * RANKINE  # K
_STRATOSPHERE_TEMPERATURE = 390.0 * RANKINE  # K
_TROPOPAUSE = 35000.0 * FOOT  # m
_SEA_LEVEL_DENSITY = 0.002377 * SLUG / FOOT**3  # kg/m3
_DENSITY_EXPONENT = 4.14
_HEAT_RATIO_TIMES_GAS_CONSTANT = 1.4 * 1716.3 * FOOT**2 / RANKINE  # m2/(s2 K)


@register_jitable(forceinline=True)
def air_density(altitude: Any) -> Any:
    """Density (kg/m3) at an altitude (m)."""
    return _SEA_LEVEL_DENSITY * (1.0 - _LAPSE * altitude) ** _DENSITY_EXPONENT


@register_jitable(forceinline=True)
def speed_of_sound(altitude: Any) -> Any:
    """Speed of sound (m/s) at an altitude (m)."""
    temperature = select(
        altitude < _TROPOPAUSE,
        _SEA_LEVEL_TEMPERATURE * (1.0 - _LAPSE * altitude),
        _STRATOSPHERE_TEMPERATURE + 0.0 * altitude,
    )
    return np.sqrt(_HEAT_RATIO_TIMES_GAS_CONSTANT * temperature)
