r"""The exact-map program of one beat, and its data for many.

In whitened errors z (the initial ellipsoid is the unit ball) the error at the end of the beat is
:math:`x^+ = r(z, \sigma) + B_\sigma\hat a`, the law :math:`\hat a = K z`, and its size in the metric :math:`E_1`

.. math:: x^{+T} E_1 x^+ \le \hat r^T \hat r + 2\,\hat r^T O_\sigma \tilde K z + z^T \tilde K^T \tilde K z,

with :math:`\hat r = E_1^{1/2} r`, :math:`GG^T \succeq B_\sigma^T E_1 B_\sigma` (equal where B does not depend on
the parameters; effort may be added), :math:`\tilde K = G^T K` and :math:`O_\sigma = E_1^{1/2} B_\sigma G^{-T}`,
whose columns are orthonormal where no effort is added. The last term is bounded by a matrix S with
:math:`\begin{bmatrix} S & \tilde K^T \\ \tilde K & I \end{bmatrix} \succeq 0`, exact at an optimum. Then

* worst case: minimise :math:`\rho_1` such that :math:`\rho_1 - z^T S z - \hat r^T\hat r - 2\hat r^T O\tilde K z`
  is a sum of squares on the sphere, for every extreme :math:`\sigma` (effort included);
* mean square: minimise :math:`\mathrm{tr}(N M) + \mathrm{tr}(S (M + V))` such that
  :math:`z^T N z - \hat r^T\hat r - 2\hat r^T O\tilde K z` is one, with :math:`M` the second moments of the errors
  to be expected and :math:`V` the covariance of the noise on their measurement. The quadratic form N majorises the
  size on the boundary of the set; for a linear map without offset it is exact and the objective is the mean square,
  otherwise the objective stands in for it. The size is at most :math:`\lambda_{\max}(N+S)`.

The map without compensation enters by its values at the program's nodes; the control, linearly, by its derivative
at zero error. What the law then does is measured on the sampled closed loop.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.compensation.settings import Limits, Size
from aerotube.tube import ellipsoid

Array = NDArray[np.float64]


@lru_cache(maxsize=32)
def structure(states: int, controls: int, vertices: int, degree: int, size: Size, limits: Limits) -> sos.Structure:
    """Structure of the program of one part, made once.

    Parameters
    ----------
    states, controls : int
        n and m of the part.
    vertices : int
        Number of extreme parameter values.
    degree : int
        Degree of the sum-of-squares constraints, even.
    size : {"mean-square", "worst-case"}
    limits : {"box", "ellipsoid"}

    Returns
    -------
    sos.Structure
    """
    program = sos.Program()
    if size == "mean-square":
        program.symmetric("N", states)
    else:
        program.scalar("rho")
    program.symmetric("S", states)
    program.matrix("K", (controls, states))
    for k in range(vertices):
        program.sos(f"tube/{k}", sos.Sphere(states), degree=degree)
    program.lmi("effort", size=states + controls)
    for i in range(controls):
        if limits == "box":
            program.linear(f"limit/{i}", rows=2**states)
        else:
            program.norm(f"limit/{i}", size=states)
    return program.compile()


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


@dataclass(frozen=True)
class BeatData:
    """What the programs of a batch of beats are made from.

    Attributes
    ----------
    map_values : ndarray (b, k, U, n)
        Errors at the end of the beat without compensation, at the nodes of the sphere, for every extreme
        parameter value.
    input_map : ndarray (b, k, n, m)
        Their derivatives with respect to the virtual controls.
    whitening : ndarray (b, n, n)
        ``x = T z``.
    shape : ndarray (b, n, n)
        The metric ``E1``.
    seen : ndarray (b, n)
        Half-widths of the box of errors as the law sees them: the disturbance box and its measurement error.
    growth : ndarray (b,)
        By how much the ellipsoid of errors grows when they are measured, a factor.
    limit : ndarray (b, m)
        How far each virtual control may move either way.
    expected : ndarray (b, n, n)
        Mean of ``z z'``: which errors are to be expected (mean square only).
    noise : ndarray (b, n, n)
        Covariance of the measurement noise, whitened like the error.
    control_weight : ndarray (b, m, m)
        Weight R of effort: the mean of ``du' R du`` is added to the size.
    """

    map_values: Array
    input_map: Array
    whitening: Array
    shape: Array
    seen: Array
    growth: Array
    limit: Array
    expected: Array
    noise: Array
    control_weight: Array


@dataclass(frozen=True)
class Scaling:
    """How the program's variables relate to physical ones.

    Attributes
    ----------
    size : ndarray (b,)
        The unit of ``rho``: the largest size without compensation at a node.
    gain : ndarray (b, m, m)
        ``K = gain @ K~``: G^-T times the square root of the unit.
    rhat : ndarray (b, k, U, n)
        Scaled ``E1^(1/2) r``.
    O : ndarray (b, k, n, m)
    """

    size: Array
    gain: Array
    rhat: Array
    O: Array


def scale(data: BeatData) -> Scaling:
    """Bring the data of a batch of beats to order one."""
    root = ellipsoid.root(data.shape)
    rhat = np.einsum("bij,bkuj->bkui", root, data.map_values)
    size = np.einsum("bkui,bkui->bku", rhat, rhat).max((1, 2))
    size = np.maximum(size, np.finfo(float).tiny)
    effort = _dominating(np.einsum("bkji,bjl,bklm->bkim", data.input_map, data.shape, data.input_map))
    effort = effort + data.control_weight
    # each control in its own unit first: newtons beside radians would drown in the rounding of the others
    unit = 1.0 / np.sqrt(np.maximum(np.diagonal(effort, axis1=1, axis2=2), np.finfo(float).tiny))
    effort = effort * unit[:, :, None] * unit[:, None, :] + 1e-12 * np.eye(effort.shape[-1])
    inverse = np.linalg.inv(np.linalg.cholesky(effort))
    gain = unit[:, :, None] * np.swapaxes(inverse, 1, 2)
    return Scaling(
        size=size,
        gain=gain * np.sqrt(size)[:, None, None],
        rhat=rhat / np.sqrt(size)[:, None, None, None],
        O=root[:, None] @ data.input_map @ gain[:, None],
    )


def program_data(structure_: sos.Structure, data: BeatData, scaling: Scaling, size: Size, limits: Limits) -> sos.Data:
    """Data of the program of :func:`structure` for a batch of beats.

    Parameters
    ----------
    structure_ : sos.Structure
    data : BeatData
    scaling : Scaling
    size, limits
        As given to :func:`structure`.

    Returns
    -------
    sos.Data
        With batch axis (b,).
    """
    beats, vertices, _, n = data.map_values.shape
    m = data.input_map.shape[-1]
    nodes = structure_.nodes("tube/0")
    S, K = structure_.variable("S"), structure_.variable("K")
    objective = np.zeros((beats, structure_.size))
    quadratic = _quadratic_forms(nodes)
    linear = np.zeros((beats, vertices, len(nodes), structure_.size))
    cross = np.einsum("bkui,bkim->bkum", scaling.rhat, scaling.O)
    linear[..., K.slice] = (-2.0 * cross[..., None] * nodes[:, None, :]).reshape(*cross.shape[:3], m * n)
    if size == "mean-square":
        N = structure_.variable("N")
        linear[..., N.slice] = quadratic
        objective[:, N.slice] = _inner_product(data.expected)
        objective[:, S.slice] = _inner_product(data.expected + data.noise)
    else:
        rho = structure_.variable("rho")
        linear[..., rho.index] = 1.0
        linear[..., S.slice] = -quadratic
        objective[:, rho.index] = 1.0
    constant = -np.einsum("bkui,bkui->bku", scaling.rhat, scaling.rhat)
    constraints: dict[str, tuple[Array, ...]] = {f"tube/{k}": (constant[:, k], linear[:, k]) for k in range(vertices)}
    constraints["effort"] = _effort(structure_.size, S, K)
    constraints |= _limit_data(structure_, data, scaling, limits)
    return structure_.data(objective=objective, constraints=constraints)


def gains(values: Array, data: BeatData, scaling: Scaling) -> Array:
    """Physical gains of a part, ndarray (b, m, n): SI errors to increments of the virtual controls.

    Parameters
    ----------
    values : ndarray (b, m, n)
        The variable ``K`` of the solution.
    """
    return np.asarray(scaling.gain @ values @ np.linalg.inv(data.whitening))


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
    linear = -_quadratic_forms(np.einsum("bij,bkuj->bkui", unit, end))
    form = np.zeros((structure_.size, n, n))
    rows, columns = np.indices((n, n))
    form[E.index, rows, columns] = 1.0
    constraints: dict[str, tuple[Array, ...]] = {f"tube/{k}": (np.ones(nodes), linear[:, k]) for k in range(vertices)}
    constraints["volume"] = (np.zeros((n, n)), form)
    return structure_.data(objective=np.zeros(structure_.size), constraints=constraints), unit


def _dominating(forms: Array) -> Array:
    """A quadratic form above each of several: their mean plus what sticks out. (b, k, m, m) to (b, m, m)."""
    mean = forms.mean(1)
    values, vectors = np.linalg.eigh(forms - mean[:, None])
    beyond = (vectors * np.maximum(values, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return np.asarray(mean + beyond.sum(1))


def _quadratic_forms(points: Array) -> Array:
    """Values of ``z' X z`` at points (..., n), by the packed lower triangle of X: ndarray (..., n (n + 1) / 2)."""
    rows, columns = np.tril_indices(points.shape[-1])
    return np.asarray(points[..., rows] * points[..., columns] * np.where(rows == columns, 1.0, 2.0))


