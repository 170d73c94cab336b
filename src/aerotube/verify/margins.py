r"""Gain, phase and delay margins of the loop that a law closes, beat by beat, as disk margins.

At each beat the linearised error map and the linear part of the law are frozen into a discrete loop,
:math:`x^+ = A x + B u,\; u = K x`, whose controls are each multiplied by a factor *f* that should be one. With the
sensitivity :math:`S(z) = (I - K (zI - A)^{-1} B)^{-1}` at the controls, the loop stays stable for every factor, real
or complex, constant or varying with frequency, in the balanced disk

.. math:: f = \frac{1 + \delta/2}{1 - \delta/2}, \quad |\delta| < \alpha, \qquad
          \alpha = \frac{1}{\max_\omega |S(e^{j\omega\Delta t}) - \tfrac12|} ,

so for gains between :math:`(2-\alpha)/(2+\alpha)` and its inverse, and for phases up to
:math:`2 \arctan(\alpha/2)` (P. Seiler, A. Packard, P. Gahinet, "An introduction to disk margins", IEEE Control Systems
Magazine 40(5), 2020, section on the balanced, or S - T, disk). One control at a time, the others closed, the diagonal
elements of S decide. With factors in all controls at once, independent of each other, it is the structured singular
value of :math:`S - I/2`, of which the bound by diagonal scaling is taken: the true margin is not less.

Delays: of one control, the least that puts a pole on the unit circle; of all, each its own, a bound below which none
does. They are exact for whole beats and an extrapolation between, since the control is held over a beat. The frozen
loop is the usual measure, and says nothing of how fast the manoeuvre changes: over a few beats an unstable frozen loop
may do no harm, and a stable one is no proof. That is what tubes are for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerotube.errors import InputError

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Frequencies (rad a beat) at which every loop is looked at, besides those of its own poles; then the search closes in.
_GRID = np.concatenate([[0.0], np.geomspace(1e-3, np.pi, 28)])
_ROUNDS, _POINTS = 4, 5
_SWEEPS = 6


@dataclass(frozen=True)
class Margins:
    """Margins of every beat's frozen loop; zero where it is not stable by itself.

    Attributes
    ----------
    dt : float
        Length of a beat, s.
    radius : ndarray (T,)
        Largest modulus of the closed loop's poles; stable below one.
    disk : ndarray (T, m)
        Disk margin alpha of each control, the others' loops closed and undisturbed.
    frequency : ndarray (T, m)
        Where it is attained, rad/s.
    delay : ndarray (T, m)
        Delay margin of each control, s; infinite where no delay does harm.
    disk_all : ndarray (T,)
        Disk margin with independent factors in all controls at once (a lower bound).
    frequency_all : ndarray (T,)
        Where it is attained, rad/s.
    delay_all : ndarray (T,)
        A delay up to which all controls may lag, each on its own, s (a lower bound).
    """

    dt: float
    radius: Array
    disk: Array
    frequency: Array
    delay: Array
    disk_all: Array
    frequency_all: Array
    delay_all: Array

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Whether the frozen loop of each beat is stable: ndarray (T,)."""
        return np.asarray(self.radius < 1.0)


def gain_margin(disk: ArrayLike) -> tuple[Array, Array]:
    """Least and largest gain factors of a balanced disk.

    Parameters
    ----------
    disk : array (...)
        Disk margins alpha, not negative.

    Returns
    -------
    low, high : ndarray (...)
        Zero and infinity from a disk margin of two on.
    """
    alpha = np.minimum(np.asarray(disk, dtype=float), 2.0)
    with np.errstate(divide="ignore"):
        high = (2.0 + alpha) / (2.0 - alpha)
    return (2.0 - alpha) / (2.0 + alpha), np.asarray(high)


def phase_margin(disk: ArrayLike) -> Array:
    """Phase of a balanced disk (rad, either way): ndarray (...)."""
    return np.asarray(2.0 * np.arctan(0.5 * np.asarray(disk, dtype=float)))


def linear_part(law: Any, beats: int) -> Array:
    """Gains of a law at zero error: those it has, or differences of its increments.

    Parameters
    ----------
    law : Law
        With ``gains`` (T, 4, 8) or at least ``increment(beat, error)``.
    beats : int

    Returns
    -------
    ndarray (T, 4, 8)
    """
    gains = getattr(law, "gains", None)
    if gains is not None:
        return np.asarray(gains, dtype=float)
    width = 1e-6 * np.array([100.0, *[1.0] * 7])
    ends = np.concatenate([np.diag(width), -np.diag(width)])
    values = np.stack([law.increment(beat, ends) for beat in range(beats)])
    return np.asarray(np.swapaxes(values[:, :8] - values[:, 8:], 1, 2) / (2.0 * width))


