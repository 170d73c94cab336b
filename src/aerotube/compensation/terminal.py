r"""Terminal ellipsoids of a law that is given: the last of the paper's three steps (Algorithm 3), on the exact map.

With the law held, :math:`1 - x^{+T} E x^+` is affine in E, and three sizes are convex: the least :math:`\rho` of a
given shape, :math:`\mathrm{tr}(E_1 E^{-1})` (the sum of the squares of the semi-axes, in a metric), and the volume,
:math:`-\log\det E`. The first is what Eq. 14 minimises; with it alone the step changes nothing, since the shape it
starts from stays optimal.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.compensation import exact_map
from aerotube.compensation.forms import inner_product

Array = NDArray[np.float64]
TerminalSize = Literal["volume", "trace", "rho"]


@dataclass(frozen=True)
class Terminal:
    """Terminal ellipsoids ``x' shape x <= rho`` of a batch of beats.

    Attributes
    ----------
    shape, rho : ndarray (b, n, n), (b,)
        NaN where none was found. Residuals and rounding that the solver left are in ``rho``: the ellipsoid holds the
        polynomial through the samples.
    seconds : ndarray (b,)
        Time in the solver.
    """

    shape: Array
    rho: Array
    seconds: Array


def terminal_ellipsoid(
    end: Array,
    metric: Array,
    size: TerminalSize = "volume",
    *,
    degree: int = 4,
    backend: str = "aerotube",
    workers: int = 1,
) -> Terminal:
    """Smallest ellipsoids around errors at the end of a beat.

    Parameters
    ----------
    end : ndarray (b, k, U, n)
        Errors at the end of the beat, law included, at the nodes of
        :func:`aerotube.compensation.exact_map.size_structure` on the boundary of the initial ellipsoid.
    metric : ndarray (b, n, n)
        E1: in which the trace is taken, and the shape that ``"rho"`` keeps.
    size : {"volume", "trace", "rho"}
    degree : int
        Of the sum-of-squares constraints, even.
    backend : {"aerotube", "clarabel"}
    workers : int

    Returns
    -------
    Terminal
    """
    _, vertices, _, n = end.shape
    if size == "rho":
        structure = exact_map.size_structure(n, vertices, degree)
        problem, rho_unit = exact_map.size_data(structure, end, metric)
        solution = sos.solve(structure, problem, backend=backend, workers=workers)
        return Terminal(metric, (solution["rho"] + _deficit(solution)) * rho_unit, solution.seconds)
    if size == "volume":
        structure = exact_map.volume_structure(n, vertices, degree)
        problem, unit = exact_map.volume_data(structure, end)
    else:
        structure = _trace_structure(n, vertices, degree)
        problem, unit = _trace_data(structure, end, metric)
    solution = sos.solve(structure, problem, backend=backend, workers=workers)
    form = 0.5 * (solution["E"] + np.swapaxes(solution["E"], 1, 2))
    rho = 1.0 + _deficit(solution)
    there = np.isfinite(form).all((1, 2)) & np.isfinite(rho)
    there &= np.linalg.eigvalsh(np.where(there[:, None, None], form, 0.0))[:, 0] > 0
    shape = np.swapaxes(unit, 1, 2) @ form @ unit
    return Terminal(np.where(there[:, None, None], shape, np.nan), np.where(there, rho, np.nan), solution.seconds)


def _deficit(solution: sos.Solution) -> Array:
    """What the certificate cannot vouch for of the tube's constraints: ndarray (b,)."""
    margins = solution.certificate().margins
    least = np.min([margin for name, margin in margins.items() if name.startswith("tube/")], axis=0)
    return np.asarray(np.where(np.isfinite(least), np.maximum(-least, 0.0), np.nan))


@lru_cache(maxsize=32)
def _trace_structure(states: int, vertices: int, degree: int) -> sos.Structure:
    program = sos.Program()
    program.symmetric("E", states)
    program.symmetric("W", states)
    for k in range(vertices):
        program.sos(f"tube/{k}", sos.Sphere(states), degree=degree)
    program.lmi("inverse", size=2 * states)
    return program.compile()


def _trace_data(structure: sos.Structure, end: Array, metric: Array) -> tuple[sos.Data, Array]:
    """Data: the tubes and units of the volume program, and [[W, I], [I, E]] >= 0."""
    n = end.shape[3]
    volume = exact_map.volume_structure(n, end.shape[1], structure.constraint("tube/0").degree)
    known, unit = exact_map.volume_data(volume, end)
    E, W = structure.variable("E"), structure.variable("W")
    constraints: dict[str, tuple[Array, ...]] = {}
    for k in range(end.shape[1]):
        arrays = known.constraints[f"tube/{k}"]
        linear = np.zeros((*arrays["C"].shape[:-1], structure.size))
        linear[..., E.slice] = arrays["C"][..., volume.variable("E").slice]
        constraints[f"tube/{k}"] = (arrays["c"], linear)
    constant = np.zeros((2 * n, 2 * n))
    constant[:n, n:] = constant[n:, :n] = np.eye(n)
    form = np.zeros((structure.size, 2 * n, 2 * n))
    rows, columns = np.indices((n, n))
    form[W.index, rows, columns] = 1.0
    form[E.index, n + rows, n + columns] = 1.0
    constraints["inverse"] = (constant, form)
    inverse = np.linalg.inv(unit)
    weight = inverse.swapaxes(1, 2) @ metric @ inverse
    weight = weight / np.trace(weight, axis1=1, axis2=2)[:, None, None]
    objective = np.zeros((len(end), structure.size))
    objective[:, W.slice] = inner_product(weight)
    return structure.data(objective=objective, constraints=constraints), unit