def _inner_product(matrix: Array) -> Array:
    """Coefficients of ``tr(X matrix)`` in the packed lower triangle of X: ndarray (b, n (n + 1) / 2)."""
    rows, columns = np.tril_indices(matrix.shape[-1])
    return np.asarray(matrix[:, rows, columns] * np.where(rows == columns, 1.0, 2.0))


def _effort(variables: int, S: sos.Variable, K: sos.Variable) -> tuple[Array, Array]:
    """The matrix inequality [[S, K'], [K, I]]."""
    m, n = K.shape
    constant = np.zeros((n + m, n + m))
    constant[n:, n:] = np.eye(m)
    linear = np.zeros((variables, n + m, n + m))
    rows, columns = np.indices((n, n))
    linear[S.index, rows, columns] = 1.0
    rows, columns = np.indices((m, n))
    linear[K.index, n + rows, columns] = 1.0
    linear[K.index, columns, n + rows] = 1.0
    return constant, linear


def _limit_data(
    structure_: sos.Structure, data: BeatData, scaling: Scaling, limits: Limits
) -> dict[str, tuple[Array, ...]]:
    """Limits of each control, where the law sees them: on the error with its measurement error."""
    beats, m, _ = scaling.gain.shape
    n = data.whitening.shape[-1]
    K = structure_.variable("K")
    relative = scaling.gain / data.limit[:, :, None]
    out: dict[str, tuple[Array, ...]] = {}
    if limits == "box":
        signs = np.array([(1.0, *s) for s in itertools.product((1.0, -1.0), repeat=n - 1)])
        vertices = signs * data.seen[:, None, :]
        points = np.einsum("bij,bvj->bvi", np.linalg.inv(data.whitening), vertices)
        points = np.concatenate([points, -points], axis=1)
        for i in range(m):
            rows = np.zeros((beats, 2 * len(signs), structure_.size))
            rows[..., K.slice] = np.einsum("ba,bvj->bvaj", relative[:, i], points).reshape(beats, -1, m * n)
            out[f"limit/{i}"] = (rows, np.ones(2 * len(signs)))
        return out
    for i in range(m):
        rows = np.zeros((beats, n, structure_.size))
        for j in range(n):
            rows[:, j, K.index[:, j]] = data.growth[:, None] * relative[:, i]
        out[f"limit/{i}"] = (rows, np.zeros(n), np.zeros(structure_.size), np.ones(()))
    return out
