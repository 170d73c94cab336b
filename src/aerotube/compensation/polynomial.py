r"""Bounds of tubes for the polynomials through the values of the map at nodes: programs, solved and checked.

The size of a tube is a program on the boundary of the initial ellipsoid where the boundary is enough
(`aerotube.compensation.boundary`), and on the whole ball otherwise; terminal ellipsoids are programs on the ball.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.compensation import boundary, exact_map

Array = NDArray[np.float64]


@lru_cache(maxsize=32)
def ball_size_structure(states: int, vertices: int, degree: int) -> sos.Structure:
    """Structure of the program that measures a tube on the whole ball: minimise ``rho``."""
    program = sos.Program()
    program.scalar("rho")
    for k in range(vertices):
        program.sos(f"tube/{k}", sos.Ball(states), degree=degree)
    return program.compile()


@lru_cache(maxsize=32)
def ball_volume_structure(states: int, vertices: int, degree: int) -> sos.Structure:
    """Structure of the program of the terminal ellipsoid of least volume, on the whole ball."""
    program = sos.Program()
    program.symmetric("E", states)
    for k in range(vertices):
        program.sos(f"tube/{k}", sos.Ball(states), degree=degree)
    program.logdet("volume", size=states)
    return program.compile()


@dataclass(frozen=True)
class Size:
    """Sizes of a part's polynomials.

    Attributes
    ----------
    rho : ndarray (b,)
        In the metric; as certified where it is, as the solver says elsewhere.
    certified : ndarray (b,) of bool
    boundary : ndarray (b,) of bool
        Whether the boundary is enough for every extreme of the parameters.
    nodes : ndarray (U, n)
        Of the program, on the sphere or, if the boundary was not enough at some beat, in the ball.
    unit : ndarray (b,)
        Of the program's ``rho``.
    certificate : sos.Certificate
    """

    rho: Array
    certified: NDArray[np.bool_]
    boundary: NDArray[np.bool_]
    nodes: Array
    unit: Array
    certificate: sos.Certificate


def enough(end: Array, metric: Array, degree: int) -> NDArray[np.bool_]:
    """Whether the boundary is enough, from errors (b, k, U, n) at the end, at the nodes of the ball: bool (b,)."""
    value = np.einsum("bkui,bij,bkuj->bku", end, metric, end, optimize=True)
    return np.asarray((boundary.least_laplacian(value, end.shape[3], degree) >= 0.0).all(axis=1))


def size(end: Array, metric: Array, degree: int, nodes: Array, on_ball: bool, backend: str, workers: int) -> Size:
    """Solve the size programs of a part.

    Parameters
    ----------
    end : ndarray (b, k, U, n)
        Errors at the end of the beat, at the nodes.
    metric : ndarray (b, n, n)
    degree : int
    nodes : ndarray (U, n)
    on_ball : bool
        Whether these are nodes of the ball.
    backend : str
    workers : int

    Returns
    -------
    Size
        With `Size.boundary` true.
    """
    make = ball_size_structure if on_ball else exact_map.size_structure
    structure = make(end.shape[3], end.shape[1], degree)
    problem, unit = exact_map.size_data(structure, end, metric)
    certificate = lifted(sos.solve(structure, problem, backend=backend, workers=workers))
    rho = certificate.solution["rho"] * unit
    return Size(rho, certificate.holds, np.ones(len(end), dtype=bool), nodes, unit, certificate)


def size_of_values(found: Size, values: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Certify other values of the size, near those of a program, with its Gram matrices.

    Parameters
    ----------
    found : Size
    values : ndarray (b, k, U)
        At its nodes.

    Returns
    -------
    rho : ndarray (b,)
    certified : ndarray (b,) of bool
    """
    solution = found.certificate.solution
    one = np.ones((values.shape[2], 1))
    data = solution.structure.data(
        objective=np.ones(1),
        constraints={f"tube/{k}": (-values[:, k] / found.unit[:, None], one) for k in range(values.shape[1])},
    )
    certificate = lifted(replace(solution, data=data))
    return np.asarray(certificate.solution["rho"] * found.unit), certificate.holds


def least_volume(end: Array, degree: int, workers: int) -> tuple[Array, Array]:
    """Terminal ellipsoids of least volume, certified.

    Parameters
    ----------
    end : ndarray (b, k, U, n)
        Errors at the end of the beat, at the nodes of the ball.
    degree : int
    workers : int

    Returns
    -------
    shape, rho : ndarray (b, n, n), (b,)
        ``rho`` is one but for the certificate's margin; NaN where there is none.
    """
    structure = ball_volume_structure(end.shape[3], end.shape[1], degree)
    problem, unit = exact_map.volume_data(structure, end)
    solution = sos.solve(structure, problem, backend="aerotube", workers=workers)
    form, rho = solution["E"], 1.0 + np.maximum(deficit(solution), 0.0)
    finite = np.asarray(np.isfinite(form).all((1, 2)))
    form = np.where(finite[:, None, None], form, 0.0)
    there = finite & (np.linalg.eigvalsh(0.5 * (form + np.swapaxes(form, 1, 2)))[:, 0] > 0) & np.isfinite(rho)
    shape = np.swapaxes(unit, 1, 2) @ form @ unit
    return np.where(there[:, None, None], shape, np.nan), np.where(there, rho, np.nan)


def deficit(solution: sos.Solution) -> Array:
    """What must be added to a tube's ``rho`` for it to hold whatever the solver said: ndarray (b,).

    The certificate bounds from below what the solver claims to be positive; NaN where there is no answer at all.
    """
    margins = solution.certificate().margins
    least = -np.min([margin for name, margin in margins.items() if name.startswith("tube/")], axis=0)
    return np.asarray(np.where(np.isfinite(solution.values).all(-1) & np.isfinite(least), least, np.nan))


def lifted(solution: sos.Solution) -> sos.Certificate:
    """The certificate of a size program, its ``rho`` raised by as much as makes it hold (and a percent more)."""
    lift = np.nan_to_num(1.01 * np.maximum(deficit(solution), 0.0)) + 1e-14
    values = solution.values + lift[:, None]
    return replace(solution, values=values, objective=solution.objective + lift).certificate()
