"""The F-16's aerodynamic coefficients from the published tables.

Tables are kept per radian and over radians. The static rolling and yawing moment are odd in sideslip: they are
tabulated for positive sideslip, and mirrored here through zero, which leaves the linear reading as published and
makes the smooth one smooth across zero.

References: NASA TP-1538; B. L. Stevens, F. L. Lewis, E. N. Johnson, *Aircraft Control and Simulation*, 3rd ed.,
appendix A.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from aerotube.aircraft import f16_tables as published
from aerotube.numerics import Table1, Table2, entry, lookup1, lookup2, stack2, table1, table2
from aerotube.numerics.tables import Interpolation

Components = tuple[Any, ...]

CHORD = 11.32 * 0.3048  # m
SPAN = 30.0 * 0.3048  # m
WING_AREA = 300.0 * 0.3048**2  # m2
REFERENCE_CENTRE = 0.35  # of the chord: where the tables take their moments

_FULL_AILERON = np.deg2rad(20.0)
_FULL_RUDDER = np.deg2rad(30.0)
_CY_SIDESLIP = -0.02 * 180.0 / np.pi  # 1/rad
_CY_AILERON = 0.021 / _FULL_AILERON
_CY_RUDDER = 0.086 / _FULL_RUDDER
_CZ_ELEVATOR = -0.19 / np.deg2rad(25.0)
_CZ_SIDESLIP = (180.0 / np.pi / 57.3) ** 2  # 1/rad2, a radian rounded to 57.3 degrees in the source


class AerodynamicTables(NamedTuple):
    """The tables, stacked by what they depend on."""

    attack: Table1  # static normal force, then nine damping derivatives
    elevator_attack: Table2  # axial force, pitching moment
    sideslip_attack: Table2  # rolling and yawing moment: static, per aileron, per rudder (1/rad)


def aerodynamic_tables(interpolation: Interpolation) -> AerodynamicTables:
    """The published tables over radians, in the order in which `coefficients` reads them."""
    attack, elevator = np.deg2rad(published.ATTACK), np.deg2rad(published.ELEVATOR)
    one_sided, sideslip = np.deg2rad(published.ABSOLUTE_SIDESLIP), np.deg2rad(published.SIDESLIP)
    by_attack = [
        published.CZ,
        published.CX_Q,
        published.CZ_Q,
        published.CM_Q,
        published.CY_R,
        published.CY_P,
        published.CL_ROLL_R,
        published.CL_ROLL_P,
        published.CN_R,
        published.CN_P,
    ]
    static = np.stack([published.CL_ROLL, published.CN])
    mirrored = np.concatenate([-static[:, :0:-1], static], axis=1)
    per_control = [
        published.CL_ROLL_AILERON / _FULL_AILERON,
        published.CL_ROLL_RUDDER / _FULL_RUDDER,
        published.CN_AILERON / _FULL_AILERON,
        published.CN_RUDDER / _FULL_RUDDER,
    ]
    return AerodynamicTables(
        table1(attack, by_attack, interpolation),
        table2(elevator, attack, [published.CX, published.CM], interpolation),
        stack2(
            [
                table2(np.append(-one_sided[:0:-1], one_sided), attack, mirrored, interpolation),
                table2(sideslip, attack, per_control, interpolation),
            ]
        ),
    )


@register_jitable(forceinline=True)
def coefficients(
    tables: AerodynamicTables,
    flow: Components,
    rotation: Components,
    control: Components,
    lever: float,
    lift: Any = None,
    effectiveness: Any = None,
) -> Components:
    """Force and moment coefficients in body axes.

    Parameters
    ----------
    tables : AerodynamicTables
    flow : 3 components
        Airspeed (m/s), angle of attack and sideslip (rad).
    rotation : 3 components
        Body rates relative to the air (rad/s).
    control : 4 components
        Elevator (rad, positive nose down), throttle (not used), aileron (rad, positive rolls left), rudder
        (rad, positive turns left).
    lever : float
        Distance by which the centre of gravity is ahead of that of the tables, over the chord.
    lift : float, optional
        Ratio of the lift to the published one; it acts at the tables' reference, across the air's direction.
    effectiveness : float, optional
        Ratio of what the deflected surfaces add to the coefficients to what the tables say they add.

    Returns
    -------
    tuple of 6 components
        CX, CY, CZ, Cl, Cm, Cn.
    """
    airspeed, attack, sideslip = flow
    p, q, r = rotation
    elevator, _throttle, aileron, rudder = control
    half_time = 0.5 / airspeed
    roll, pitch, yaw = (SPAN * half_time) * p, (CHORD * half_time) * q, (SPAN * half_time) * r

    by_attack = lookup1(tables.attack, attack)
    by_elevator = lookup2(tables.elevator_attack, elevator, attack)
    axial, pitching = entry(by_elevator, 0), entry(by_elevator, 1)
    if effectiveness is not None:
        neutral = lookup2(tables.elevator_attack, 0.0 * elevator, attack)
        axial = entry(neutral, 0) + effectiveness * (axial - entry(neutral, 0))
        pitching = entry(neutral, 1) + effectiveness * (pitching - entry(neutral, 1))
        elevator, aileron, rudder = effectiveness * elevator, effectiveness * aileron, effectiveness * rudder
    by_sideslip = lookup2(tables.sideslip_attack, sideslip, attack)
    static_cz, cx_q, cz_q, cm_q = entry(by_attack, 0), entry(by_attack, 1), entry(by_attack, 2), entry(by_attack, 3)
    cy_r, cy_p, cl_r = entry(by_attack, 4), entry(by_attack, 5), entry(by_attack, 6)
    cl_p, cn_r, cn_p = entry(by_attack, 7), entry(by_attack, 8), entry(by_attack, 9)

    cx = axial + cx_q * pitch
    cy = _CY_SIDESLIP * sideslip + _CY_AILERON * aileron + _CY_RUDDER * rudder + cy_r * yaw + cy_p * roll
    cz = static_cz * (1.0 - _CZ_SIDESLIP * (sideslip * sideslip)) + _CZ_ELEVATOR * elevator + cz_q * pitch
    if lift is not None:
        sine, cosine = np.sin(attack), np.cos(attack)
        added = (lift - 1.0) * (cx * sine - cz * cosine)
        cx, cz = cx + added * sine, cz - added * cosine
    cl = (
        entry(by_sideslip, 0)
        + entry(by_sideslip, 2) * aileron
        + entry(by_sideslip, 3) * rudder
        + cl_r * yaw
        + cl_p * roll
    )
    cm = pitching + cm_q * pitch + lever * cz
    cn = (
        entry(by_sideslip, 1)
        + entry(by_sideslip, 4) * aileron
        + entry(by_sideslip, 5) * rudder
        + cn_r * yaw
        + cn_p * roll
    )
    return cx, cy, cz, cl, cm, cn - (lever * CHORD / SPAN) * cy
