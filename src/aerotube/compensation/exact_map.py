"""Programs that measure tubes whose law is given: the least size in a metric, and the ellipsoid of least volume.

The error at the end of a beat enters by its values at nodes on the boundary of the initial ellipsoid, law included.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.compensation.forms import quadratic_forms

Array = NDArray[np.float64]


@lru_cache(maxsize=32)
def size_structure(states: int, vertices: int, degree: int) -> sos.Structure:
    """Structure of the program that measures a tube whose law is given: minimise ``rho``."""
    program = sos.Program()
    program.scalar("rho")
    for k in range(vertices):
        program.sos(f"tube/{k}", sos.Sphere(states), degree=degree)
    return program.compile()


@lru_cache(maxsize=32)
def volume_structure(states: int, vertices: int, degree: int) -> sos.Structure:
    """Structure of the program that finds a terminal ellipsoid of least volume: maximise ``log det E``."""
    program = sos.Program()
    program.symmetric("E", states)
    for k in range(vertices):
        program.sos(f"tube/{k}", sos.Sphere(states), degree=degree)
    program.logdet("volume", size=states)
    return program.compile()


def size_data(structure_: sos.Structure, end: Array, shape: Array) -> tuple[sos.Data, Array]:
    """Data of :func:`size_structure`, and the unit of its ``rho``.

    Parameters
    ----------
    structure_ : sos.Structure
    end : ndarray (b, k, U, n)
        Errors at the end of the beat, law included, at the nodes.
    shape : ndarray (b, n, n)
        The metric.

    Returns
    -------
    sos.Data
    unit : ndarray (b,)
    """
    value = np.einsum("bkui,bij,bkuj->bku", end, shape, end)
    unit = np.maximum(value.max((1, 2)), np.finfo(float).tiny)
    constraints = {
        f"tube/{k}": (-value[:, k] / unit[:, None], np.ones((value.shape[2], 1))) for k in range(value.shape[1])
    }
    return structure_.data(objective=np.ones(1), constraints=constraints), unit


def volume_data(structure_: sos.Structure, end: Array) -> tuple[sos.Data, Array]:
    """Data of :func:`volume_structure`, and the unit of its ``E``.

    Parameters
    ----------
    structure_ : sos.Structure
    end : ndarray (b, k, U, n)
        Errors at the end of the beat, law included, at the nodes.

    Returns
    -------
    sos.Data
    unit : ndarray (b, n, n)
        The ellipsoid is ``x' unit' E unit x <= 1``.
    """
    _, vertices, nodes, n = end.shape
    spread = np.einsum("bkui,bkuj->bij", end, end) * (n / (vertices * nodes))
    size = np.diagonal(spread, axis1=1, axis2=2)[:, :, None]
    # directions in which nothing arrives get a width of a millionth, so that the ellipsoid has one
    unit = np.linalg.inv(np.linalg.cholesky(spread + 1e-12 * size * np.eye(n)))
    E = structure_.variable("E")
    linear = -quadratic_forms(np.einsum("bij,bkuj->bkui", unit, end))
    form = np.zeros((structure_.size, n, n))
    rows, columns = np.indices((n, n))
    form[E.index, rows, columns] = 1.0
    constraints: dict[str, tuple[Array, ...]] = {f"tube/{k}": (np.ones(nodes), linear[:, k]) for k in range(vertices)}
    constraints["volume"] = (np.zeros((n, n)), form)
    return structure_.data(objective=np.zeros(structure_.size), constraints=constraints), unit
