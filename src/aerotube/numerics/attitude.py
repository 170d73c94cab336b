"""Unit quaternions and Euler angles, component by component.

A quaternion ``(q0, q1, q2, q3)`` has its scalar first and turns body axes into earth axes (north, east,
down). Every function takes and returns tuples of components, each a float, an array or a Taylor polynomial,
and can be called from compiled code. Euler angles are those of the sequence yaw, pitch, roll (3-2-1), in rad.

Reference: B. L. Stevens, F. L. Lewis, E. N. Johnson, *Aircraft Control and Simulation*, 3rd ed., section 1.3.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import register_jitable

Components = tuple[Any, ...]


@register_jitable(forceinline=True)
def quaternion_from_euler(roll: Any, pitch: Any, yaw: Any) -> Components:
    """Quaternion of a roll, pitch and yaw angle (rad)."""
    cr, sr = np.cos(0.5 * roll), np.sin(0.5 * roll)
    cp, sp = np.cos(0.5 * pitch), np.sin(0.5 * pitch)
    cy, sy = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


@register_jitable(forceinline=True)
def wrap_angle(angle: Any) -> Any:
    """The angle (rad) less the whole turns that bring it into [-pi, pi]."""
    return angle - 2.0 * np.pi * np.rint(angle / (2.0 * np.pi))


@register_jitable(forceinline=True)
def euler_from_quaternion(quaternion: Components) -> Components:
    """Roll, pitch and yaw angle (rad) of a quaternion of any non-zero length.

    Roll and yaw lie in [-pi, pi], pitch in [-pi/2, pi/2]. The half sum and half difference of yaw and roll
    are taken, each from its own pair of components, so that the three angles describe the attitude to
    rounding at any pitch, straight up and down included. (Derivatives do not exist exactly there.)
    """
    q0, q1, q2, q3 = quaternion
    # with c, s the cosine and sine of half the pitch:
    #   q0 + q2 = (c + s) cos((yaw - roll)/2),   q3 - q1 = (c + s) sin((yaw - roll)/2)
    #   q0 - q2 = (c - s) cos((yaw + roll)/2),   q3 + q1 = (c - s) sin((yaw + roll)/2)
    a, b, c, d = q0 + q2, q3 - q1, q0 - q2, q3 + q1
    half_difference = np.arctan2(b, a)
    half_sum = np.arctan2(d, c)
    pitch = 2.0 * np.arctan2(np.sqrt(a * a + b * b), np.sqrt(c * c + d * d)) - 0.5 * np.pi
    return wrap_angle(half_sum - half_difference), pitch, wrap_angle(half_sum + half_difference)


@register_jitable(forceinline=True)
def quaternion_product(first: Components, second: Components) -> Components:
    """Product: the rotation `second` (inner axes) followed by `first` (outer axes)."""
    a0, a1, a2, a3 = first
    b0, b1, b2, b3 = second
    return (
        a0 * b0 - a1 * b1 - a2 * b2 - a3 * b3,
        a0 * b1 + a1 * b0 + a2 * b3 - a3 * b2,
        a0 * b2 - a1 * b3 + a2 * b0 + a3 * b1,
        a0 * b3 + a1 * b2 - a2 * b1 + a3 * b0,
    )


@register_jitable(forceinline=True)
def quaternion_conjugate(quaternion: Components) -> Components:
    """Conjugate: the inverse rotation of a unit quaternion."""
    q0, q1, q2, q3 = quaternion
    return q0, -q1, -q2, -q3


@register_jitable(forceinline=True)
def normalise(quaternion: Components) -> Components:
    """The quaternion divided by its length."""
    q0, q1, q2, q3 = quaternion
    scale = 1.0 / np.sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
    return q0 * scale, q1 * scale, q2 * scale, q3 * scale


@register_jitable(forceinline=True)
def body_to_earth(quaternion: Components, vector: Components) -> Components:
    """North, east and down components of a vector given in body axes."""
    q0, q1, q2, q3 = quaternion
    x, y, z = vector
    # v + 2 q0 (q x v) + 2 q x (q x v): fewer products than the rotation matrix
    cx, cy, cz = 2.0 * (q2 * z - q3 * y), 2.0 * (q3 * x - q1 * z), 2.0 * (q1 * y - q2 * x)
    return (
        x + q0 * cx + q2 * cz - q3 * cy,
        y + q0 * cy + q3 * cx - q1 * cz,
        z + q0 * cz + q1 * cy - q2 * cx,
    )


@register_jitable(forceinline=True)
def earth_to_body(quaternion: Components, vector: Components) -> Components:
    """Body components of a vector given by its north, east and down components."""
    return body_to_earth(quaternion_conjugate(quaternion), vector)


@register_jitable(forceinline=True)
def quaternion_rates(quaternion: Components, rotation: Components) -> Components:
    """Time derivative (1/s) of a quaternion that turns at the body rates p, q, r (rad/s)."""
    q0, q1, q2, q3 = quaternion
    p, q, r = 0.5 * rotation[0], 0.5 * rotation[1], 0.5 * rotation[2]
    return (
        -p * q1 - q * q2 - r * q3,
        p * q0 + r * q2 - q * q3,
        q * q0 - r * q1 + p * q3,
        r * q0 + q * q1 - p * q2,
    )