def margins(A: Array, B: Array, K: Array, dt: float) -> Margins:
    """Margins of discrete loops ``x+ = A x + B u, u = K x``, broken at each control.

    Parameters
    ----------
    A : ndarray (T, n, n)
    B : ndarray (T, n, m)
    K : ndarray (T, m, n)
    dt : float
        Length of a beat, s.

    Returns
    -------
    Margins

    Raises
    ------
    InputError
        If the shapes do not agree, or a number is not finite.

    Notes
    -----
    Units of states and controls do not matter. Peaks are looked for on a grid of frequencies that holds those of the
    loop's own poles, and then closed in on.
    """
    A, B, K = (np.asarray(matrix, dtype=float) for matrix in (A, B, K))
    if A.ndim != 3 or B.shape[:2] != A.shape[:2] or K.shape != (len(A), B.shape[2], A.shape[1]):
        raise InputError(f"margins: A {A.shape}, B {B.shape} and K {K.shape} do not make a loop; give one a beat.")
    if not all(np.isfinite(matrix).all() for matrix in (A, B, K)):
        raise InputError("margins: a matrix has an element that is not finite; leave that beat out.")
    loop = _Loop(A + B @ K, B, K)
    poles = np.linalg.eigvals(loop.closed).astype(complex)
    radius = np.abs(poles).max(axis=1)
    grid = _frequencies(poles)
    S = loop.sensitivity(grid)
    single, at = _close_in(loop.single, grid, _single(S))
    every, at_every = _close_in(loop.every, grid, _every(S, grid))

    def inverse(heights: Array) -> Array:
        stable = (radius < 1.0).reshape(-1, *(1,) * (heights.ndim - 1))
        with np.errstate(divide="ignore"):
            return np.where(stable, 1.0 / heights, 0.0)

    return Margins(
        dt=float(dt),
        radius=radius,
        disk=inverse(single),
        frequency=at / dt,
        delay=inverse(1.0 / _single_delays(loop, grid, S)) * dt,
        disk_all=inverse(every[:, 0]),
        frequency_all=at_every[:, 0] / dt,
        delay_all=inverse(every[:, 1]) * dt,
    )


@dataclass(frozen=True)
class _Loop:
    """Closed loops ``A + B K`` (T, n, n) with B and K."""

    closed: Array
    B: Array
    K: Array

    def sensitivity(self, theta: Array, beats: NDArray[np.intp] | None = None) -> Complex:
        """``S = I + K (zI - A - BK)^-1 B`` at frequencies (T, k), rad a beat: ndarray (T, k, m, m)."""
        closed, B, K = self.closed, self.B, self.K
        if beats is not None:
            closed, B, K = closed[beats], B[beats], K[beats]
        n, m = B.shape[1:]
        shifted = np.exp(1j * theta)[..., None, None] * np.eye(n) - closed[:, None]
        states = np.linalg.solve(shifted, np.broadcast_to(B[:, None], (*theta.shape, n, m)).astype(complex))
        return np.asarray(np.eye(m) + K[:, None] @ states)

    def single(self, theta: Array) -> Array:
        return _single(self.sensitivity(theta))

    def every(self, theta: Array) -> Array:
        return _every(self.sensitivity(theta), theta)


def _single(S: Complex) -> Array:
    """What the margins of single controls are inverse to: ndarray (T, k, m)."""
    return np.abs(np.diagonal(S, axis1=-2, axis2=-1) - 0.5)


def _every(S: Complex, theta: Array) -> Array:
    """What the margins of all controls together are inverse to: ndarray (T, k, 2).

    The bound of the structured singular value of ``S - I/2``, and the frequency over the phase by which all controls
    may lag at it.
    """
    m = S.shape[-1]
    D = balancing(S)
    scaled = S * (D[..., :, None] / D[..., None, :])
    balanced, complementary = _largest_singular_value(np.stack([scaled - 0.5 * np.eye(m), np.eye(m) - scaled]))
    # Two disks that hold the factor e^{-j phi}: the balanced one, and |f - 1| < 1 / |T|, which a weak loop fills.
    phase = 2.0 * np.arctan(0.5 / np.maximum(balanced, 1e-12))
    other = np.where(complementary > 0.5, 2.0 * np.arcsin(0.5 / np.maximum(complementary, 0.5)), np.inf)
    return np.stack([balanced, np.maximum(theta, 1e-12) / np.maximum(phase, other)], axis=-1)


