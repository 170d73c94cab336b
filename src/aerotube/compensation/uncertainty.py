"""Sizes of tubes with the uncertain parameters as variables, everywhere in their ranges and not at the extremes alone.

At the extremes is enough where the error map is affine in each parameter; for an aircraft whose parameters enter
otherwise it is not. Here a parameter is a variable of the sum-of-squares constraint, with the multiplier of its
interval (the paper's Eq. 7): slower, since the program has more variables, and good for a check of the extremes.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.aircraft.base import Aircraft
from aerotube.compensation.closed_loop import BatchLaw
from aerotube.compensation.sets import initial_ellipsoid
from aerotube.compensation.settings import Part
from aerotube.dynamics import ErrorCoordinates, error_map
from aerotube.errors import InputError
from aerotube.nominal import Nominal
from aerotube.tube import DisturbanceSet, parameter_ranges

Array = NDArray[np.float64]


@lru_cache(maxsize=16)
def _structure(states: int, parameters: int, degree: int) -> sos.Structure:
    program = sos.Program()
    program.scalar("rho")
    program.sos("tube", sos.Product(sos.Sphere(states), *[sos.Interval()] * parameters), degree=degree)
    return program.compile()


def size_over_parameters(
    aircraft: Aircraft,
    nominal: Nominal,
    disturbance: DisturbanceSet,
    law: BatchLaw | None,
    metric: Array,
    part: Part,
    *,
    beats: range | None = None,
    degree: int = 4,
    backend: str = "aerotube",
    workers: int = 1,
) -> Array:
    """Sizes of the tubes of one part for all parameters between their extremes.

    Parameters
    ----------
    aircraft : Aircraft
    nominal : Nominal
    disturbance : DisturbanceSet
        Its ``relative`` changes one parameter at least.
    law : BatchLaw or None
        None: the nominal controls alone.
    metric : ndarray (b, n, n)
    part : Part
    beats : range, optional
        All by default.
    degree : int
        Of the polynomial in errors and parameters that interpolates the size, even.
    backend, workers
        As for `aerotube.sos.solve`.

    Returns
    -------
    ndarray (b,)
        Certified for the interpolating polynomial; NaN where nothing could be.

    Raises
    ------
    InputError
        If no parameter is uncertain.
    """
    chosen = np.arange(nominal.beats) if beats is None else np.asarray(beats)
    coordinates = ErrorCoordinates("relative") if law is None else law.coordinates
    ranges = parameter_ranges(aircraft, disturbance.relative)
    uncertain = np.flatnonzero(ranges[:, 0] < ranges[:, 1])
    if not len(uncertain):
        raise InputError("size over parameters: no parameter is uncertain; give a relative change that is not zero.")
    n = len(part.errors)
    structure = _structure(n, len(uncertain), degree)
    nodes = structure.nodes("tube")
    middle, half = ranges.mean(axis=1), 0.5 * (ranges[:, 1] - ranges[:, 0])
    parameters = np.tile(middle, (len(nodes), 1))
    parameters[:, uncertain] += half[uncertain] * nodes[:, n:]
    initial = initial_ellipsoid(disturbance, coordinates, nominal.states[chosen], part)
    error = np.zeros((len(chosen), len(nodes), 8))
    error[..., part.errors] = np.einsum("bij,uj->bui", initial.whitening, nodes[:, :n])
    end = error_map(
        aircraft,
        nominal,
        chosen,
        coordinates,
        error,
        increment=None if law is None else law.increments(chosen, error),
        parameters=np.broadcast_to(parameters, (len(chosen), *parameters.shape)),
    )[..., part.errors]
    values = np.einsum("bui,bij,buj->bu", end, metric, end)
    unit = np.maximum(values.max(axis=1), np.finfo(float).tiny)
    data = structure.data(
        objective=np.ones(1), constraints={"tube": (-values / unit[:, None], np.ones((len(nodes), 1)))}
    )
    solution = sos.solve(structure, data, backend=backend, workers=workers)
    deficit = np.maximum(-np.asarray(solution.certificate().margins["tube"]), 0.0)
    return np.asarray(unit * (solution["rho"] + deficit))
