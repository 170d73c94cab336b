"""Motion of a rigid aircraft over a flat earth, with a quaternion for its attitude.

The equations are Eq. 15 to 17 of the first reference, the quaternion numbered q0 to q3 throughout. Components in,
components out: floats, arrays and Taylor polynomials alike, and callable from compiled code.

References: "Fast Tube-Based Robust Compensation Control for Fixed-Wing UAVs"; B. L. Stevens, F. L. Lewis, E. N.
Johnson, *Aircraft Control and Simulation*, 3rd ed., section 1.7.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from aerotube.numerics import body_to_earth, quaternion_rates

Components = tuple[Any, ...]


class Inertia(NamedTuple):
    """Moments and product of inertia (kg m2) of an aircraft symmetric about its x-z plane."""

    xx: float
    yy: float
    zz: float
    xz: float


@register_jitable(forceinline=True)
def flow_angles(velocity: Components) -> Components:
    """Airspeed (m/s), angle of attack and sideslip (rad) of an air-relative velocity in body axes (Eq. 17)."""
    u, v, w = velocity
    airspeed = np.sqrt(u * u + v * v + w * w)
    return airspeed, np.arctan2(w, u), np.arcsin(v / airspeed)


@register_jitable(forceinline=True)
def velocity_from_flow(airspeed: Any, attack: Any, sideslip: Any) -> Components:
    """Body-axis velocity (m/s) of an airspeed (m/s), angle of attack and sideslip (rad)."""
    forward = airspeed * np.cos(sideslip)
    return forward * np.cos(attack), airspeed * np.sin(sideslip), forward * np.sin(attack)


@register_jitable(forceinline=True)
def rigid_body_rates(
    state: Components,
    specific_force: Components,
    moment: Components,
    inertia: Inertia,
    angular_momentum: Any,
    gravity: float,
) -> Components:
    """Rates of the thirteen states.

    Parameters
    ----------
    state : 13 components
        u, v, w (m/s), q0 .. q3, p, q, r (rad/s), north, east, altitude (m).
    specific_force : 3 components
        Force other than weight over mass, body axes (m/s2).
    moment : 3 components
        About the centre of gravity, body axes (N m).
    inertia : Inertia
    angular_momentum : float
        Of the rotating parts of the engine, along the body x axis (kg m2/s).
    gravity : float
        Acceleration of gravity (m/s2).

    Returns
    -------
    tuple of 13 components
        Time derivatives in the order of the states.
    """
    u, v, w, q0, q1, q2, q3, p, q, r, _north, _east, _altitude = state
    fx, fy, fz = specific_force
    rolling, pitching, yawing = moment
    u_rate = r * v - q * w + fx + (2.0 * gravity) * (q1 * q3 - q0 * q2)
    v_rate = p * w - r * u + fy + (2.0 * gravity) * (q2 * q3 + q0 * q1)
    w_rate = q * u - p * v + fz + gravity * (q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3)

    pq, qr = p * q, q * r
    about_x = rolling + (inertia.yy - inertia.zz) * qr + inertia.xz * pq
    about_y = pitching + (inertia.zz - inertia.xx) * (r * p) - inertia.xz * (p * p - r * r)
    about_z = yawing + (inertia.xx - inertia.yy) * pq - inertia.xz * qr
    about_y = about_y - angular_momentum * r
    about_z = about_z + angular_momentum * q
    determinant = inertia.xx * inertia.zz - inertia.xz * inertia.xz
    p_rate = (inertia.zz / determinant) * about_x + (inertia.xz / determinant) * about_z
    q_rate = (1.0 / inertia.yy) * about_y
    r_rate = (inertia.xz / determinant) * about_x + (inertia.xx / determinant) * about_z

    quaternion = (q0, q1, q2, q3)
    north_rate, east_rate, down_rate = body_to_earth(quaternion, (u, v, w))
    q0_rate, q1_rate, q2_rate, q3_rate = quaternion_rates(quaternion, (p, q, r))
    return (
        u_rate,
        v_rate,
        w_rate,
        q0_rate,
        q1_rate,
        q2_rate,
        q3_rate,
        p_rate,
        q_rate,
        r_rate,
        north_rate,
        east_rate,
        -down_rate,
    )
