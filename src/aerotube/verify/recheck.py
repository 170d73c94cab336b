"""Certificates of tubes checked against laws and bounds as they are claimed, computed again from the aircraft.

A saved certificate says that some polynomial is at most some number. Whether that polynomial is the closed loop of this
law, from this initial ellipsoid, in this metric, and the number this tube's size, is what is computed again here: the
beat is flown once more from the certificate's nodes, and its Gram matrices are held against what comes out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from aerotube.aircraft.base import Aircraft
from aerotube.compensation import Compensation, Part
from aerotube.dynamics import error_map
from aerotube.nominal import Nominal
from aerotube.tube import DisturbanceSet, ellipsoid

Array = NDArray[np.float64]

# Of the size: what the rounding of flying a beat another time may change.
_ROUNDING = 1e-7


def recheck(aircraft: Aircraft, nominal: Nominal, disturbance: DisturbanceSet, made: Compensation) -> NDArray[np.bool_]:
    """Check the size of every tube, for its polynomials, against the law and the bound as they are claimed.

    Parameters
    ----------
    aircraft : Aircraft
    nominal : Nominal
    disturbance : DisturbanceSet
        Its uncertain parameters.
    made : Compensation
        Of all beats: its ``law``, ``tubes`` and ``evidence`` are held against each other.

    Returns
    -------
    ndarray (T, parts) of bool
        Whether the evidence bears out that the size is a bound for the polynomials. False where there is no tube.
    """
    tubes = made.tubes
    sound = np.zeros(tubes.size.shape, dtype=bool)
    vertices = disturbance.parameter_vertices(aircraft)
    for i, (part, evidence) in enumerate(zip(tubes.parts, made.evidence, strict=True)):
        solution = evidence.solution
        nodes = solution.structure.nodes("tube/0")
        whitening = ellipsoid.whitening(tubes.initial_shape[:, i], tubes.initial_rho[:, i])
        end = _flown(aircraft, nominal, made, part, whitening @ nodes.T, vertices)
        size = np.einsum("bkui,bij,bkuj->bku", end, tubes.metric[:, i], end, optimize=True)
        there = np.isfinite(size).all(axis=(1, 2)) & np.isfinite(tubes.size[:, i]) & (tubes.size[:, i] > 0)
        # The program's unit is the largest value at the nodes, of the law that it was solved for.
        unit = np.where(there, size.max(axis=(1, 2)), 1.0)
        size = np.where(there[:, None, None], size, 0.0)
        one = np.ones((size.shape[2], 1))
        data = solution.structure.data(
            objective=np.ones(1),
            constraints={f"tube/{k}": (-size[:, k] / unit[:, None], one) for k in range(size.shape[1])},
        )
        claim = np.where(there, tubes.size[:, i], 1.0) / unit
        margins = replace(solution, data=data, values=claim[:, None], objective=claim).certificate().margins
        sound[:, i] = there & (np.min(list(margins.values()), axis=0) >= -_ROUNDING)
    return sound


def _flown(
    aircraft: Aircraft, nominal: Nominal, made: Compensation, part: Part, start: Array, vertices: Array
) -> Array:
    """Errors of a part (b, k, U, n) at the end of the beats, from its errors (b, n, U) at their start."""
    errors = list(part.errors)
    error = np.zeros((nominal.beats, 1, start.shape[2], 8))
    error[:, 0, :, errors] = np.moveaxis(start, 1, 0)
    push = np.stack([made.law.increment(beat, error[beat]) for beat in range(nominal.beats)])
    parameters = np.broadcast_to(vertices, (nominal.beats, *vertices.shape))[:, :, None, :]
    end = error_map(
        aircraft, nominal, np.arange(nominal.beats), made.law.coordinates, error, increment=push,
        parameters=parameters,
    )  # fmt: skip
    return np.ascontiguousarray(end[..., errors])
