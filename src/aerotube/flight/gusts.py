r"""Dryden turbulence (MIL-F-8785C, 3.7.2) of a named severity, sampled exactly.

The air is frozen and the aircraft flies through it at a speed V, so a spectrum over the spatial frequency becomes
one over :math:`\omega = V\Omega`. Each spectrum is rational; its filter is written in state space, driven by white
noise, and the state is propagated from sample to sample with the matrix exponential and the exact covariance of
the noise gathered in between. The first sample is drawn from the stationary distribution. So the statistics of
the samples are those of the continuous process, whatever the step.

Velocities: :math:`\Phi_u = \sigma_u^2 \frac{2L_u}{\pi V}\frac{1}{1+(L_u\omega/V)^2}`,
:math:`\Phi_{v,w} = \sigma^2 \frac{L}{\pi V}\frac{1+3(L\omega/V)^2}{(1+(L\omega/V)^2)^2}` (one-sided: the integral over
:math:`\omega > 0` is the variance). Rotations: :math:`\Phi_p = \frac{\sigma_w^2}{V L_w}
\frac{0.8(\pi L_w/4b)^{1/3}}{1+(4b\omega/\pi V)^2}`, :math:`\Phi_q = \frac{(\omega/V)^2}{1+(4b\omega/\pi V)^2}\Phi_w`,
:math:`\Phi_r = \frac{(\omega/V)^2}{1+(3b\omega/\pi V)^2}\Phi_v`. Signs follow from what the rotation stands for, the
gradient of the air's velocity along the fuselage seen as a rigid rotation: :math:`q = -\partial w/\partial x`,
:math:`r = \partial v/\partial x`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_continuous_lyapunov

from aerotube.errors import InputError

Array = NDArray[np.float64]
Severity = Literal["light", "moderate", "severe"]

_FOOT = 0.3048
_KNOT = 1852.0 / 3600.0
# Intensity above 2000 ft, ft/s, over altitude, ft: MIL-F-8785C Fig. 7 at probabilities of exceedance of
# 1e-2, 1e-3 and 1e-5.
_ALTITUDE_FT = np.array([500, 1750, 3750, 7500, 15000, 25000, 35000, 45000, 55000, 65000, 75000, 80000], float)
_INTENSITY_FPS = {
    "light": (6.6, 6.9, 7.4, 6.7, 4.6, 2.7, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0),
    "moderate": (8.6, 9.6, 10.6, 10.1, 8.0, 6.6, 5.0, 4.2, 2.7, 0.0, 0.0, 0.0),
    "severe": (15.6, 17.6, 23.0, 23.6, 22.1, 20.0, 16.0, 15.1, 12.1, 7.9, 6.2, 5.1),
}
_WIND_AT_20_FT_KNOTS = {"light": 15.0, "moderate": 30.0, "severe": 45.0}
_LOW_FT, _HIGH_FT, _SCALE_HIGH_FT = 1000.0, 2000.0, 1750.0

#: Order of the filters' states: u; v (two) and r; w (two) and q; p.
CHANNELS = 8


class GustModel(NamedTuple):
    """A gust as a linear process in discrete time, ``x' = F x + n``, its output the wind ``C x``.

    Attributes
    ----------
    transition : ndarray (8, 8)
    gathered : ndarray (8, 8)
        Covariance of the noise of a step.
    stationary : ndarray (8, 8)
        Covariance of the states.
    output : ndarray (6, 8)
        To ``(u, v, w, p, q, r)``, m/s and rad/s.
    """

    transition: Array
    gathered: Array
    stationary: Array
    output: Array


@dataclass(frozen=True)
class Dryden:
    """A stationary turbulence field as it is met at one altitude and airspeed.

    Parameters
    ----------
    severity : {"light", "moderate", "severe"}
    altitude : float
        Above the ground, m; positive.
    speed : float
        Airspeed, m/s; positive.
    span : float
        Wing span, m; positive.

    Raises
    ------
    InputError
        For an unknown severity, or a number that is not positive.

    Notes
    -----
    The gust axes are taken to be the body axes at every altitude; the specification says so above 2000 ft and
    uses the mean wind's axes below 1000 ft.
    """

    severity: Severity
    altitude: float
    speed: float
    span: float

    def __post_init__(self) -> None:
        if self.severity not in _INTENSITY_FPS:
            raise InputError(f"gusts: unknown severity {self.severity!r}; choose one of {', '.join(_INTENSITY_FPS)}.")
        for name in ("altitude", "speed", "span"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"gusts: {name} must be positive; got {value!r}.")

    @property
    def intensity(self) -> Array:
        """Standard deviations of u, v, w, m/s: ndarray (3,)."""
        return self._by_altitude()[0]

    @property
    def scale(self) -> Array:
        """Length scales of u, v, w, m: ndarray (3,)."""
        return self._by_altitude()[1]

    def spectrum(self, frequency: Array) -> Array:
        """One-sided spectra of the six outputs.

        Parameters
        ----------
        frequency : ndarray (...)
            Circular frequency, rad/s.

        Returns
        -------
        ndarray (..., 6)
            For ``(u, v, w, p, q, r)``, in squared units of the output per rad/s; the integral over positive
            frequencies is the variance.
        """
        omega = np.asarray(frequency, dtype=float)
        speed, span = self.speed, self.span
        (su, sv, sw), (lu, lv, lw) = self.intensity, self.scale
        x = omega / speed

        def second(sigma: float, length: float) -> Array:
            y = (length * x) ** 2
            return np.asarray(sigma**2 * length / (np.pi * speed) * (1 + 3 * y) / (1 + y) ** 2)

        v, w = second(sv, lv), second(sw, lw)
        u = su**2 * 2 * lu / (np.pi * speed) / (1 + (lu * x) ** 2)
        roll = 0.8 * (np.pi * lw / (4 * span)) ** (1 / 3) / (1 + (4 * span * x / np.pi) ** 2)
        return np.stack(
            [
                u,
                v,
                w,
                sw**2 / (speed * lw) * roll,
                x**2 / (1 + (4 * span * x / np.pi) ** 2) * w,
                x**2 / (1 + (3 * span * x / np.pi) ** 2) * v,
            ],
            axis=-1,
        )

    def covariance(self) -> Array:
        """Stationary covariance of ``(u, v, w, p, q, r)``: ndarray (6, 6), m/s and rad/s."""
        dynamics, drive, output = self._filters()
        return np.asarray(output @ _stationary(dynamics, drive) @ output.T)

    def sample(self, normals: Array, dt: float) -> Array:
        """Turbulence at evenly spaced times.

        Parameters
        ----------
        normals : ndarray (..., time, 8)
            Independent standard normal numbers; see :meth:`Draws.gust_noise`.
        dt : float
            Step, s; positive.

        Returns
        -------
        ndarray (..., time, 6)
            ``(u, v, w, p, q, r)``: velocity, m/s, and rotation, rad/s, of the air relative to the earth, in
            body axes.

        Raises
        ------
        InputError
            If the last axis of ``normals`` has not 8 components or the step is not positive.
        """
        normals = np.asarray(normals, dtype=float)
        if normals.ndim < 2 or normals.shape[-1] != CHANNELS:
            raise InputError(f"gusts: normals must be (..., time, {CHANNELS}); got {normals.shape}.")
        if not (np.isfinite(dt) and dt > 0):
            raise InputError(f"gusts: the step must be positive; got {dt!r}.")
        model = self.discretise(dt)
        states = np.empty_like(normals)
        states[..., 0, :] = _apply(_root(model.stationary), normals[..., 0, :])
        root = _root(model.gathered)
        for k in range(1, normals.shape[-2]):
            states[..., k, :] = _apply(model.transition, states[..., k - 1, :]) + _apply(root, normals[..., k, :])
        return _apply(model.output, states)

    def discretise(self, dt: float) -> GustModel:
        """Return the filters sampled exactly at a step ``dt`` (s)."""
        dynamics, drive, output = self._filters()
        stationary = _stationary(dynamics, drive)
        transition = expm(dynamics * dt)
        # Stationarity gives the covariance gathered over a step: no exponential of a matrix whose eigenvalues
        # have both signs.
        gathered = stationary - transition @ stationary @ transition.T
        return GustModel(transition, gathered, stationary, output)

    def _by_altitude(self) -> tuple[Array, Array]:
        feet = self.altitude / _FOOT
        if feet >= _HIGH_FT:
            return self._high(feet)
        if feet <= _LOW_FT:
            return self._low(feet)
        # The specification leaves the layer between open; a straight line between its edges is the custom.
        share = (feet - _LOW_FT) / (_HIGH_FT - _LOW_FT)
        low, high = self._low(_LOW_FT), self._high(_HIGH_FT)
        return (1 - share) * low[0] + share * high[0], (1 - share) * low[1] + share * high[1]

    def _low(self, feet: float) -> tuple[Array, Array]:
        vertical = 0.1 * _WIND_AT_20_FT_KNOTS[self.severity] * _KNOT
        ratio = 0.177 + 0.000823 * feet
        horizontal = vertical / ratio**0.4
        length = feet / ratio**1.2
        return np.array([horizontal, horizontal, vertical]), np.array([length, length, feet]) * _FOOT

    def _high(self, feet: float) -> tuple[Array, Array]:
        sigma = np.interp(feet, _ALTITUDE_FT, _INTENSITY_FPS[self.severity])
        return np.full(3, sigma * _FOOT), np.full(3, _SCALE_HIGH_FT * _FOOT)

    def _filters(self) -> tuple[Array, Array, Array]:
        """Filters as ``x' = A x + B n`` and outputs ``C x``, n four white noises of unit intensity."""
        a, b, c = np.zeros((8, 8)), np.zeros((8, 4)), np.zeros((6, 8))
        time = self.scale / self.speed
        sigma = self.intensity
        a[0, 0], b[0, 0], c[0, 0] = -1 / time[0], np.sqrt(2 / time[0]), sigma[0]
        # Along the second-order velocity the rotation is a filtered derivative: tau y' + y = (x_out)' / V, so
        # with z = x_out / (V tau) - y the derivative itself is never needed: z' = -z / tau + x_out / (V tau^2).
        for place, white, axis, arm, row, sign in ((1, 1, 1, 3.0, 5, 1.0), (4, 2, 2, 4.0, 4, -1.0)):
            t, tau = time[axis], arm * self.span / (np.pi * self.speed)
            a[place, place], b[place, white] = -1 / t, np.sqrt(1 / t)
            a[place + 1, place], a[place + 1, place + 1] = 1 / t, -1 / t
            # (1 + sqrt(3) t s) / (1 + t s)^2 = sqrt(3) / (1 + t s) + (1 - sqrt(3)) / (1 + t s)^2
            velocity = np.zeros(8)
            velocity[place], velocity[place + 1] = sigma[axis] * np.sqrt(3), sigma[axis] * (1 - np.sqrt(3))
            c[axis] = velocity
            z = place + 2
            a[z] = velocity / (self.speed * tau**2)
            a[z, z] = -1 / tau
            c[row] = sign * velocity / (self.speed * tau)
            c[row, z] = -sign
        tau = 4 * self.span / (np.pi * self.speed)
        a[7, 7], b[7, 3] = -1 / tau, np.sqrt(2 / tau)
        c[3, 7] = sigma[2] * np.sqrt(
            0.8 * np.pi / (2 * tau * self.speed * self.scale[2]) * (np.pi * self.scale[2] / (4 * self.span)) ** (1 / 3)
        )
        return a, b, c


def _stationary(dynamics: Array, drive: Array) -> Array:
    return np.asarray(solve_continuous_lyapunov(dynamics, -drive @ drive.T))


def _root(covariance: Array) -> Array:
    """Lower-triangular-like square root of a covariance that may be singular up to rounding."""
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(scale[:, None] * (vectors * np.sqrt(np.maximum(values, 0.0))))


def _apply(matrix: Array, vectors: Array) -> Array:
    """Matrix times vectors on the last axis, each row by itself: no result depends on the batch it is in."""
    return np.asarray(np.einsum("ij,...j->...i", matrix, vectors))
