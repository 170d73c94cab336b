r"""Error coordinates: eight numbers that say how far a state is from the nominal.

The error state is ``[V, alpha, q, theta, beta, p, r, phi]``: differences of airspeed, flow angles and body
rates, and two numbers for the attitude. Heading and position do not enter the dynamics (altitude does, through
the density, and is carried along by the simulation), so two numbers suffice: they say where *down* points in
body axes.

``relative``
    The rotation that turns the nominal down direction :math:`\bar g` into the actual one :math:`g`, by the
    shortest way, as a Rodrigues vector resolved about the nominal pitch axis (``theta``) and the nominal
    horizontal roll axis (``phi``):

    .. math:: x_\theta = \frac{2\, g \cdot e_\theta}{1 + g \cdot \bar g}, \qquad
              x_\phi = \frac{2\, g \cdot e_\phi}{1 + g \cdot \bar g},

    with :math:`e_\phi = (0, \cos\bar\phi, -\sin\bar\phi)` and :math:`e_\theta = \bar g \times e_\phi`. Regular
    at any pitch, and up to a tilt of 180 degrees. To first order it is ``(dtheta, cos(theta) dphi)``.

``euler``
    The paper's differences of pitch and roll angle, wrapped; singular at 90 degrees of pitch.

All functions come twice: on arrays, batch first, and component-wise, where a component is a float, an array or
a Taylor polynomial.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.rigid_body import flow_angles, velocity_from_flow
from aerotube.dynamics.components import Components, join, split
from aerotube.dynamics.error_kernels import largest_tilts, moved_each
from aerotube.errors import InputError
from aerotube.numerics import attitude

ERROR_NAMES = ("V", "alpha", "q", "theta", "beta", "p", "r", "phi")
ERROR_UNITS = ("m/s", "rad", "rad/s", "rad", "rad", "rad/s", "rad/s", "rad")
LONGITUDINAL = (0, 1, 2, 3)
LATERAL = (4, 5, 6, 7)

Array = NDArray[np.float64]
Kind = Literal["relative", "euler"]


@dataclass(frozen=True)
class ErrorCoordinates:
    """A chart of the states around a nominal one.

    Parameters
    ----------
    kind : {"relative", "euler"}
        How the attitude error is measured; see the module's text.

    Raises
    ------
    InputError
        For any other kind.
    """

    kind: Kind = "relative"

    def __post_init__(self) -> None:
        if self.kind not in ("relative", "euler"):
            raise InputError(
                f"attitude error: unknown kind {self.kind!r}; choose 'relative' (regular at any pitch) or "
                "'euler' (the paper's angle differences)."
            )

    def retract(self, nominal: Array, error: Array) -> Array:
        """State at an error from the nominal.

        Parameters
        ----------
        nominal : ndarray (..., 13 or more)
            Nominal full states; heading, position and further states are taken over.
        error : ndarray (..., 8)
            Errors, SI and radians; batch axes broadcast with the nominal's.

        Returns
        -------
        ndarray (..., 13 or more)
        """
        return join(self.retract_components(split(nominal), split(error)))

    def retract_each(self, nominal: Array, error: Array) -> Array:
        """States (b, u, n) at errors (b, u, 8) from nominal ones (b, n): :meth:`retract`, compiled where it can be."""
        if self.kind == "relative":
            return np.asarray(moved_each(nominal, error))
        return self.retract(nominal[:, None], error)

    def difference(self, state: Array, nominal: Array) -> Array:
        """Error of a state from the nominal: the inverse of :meth:`retract`.

        Parameters
        ----------
        state, nominal : ndarray (..., 13 or more)
            Full states; batch axes broadcast.

        Returns
        -------
        ndarray (..., 8)
        """
        return join(self.difference_components(split(state), split(nominal)))

    def retract_components(self, nominal: Sequence[Any], error: Sequence[Any]) -> Components:
        """Component-wise :meth:`retract`: 13 or more components and 8 components in, 13 or more out."""
        speed, alpha, beta = flow_angles(tuple(nominal[:3]))
        velocity = velocity_from_flow(speed + error[0], alpha + error[1], beta + error[4])
        if self.kind == "relative":
            _, e_theta, e_phi = _tilt_axes(nominal[3:7])
            half_theta, half_phi = 0.5 * error[3], 0.5 * error[7]
            turn = tuple(half_theta * e_phi[i] - half_phi * e_theta[i] for i in range(3))
            scale = 1.0 / np.sqrt(1.0 + half_theta * half_theta + half_phi * half_phi)
            quaternion = attitude.quaternion_product(tuple(nominal[3:7]), (scale, *(scale * part for part in turn)))
        else:
            roll, pitch, yaw = attitude.euler_from_quaternion(tuple(nominal[3:7]))
            quaternion = attitude.quaternion_from_euler(roll + error[7], pitch + error[3], yaw)
        rates = (nominal[7] + error[5], nominal[8] + error[2], nominal[9] + error[6])
        return (*velocity, *quaternion, *rates, *nominal[10:])

    def difference_components(self, state: Sequence[Any], nominal: Sequence[Any]) -> Components:
        """Component-wise :meth:`difference`: twice 13 or more components in, 8 out."""
        speed, alpha, beta = flow_angles(tuple(state[:3]))
        speed_n, alpha_n, beta_n = flow_angles(tuple(nominal[:3]))
        down = _down(state[3:7])
        if self.kind == "relative":
            down_n, e_theta, e_phi = _tilt_axes(nominal[3:7])
            scale = 2.0 / (1.0 + _dot(down, down_n))
            theta, phi = scale * _dot(down, e_theta), scale * _dot(down, e_phi)
        else:
            down_n = _down(nominal[3:7])
            theta = _pitch(down) - _pitch(down_n)
            phi = np.arctan2(down[1] * down_n[2] - down[2] * down_n[1], down[1] * down_n[1] + down[2] * down_n[2])
        return (
            speed - speed_n,
            alpha - alpha_n,
            state[8] - nominal[8],
            theta,
            beta - beta_n,
            state[7] - nominal[7],
            state[9] - nominal[9],
            phi,
        )

    def box(self, nominal: Array, half_widths: Array) -> Array:
        """Half-widths, in these coordinates, of a box that holds a box of Euler differences.

        Parameters
        ----------
        nominal : ndarray (..., 13 or more)
            Nominal states.
        half_widths : ndarray (8,)
            Half-widths of the differences ``[V, alpha, q, theta, beta, p, r, phi]``, SI and radians.

        Returns
        -------
        ndarray (..., 8)
            Only ``theta`` and ``phi`` change: they hold the image of the whole rectangle of angle differences,
            found on a fine grid of its edges (the image of the inside lies inside the image of the edges), and
            are never less than a tenth of the given width, so that they stay usable where the nominal stands
            on its nose and a roll difference is no tilt at all.
        """
        nominal = np.asarray(nominal, dtype=float)
        widths = np.broadcast_to(half_widths, (*nominal.shape[:-1], 8)).copy()
        if self.kind == "euler":
            return widths
        side = np.linspace(-1.0, 1.0, 33)
        one = np.ones_like(side)
        edge = np.concatenate([np.stack([side, one], -1), np.stack([one, side], -1)])
        edge = np.concatenate([edge, -edge])
        roll, pitch, yaw = attitude.euler_from_quaternion(split(nominal[..., 3:7]))
        quaternion = attitude.quaternion_from_euler(
            np.expand_dims(roll, -1) + half_widths[7] * edge[:, 1],
            np.expand_dims(pitch, -1) + half_widths[3] * edge[:, 0],
            np.expand_dims(yaw, -1),
        )
        turns = np.ascontiguousarray(np.stack(np.broadcast_arrays(*quaternion), axis=-1))
        largest = np.empty((*nominal.shape[:-1], 2))
        flat = np.ascontiguousarray(nominal.reshape(-1, nominal.shape[-1]))
        largest_tilts(flat, turns.reshape(len(flat), -1, 4), largest.reshape(-1, 2))
        for column, i in enumerate((3, 7)):
            widths[..., i] = np.maximum(largest[..., column] * (1 + 1e-3), 0.1 * half_widths[i])
        return widths


def euler_error(state: Array, nominal: Array) -> Array:
    """Differences of the paper (its Eq. 2 and 18): Euler angles subtracted, wrapped.

    Parameters
    ----------
    state, nominal : ndarray (..., 13 or more)
        Full states; batch axes broadcast.

    Returns
    -------
    ndarray (..., 8)
        ``[V, alpha, q, theta, beta, p, r, phi]``, SI and radians.
    """
    return ErrorCoordinates("euler").difference(state, nominal)


def _down(quaternion: Sequence[Any]) -> list[Any]:
    """Unit vector towards the ground, in body axes."""
    q0, q1, q2, q3 = quaternion
    return [
        2.0 * (q1 * q3 - q0 * q2),
        2.0 * (q2 * q3 + q0 * q1),
        q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3,
    ]


def _pitch(down: Sequence[Any]) -> Any:
    """Pitch angle of a down direction; unlike the arcsine it stands a rounding error at the vertical."""
    return np.arctan2(-down[0], np.sqrt(down[1] * down[1] + down[2] * down[2]))


def _dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _tilt_axes(quaternion: Sequence[Any]) -> tuple[list[Any], list[Any], list[Any]]:
    """Nominal down direction and the two directions in which it can move, in body axes."""
    down = _down(quaternion)
    level = np.hypot(down[1], down[2])
    steep = level < 1e-9
    safe = np.where(steep, 1.0, level)
    cos_roll, sin_roll = np.where(steep, 1.0, down[2] / safe), np.where(steep, 0.0, down[1] / safe)
    e_phi = [np.zeros_like(cos_roll), cos_roll, -sin_roll]
    e_theta = [
        down[1] * e_phi[2] - down[2] * e_phi[1],
        down[2] * e_phi[0] - down[0] * e_phi[2],
        down[0] * e_phi[1] - down[1] * e_phi[0],
    ]
    return down, e_theta, e_phi