def balancing(matrices: Complex) -> Array:
    """Scales d for which ``d_i M_ij / d_j`` has rows as large as its columns (Osborne), the diagonal left out.

    They make the Frobenius norm least, and the spectral norm nearly so: the bound of the structured singular value for
    independent complex factors.

    Parameters
    ----------
    matrices : ndarray (..., m, m)

    Returns
    -------
    ndarray (..., m)
    """
    power = np.abs(matrices) ** 2
    m = power.shape[-1]
    power[..., np.arange(m), np.arange(m)] = 0.0
    squares = np.ones(power.shape[:-1])
    for i in list(range(m)) * (_SWEEPS if m > 1 else 0):
        row = (power[..., i, :] / squares).sum(axis=-1)
        column = (power[..., :, i] * squares).sum(axis=-1)
        # Where one of them vanishes no scale balances the two, and a large one is good enough.
        least = 1e-30 * (row + column) + np.finfo(float).tiny
        squares[..., i] = np.sqrt((column + least) / (row + least))
    return np.asarray(np.sqrt(squares))


def _largest_singular_value(matrices: Complex) -> Array:
    gram = np.conj(np.swapaxes(matrices, -1, -2)) @ matrices
    return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(gram)[..., -1], 0.0)))


def _frequencies(poles: Complex) -> Array:
    """Rising frequencies (T, k), rad a beat: a grid, and each pole's own with its half-width either side."""
    angle, width = np.abs(np.angle(poles)), np.abs(1.0 - np.abs(poles))
    own = np.concatenate([angle - width, angle, angle + width], axis=1)
    grid = np.broadcast_to(_GRID, (len(poles), len(_GRID)))
    return np.sort(np.concatenate([grid, np.clip(own, 0.0, np.pi)], axis=1), axis=1)


def _close_in(heights: Callable[[Array], Array], grid: Array, values: Array) -> tuple[Array, Array]:
    """Peaks (T, q) of several curves given on a grid (T, k) as (T, k, q), and where they are (T, q)."""
    beats, count, curves = values.shape
    top = values.argmax(axis=1)
    peak = np.take_along_axis(values, top[:, None], axis=1)[:, 0]
    at = np.take_along_axis(grid, top, axis=1)
    # Two places either way, since conjugate poles put the same frequency there twice.
    low = np.take_along_axis(grid, np.maximum(top - 2, 0), axis=1)
    high = np.take_along_axis(grid, np.minimum(top + 2, count - 1), axis=1)
    share = np.linspace(0.0, 1.0, _POINTS + 2)
    for _ in range(_ROUNDS):
        points = low[..., None] + (high - low)[..., None] * share
        inside = points[..., 1:-1]
        found = heights(inside.reshape(beats, -1)).reshape(beats, curves, _POINTS, curves)
        own = np.stack([found[:, i, :, i] for i in range(curves)], axis=1)
        best = own.argmax(axis=2)[..., None]
        reached = np.take_along_axis(own, best, axis=2)[..., 0]
        better = reached > peak
        at = np.where(better, np.take_along_axis(inside, best, axis=2)[..., 0], at)
        peak = np.where(better, reached, peak)
        step = (high - low) / (_POINTS + 1)
        low, high = np.maximum(at - step, low), np.minimum(at + step, high)
    return peak, at


def _single_delays(loop: _Loop, grid: Array, S: Complex) -> Array:
    """Least delay (beats) of each control that puts a pole on the unit circle: ndarray (T, m), infinite if none does.

    The loop's gain is one where the real part of ``S_ii`` is one half; a delay must there supply the phase from
    ``L = (1 - S) / S`` to minus one, which is ``pi - 2 arctan(2 Im S_ii)``.
    """
    own = np.diagonal(S, axis1=-2, axis2=-1)
    height = own.real - 0.5
    # A gain above one at half the sampling rate is turned round by any whole beat of delay.
    out = np.where(height[:, -1] < 0, 1.0, np.inf)
    beat, place, control = np.nonzero(np.sign(height[:, :-1]) * np.sign(height[:, 1:]) < 0)
    if not len(beat):
        return out
    low, high = grid[beat, place], grid[beat, place + 1]
    below, above = height[beat, place, control], height[beat, place + 1, control]
    before: NDArray[np.bool_] | None = None
    for _ in range(15):
        theta = np.clip(low - below * (high - low) / (above - below), low, high)
        value = loop.sensitivity(theta[:, None], beat)[np.arange(len(beat)), 0, control, control]
        here, imaginary = value.real - 0.5, value.imag
        left = np.sign(here) == np.sign(below)
        # An end that stays a second time is counted half (the Illinois method), so that both come in.
        half = np.where(left == before, 0.5, 1.0) if before is not None else 1.0
        low, high = np.where(left, theta, low), np.where(left, high, theta)
        below, above = np.where(left, here, half * below), np.where(left, half * above, here)
        before = left
        if np.all(np.abs(here) < 1e-6):
            break
    delay = (np.pi - 2.0 * np.arctan(2.0 * imaginary)) / np.maximum(theta, np.finfo(float).tiny)
    np.minimum.at(out, (beat, control), delay)
    return out
