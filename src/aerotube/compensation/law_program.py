r"""The exact-map program of a law that serves one beat or a few, and its data for many.

In whitened errors z (the initial ellipsoid is the unit ball) the error at the end of a beat is
:math:`x^+ = r(z, \sigma) + B_\sigma\hat a`, the law :math:`\hat a = K \varphi(z)` with the monomials
:math:`\varphi` of degree one and more, and its size in the metric :math:`E_1`

.. math:: x^{+T} E_1 x^+ \le \hat r^T \hat r + 2\,\hat r^T O_\sigma \tilde K \varphi
          + \varphi^T \tilde K^T \tilde K \varphi,

with :math:`\hat r = E_1^{1/2} r`, :math:`GG^T \succeq B_\sigma^T E_1 B_\sigma` (equal where B does not depend on
the parameters; effort may be added), :math:`\tilde K = G^T K` and :math:`O_\sigma = E_1^{1/2} B_\sigma G^{-T}`,
whose columns are orthonormal where no effort is added. What is made small is a sum, with weights, of

* the worst case: :math:`\rho_1` such that
  :math:`\rho_1 - \varphi^T S \varphi - \hat r^T\hat r - 2\hat r^T O\tilde K \varphi` is a sum of squares on the
  sphere for every extreme :math:`\sigma`, where
  :math:`\begin{bmatrix} S & \tilde K^T \\ \tilde K & I \end{bmatrix} \succeq 0` (exact at an optimum; effort
  included). Noise on the measurement adds :math:`\mathrm{tr}(S V)`, so that with noise it is the worst case over the
  errors of the mean over the noise;
* the mean square of the errors to be expected, see :mod:`aerotube.compensation.mean_square`;
* the trace or the volume of the terminal ellipsoid itself, see :mod:`aerotube.compensation.joint_shape`.

A law that is reused serves g beats: the programs of one beat are put side by side and share K. Their mean squares add
up; the worst case is that of all.

The map without compensation enters by its values at the program's nodes; the control, linearly, by its derivative
at zero error. What the law then does is measured on the sampled closed loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.compensation import joint_shape, limits, mean_square, monomials
from aerotube.compensation.forms import inner_product, quadratic_forms
from aerotube.tube import ellipsoid

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Shape:
    """What the structure of a program depends on.

    Attributes
    ----------
    states, controls : int
        n and m of the part.
    vertices : int
        k, the number of extreme parameter values, for each of the carried errors.
    carried : int
        Number of errors of the other parts that are carried, one where none is.
    means : int
        c, the number of mean squares that count: for each of the carried errors, over all extremes or at each.
    steps : int
        g, the beats that the law serves.
    law_degree : int
    degree : int
        Of the sum-of-squares constraints on the error, even.
    weights : tuple of (str, float)
        What is made small, and with which weights.
    limits : {"box", "ellipsoid", "none"}
    corners : int
        Of the set of measured errors on which a linear law's limits hold; zero where it is a box.
    noisy : bool
        Whether noise counts where the terminal ellipsoid is found together with the law.
    """

    states: int
    controls: int
    vertices: int
    carried: int
    means: int
    steps: int
    law_degree: int
    degree: int
    weights: tuple[tuple[str, float], ...]
    limits: str
    corners: int = 0
    noisy: bool = False

    @property
    def domain(self) -> sos.Domain:
        """Where sizes are bounded: a linear law's are largest on the boundary of the set, others' in all of it."""
        return sos.Sphere(self.states) if self.law_degree == 1 else sos.Ball(self.states)

    @property
    def monomials(self) -> int:
        """Number M of monomials of the law."""
        return len(monomials.exponents(self.states, self.law_degree))


@lru_cache(maxsize=32)
def structure(shape: Shape) -> sos.Structure:
    """Structure of the program, made once."""
    program = sos.Program()
    sizes, M = dict(shape.weights), shape.monomials
    program.matrix("K", (shape.controls, M))
    if "mean-square" in sizes:
        mean_square.declare(program, shape)
    if "trace" in sizes or "volume" in sizes:
        joint_shape.declare(program, shape)
    if "worst-case" in sizes:
        program.scalar("rho")
        for s in range(shape.steps):
            program.symmetric(f"S/{s}", M)
            program.lmi(f"effort/{s}", size=M + shape.controls)
        for j in range(shape.steps * shape.vertices):
            program.sos(f"worst/{j}", shape.domain, degree=shape.degree)
    limits.declare(program, shape)
    return program.compile()


def nodes(shape: Shape) -> Array:
    """Points (U, n) of the unit sphere or ball at which the error map is sampled; none where expectations will do."""
    sampled = (c.name for c in structure(shape).constraints if c.name.startswith(("mean/", "worst/", "inside/")))
    name = next(sampled, None)
    return np.zeros((0, shape.states)) if name is None else structure(shape).nodes(name)


@dataclass(frozen=True)
class GroupData:
    """What the programs of a batch of laws are made from; every law serves g beats.

    Attributes
    ----------
    map_values : ndarray (b, g, k, U, n)
        Errors at the end of the beats without compensation, at the nodes, for every extreme
        parameter value.
    input_map : ndarray (b, g, k, n, m)
        Their derivatives with respect to the virtual controls.
    whitening : ndarray (b, g, n, n)
        ``x = T z``.
    metric : ndarray (b, g, n, n)
        E1.
    seen : ndarray (b, n)
        Half-widths of the box of errors as the law sees them: the disturbance box and its measurement error.
    corners : ndarray (b, k, n)
        Of their set, where it is no box.
    growth : ndarray (b,)
        By how much the first beat's ellipsoid must grow to hold all ellipsoids of measured errors, a factor.
    lower, upper : ndarray (b, m)
        How far each virtual control may move; the one negative and the other positive, for a linear law.
    usable : ndarray (b, m) of bool
        Controls that have room; the others' ``input_map`` is zero.
    expected : ndarray (b, g, n, n)
        Mean of ``z z'``: which errors are to be expected (mean square only).
    least : ndarray (b,)
        Share of errors spread evenly over the set, that laws of higher degree are told to expect besides.
    mean_points : ndarray (b, g, U', n)
        Errors in the law's coordinates at which the expected cost is given: at the nodes for a linear law, at those
        of a cubature for others.
    mean_weights : ndarray (b, U')
        Of the cubature, zero for a linear law.
    mean_size : ndarray (b, g, c, U')
        Expected cost without compensation, c of them.
    mean_cross : ndarray (b, g, c, U', m)
        Half its derivative with respect to the virtual controls.
    own : ndarray (b, g, m, m)
        Its second derivative, halved; effort included.
    noise : ndarray (b, g, n, n)
        Covariance of the measurement noise, whitened like the error.
    direction : ndarray (b, g, n, n)
        Weights of the trace of the terminal ellipsoid's inverse shape, see :mod:`aerotube.compensation.joint_shape`.
    effort : ndarray (b, g, m, m)
        Weight R: the mean of ``du' R du`` is added to the size.
    """

    map_values: Array
    input_map: Array
    whitening: Array
    metric: Array
    seen: Array
    corners: Array
    growth: Array
    lower: Array
    upper: Array
    usable: NDArray[np.bool_]
    expected: Array
    least: Array
    mean_points: Array
    mean_weights: Array
    mean_size: Array
    mean_cross: Array
    own: Array
    noise: Array
    direction: Array
    effort: Array

    @cached_property
    def unwhitening(self) -> Array:
        """The law's coordinates are those of its first beat: ``y = unwhitening x``, ndarray (b, n, n)."""
        return np.asarray(np.linalg.inv(self.whitening[:, 0]))

    @cached_property
    def turn(self) -> Array:
        """``y = turn z`` in every beat: ndarray (b, g, n, n)."""
        return self.unwhitening[:, None] @ self.whitening


@dataclass(frozen=True)
class Scaling:
    """How the program's variables relate to physical ones.

    Attributes
    ----------
    size : ndarray (b,)
        The unit of ``rho``: the largest size without compensation at a node (or expected cost at one of a cubature).
    gain : ndarray (b, m, m)
        ``K = gain @ K~``: G^-T times the square root of the unit.
    rhat : ndarray (b, g, k, U, n)
        Scaled ``E1^(1/2) r``.
    O : ndarray (b, g, k, n, m)
    root, mean_root : ndarray (b, g, m, m)
        L, with ``|L K~ phi|^2`` the law's own contribution to the worst case, and to the mean square, in each beat.
    """

    size: Array
    gain: Array
    rhat: Array
    O: Array
    root: Array
    mean_root: Array


def scale(data: GroupData) -> Scaling:
    """Bring the data of a batch to order one."""
    root = ellipsoid.root(data.metric)
    rhat = np.einsum("bgij,bgkuj->bgkui", root, data.map_values, optimize=True)
    size = np.einsum("bgkui,bgkui->bgku", rhat, rhat).max((1, 2, 3), initial=np.finfo(float).tiny)
    if not rhat.shape[3]:
        size = data.mean_size.max((1, 2, 3), initial=np.finfo(float).tiny)
    pushed = root[:, :, None] @ data.input_map
    own = _dominating(np.swapaxes(pushed, -1, -2) @ pushed) + data.effort
    mean = data.own.mean(1)
    # each control in its own unit first: newtons beside radians would drown in the rounding of the others
    unit = 1.0 / np.sqrt(np.maximum(np.diagonal(mean, axis1=1, axis2=2), np.finfo(float).tiny))
    mean = mean * unit[:, :, None] * unit[:, None, :] + 1e-12 * np.eye(mean.shape[-1])
    gain = unit[:, :, None] * np.swapaxes(np.linalg.inv(np.linalg.cholesky(mean)), 1, 2)
    left, right = np.swapaxes(gain, 1, 2)[:, None], gain[:, None]
    return Scaling(
        size=size,
        gain=gain * np.sqrt(size)[:, None, None],
        rhat=rhat / np.sqrt(size)[:, None, None, None, None],
        O=pushed @ gain[:, None, None],
        root=ellipsoid.root(left @ own @ right),
        mean_root=ellipsoid.root(left @ data.own @ right),
    )


def program_data(shape: Shape, data: GroupData, scaling: Scaling) -> sos.Data:
    """Data of the program of :func:`structure` for a batch of laws.

    Parameters
    ----------
    shape : Shape
    data : GroupData
    scaling : Scaling

    Returns
    -------
    sos.Data
        With batch axis (b,).
    """
    compiled = structure(shape)
    objective = np.zeros((len(data.seen), compiled.size))
    constraints: dict[str, tuple[Array, ...]] = {}
    points = np.einsum("bgij,uj->bgui", data.turn, nodes(shape))
    for name, weight in shape.weights:
        make = {"mean-square": mean_square.data, "worst-case": _worst_case}.get(name, joint_shape.data)
        constraints |= make(compiled, shape, data, scaling, points, weight, objective)
    return compiled.data(objective=objective, constraints=constraints | limits.data(compiled, shape, data, scaling))


def _worst_case(
    compiled: sos.Structure,
    shape: Shape,
    data: GroupData,
    scaling: Scaling,
    points: Array,
    weight: float,
    objective: Array,
) -> dict[str, tuple[Array, ...]]:
    table = monomials.values(points, monomials.exponents(shape.states, shape.law_degree))
    constant, linear = _cross_terms(compiled, scaling, table)
    rho, K = compiled.variable("rho"), compiled.variable("K")
    heard = monomials.moments(data.turn @ data.noise @ np.swapaxes(data.turn, -1, -2), shape.law_degree)
    objective[:, rho.index] += weight
    linear[..., rho.index] = 1.0
    constraints: dict[str, tuple[Array, ...]] = {}
    for s in range(shape.steps):
        S = compiled.variable(f"S/{s}")
        objective[:, S.slice] += weight / shape.steps * inner_product(heard[:, s])
        linear[:, s, ..., S.slice] = -quadratic_forms(table[:, s])[:, None]
        constraints[f"effort/{s}"] = _effort(compiled.size, S, K, scaling.root[:, s])
    for j in range(shape.steps * shape.vertices):
        s, v = divmod(j, shape.vertices)
        constraints[f"worst/{j}"] = (constant[:, s, v], linear[:, s, v])
    return constraints


def _cross_terms(compiled: sos.Structure, scaling: Scaling, table: Array) -> tuple[Array, Array]:
    """``-r'r`` and, in the columns of K, ``-2 r'O K~ phi``: ndarrays (b, g, k, U) and (b, g, k, U, variables)."""
    K = compiled.variable("K")
    constant = -np.einsum("bgkui,bgkui->bgku", scaling.rhat, scaling.rhat)
    linear = np.zeros((*constant.shape, compiled.size))
    cross = -2.0 * scaling.rhat @ scaling.O
    linear[..., K.slice] = (cross[..., None] * table[:, :, None, :, None, :]).reshape(*constant.shape, K.size)
    return constant, linear


def coefficients(shape: Shape, values: Array, data: GroupData, scaling: Scaling) -> Array:
    """Coefficients of the laws: monomials of SI errors to increments of the virtual controls.

    Parameters
    ----------
    values : ndarray (b, m, M)
        The variable ``K`` of the solution.

    Returns
    -------
    ndarray (b, m, M)
    """
    return monomials.substituted(scaling.gain @ values, data.unwhitening, shape.law_degree)


def _dominating(forms: Array) -> Array:
    """A quadratic form above each of several: their mean plus what sticks out. (..., k, m, m) to (..., m, m)."""
    mean = forms.mean(-3)
    values, vectors = np.linalg.eigh(forms - mean[..., None, :, :])
    beyond = (vectors * np.maximum(values, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return np.asarray(mean + beyond.sum(-3))


def _effort(variables: int, S: sos.Variable, K: sos.Variable, root: Array) -> tuple[Array, Array]:
    """The matrix inequality [[S, (L K)'], [L K, I]] of a batch; L is (b, m, m)."""
    m, n = K.shape
    constant = np.zeros((n + m, n + m))
    constant[n:, n:] = np.eye(m)
    linear = np.zeros((len(root), variables, n + m, n + m))
    rows, columns = np.indices((n, n))
    linear[:, S.index, rows, columns] = 1.0
    for j in range(n):
        for i in range(m):
            linear[:, K.index[i, j], n:, j] = root[:, :, i]
            linear[:, K.index[i, j], j, n:] = root[:, :, i]
    return constant, linear
