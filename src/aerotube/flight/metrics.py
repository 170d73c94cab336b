r"""How well a flight kept to its nominal: the error of Eq. 18 and the figures made from it.

.. math:: \mathrm{error} = \sqrt{\tfrac18 \sum_i e_i^2}, \qquad
          e = (\hat V / 100,\ \hat\alpha,\ \hat q,\ \hat\theta,\ \hat\beta,\ \hat p,\ \hat r,\ \hat\phi),

airspeed in m/s, angles in degrees and rates in degrees per second: the one place inside the package where
degrees enter, since the published figures are in these units.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aerotube.errors import InputError

Array = NDArray[np.float64]

#: Factors that turn an error state in SI and radians into the terms of Eq. 18.
METRIC_SCALE: Array = np.array([0.01] + 7 * [180.0 / np.pi])
METRIC_SCALE.setflags(write=False)


def error_metric(error: Array) -> Array:
    """Root mean square over the eight error states, as Eq. 18 weighs them.

    Parameters
    ----------
    error : ndarray (..., 8)
        Differences ``[V, alpha, q, theta, beta, p, r, phi]``, SI and radians.

    Returns
    -------
    ndarray (...)
        Eq. 18; its unit is the degree (or degree per second) of the angular terms.
    """
    scaled = np.asarray(error, dtype=float) * METRIC_SCALE
    return np.asarray(np.sqrt(np.mean(scaled * scaled, axis=-1)))


def upper_envelope(metric: Array, seeds: int) -> Array:
    """Largest error over the runs of each seed, at every time.

    Parameters
    ----------
    metric : ndarray (run, time)
        Eq. 18 of every run, the runs of one seed next to each other.
    seeds : int
        Number of seeds.

    Returns
    -------
    ndarray (seed, time)

    Raises
    ------
    InputError
        If the runs do not divide evenly among the seeds.
    """
    runs, times = metric.shape
    if seeds < 1 or runs == 0 or runs % seeds:
        raise InputError(f"metric: {runs} runs do not divide among {seeds} seeds; give every seed as many runs.")
    return np.asarray(metric.reshape(seeds, runs // seeds, times).max(axis=1))


def mean_upper_error(metric: Array, seeds: int) -> Array:
    """Mean over time of the upper envelope: the figure that the paper reports (its Section 4.2.2).

    Parameters
    ----------
    metric : ndarray (run, time)
        Eq. 18 of every run, the runs of one seed next to each other, the times evenly spaced.
    seeds : int
        Number of seeds.

    Returns
    -------
    ndarray (seed,)
        One figure for each seed; it grows with the number of runs a seed has, as a maximum does.
    """
    return np.asarray(upper_envelope(metric, seeds).mean(axis=-1))


def mean_absolute_error(metric: Array) -> Array:
    """Mean over time of the absolute tracking error (MAE).

    Parameters
    ----------
    metric : ndarray (..., time)

    Returns
    -------
    ndarray (...)
    """
    return np.asarray(np.abs(metric).mean(axis=-1))


def root_mean_square_error(metric: Array) -> Array:
    """Root of the mean over time of the squared tracking error (RMSE).

    Parameters
    ----------
    metric : ndarray (..., time)

    Returns
    -------
    ndarray (...)
    """
    return np.asarray(np.sqrt(np.square(metric).mean(axis=-1)))
