r"""The terminal ellipsoid and the law in one program, where size is more than the least rho of a given shape.

With :math:`x^+ = C_\sigma(K)\,\psi(z)`, C affine in the law, :math:`W = E^{-1}` and a symmetric Q for every extreme
:math:`\sigma`,

.. math:: \begin{bmatrix} Q & C^T \\ C & W \end{bmatrix} \succeq 0, \qquad 1 - \psi^T Q\, \psi \in \Sigma

on the sphere put :math:`x^+` into the ellipsoid :math:`x^T W^{-1} x \le 1`, convex in W and K together (the Schur
complement of the matrix :math:`[[W, x^+], [x^{+T}, 1]]`). Errors are measured in the metric E1, in which the trace of
W is the sum of the squares of the semi-axes. The volume, :math:`\log\det W`, is concave; it falls from round to round
where each minimises its tangent :math:`\mathrm{tr}(W_k^{-1} W)` at the W of the round before.

Noise on the measurement moves the end by :math:`B K v`, of covariance :math:`V_u = B K V K^T B^T` (V of the monomials
of the noise). What is made small is the trace or the volume of :math:`W + V_u`: the errors at their worst and the
noise in the mean, as in the worst case.

The map enters by its best fit of degree two (in more than four errors: one), which is enough to find a law by. What
the law then does is measured on the sampled closed loop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.compensation import monomials
from aerotube.compensation.forms import inner_product, law_square, quadratic_forms
from aerotube.tube import ellipsoid

if TYPE_CHECKING:
    from aerotube.compensation.law_program import GroupData, Scaling, Shape

Array = NDArray[np.float64]


def fit_degree(states: int) -> int:
    """Degree of the fit of the map, and the highest of a law."""
    return 2 if states <= 4 else 1


def _features(points: Array) -> Array:
    """Psi (..., P): the law's monomials first. On a sphere those of degree two hold the constant."""
    n = points.shape[-1]
    table = monomials.values(points, monomials.exponents(n, fit_degree(n)))
    if fit_degree(n) > 1:
        return table
    return np.concatenate([table, np.ones_like(table[..., :1])], axis=-1)


def _features_count(states: int) -> int:
    return len(monomials.exponents(states, fit_degree(states))) + (fit_degree(states) == 1)


def declare(program: sos.Program, shape: Shape) -> None:
    """Add variables and constraints to a program with a variable ``K``."""
    count = _features_count(shape.states)
    for s in range(shape.steps):
        program.symmetric(f"W/{s}", shape.states)
    for j in range(shape.steps * shape.vertices):
        program.symmetric(f"Q/{j}", count)
        program.lmi(f"shape/{j}", size=count + shape.states)
        program.sos(f"inside/{j}", sos.Sphere(shape.states), degree=max(2 * fit_degree(shape.states), 2))
    if shape.noisy:
        program.scalar("heard")
        program.norm("heard", size=shape.steps * shape.controls * shape.monomials + 1)


def data(
    compiled: sos.Structure,
    shape: Shape,
    group: GroupData,
    scaling: Scaling,
    points: Array,
    weight: float,
    objective: Array,
) -> dict[str, tuple[Array, ...]]:
    """Data of the constraints for a batch; adds to the objective (b, variables) in place."""
    n, count, K = shape.states, _features_count(shape.states), compiled.variable("K")
    m, M = K.shape
    batch = len(objective)
    fit = np.linalg.pinv(_features(points))
    inside = np.einsum("bgij,uj->bgui", group.turn, compiled.nodes("inside/0"))
    quadratic = quadratic_forms(_features(inside))
    rows, columns = np.indices((count, count))
    corner, corner_columns = np.indices((n, n)) + count
    constraints: dict[str, tuple[Array, ...]] = {}
    for s in range(shape.steps):
        objective[:, compiled.variable(f"W/{s}").slice] += weight * inner_product(group.direction[:, s])
    for j in range(shape.steps * shape.vertices):
        s, v = divmod(j, shape.vertices)
        Q, W = compiled.variable(f"Q/{j}"), compiled.variable(f"W/{s}")
        C = np.swapaxes(fit[:, s] @ scaling.rhat[:, s, v], 1, 2)
        constant = np.zeros((batch, count + n, count + n))
        constant[:, count:, :count], constant[:, :count, count:] = C, np.swapaxes(C, 1, 2)
        linear = np.zeros((batch, compiled.size, count + n, count + n))
        linear[:, Q.index, rows, columns] = 1.0
        linear[:, W.index, corner, corner_columns] = 1.0
        for a in range(m):
            for p in range(M):
                linear[:, K.index[a, p], count:, p] += scaling.O[:, s, v, :, a]
                linear[:, K.index[a, p], p, count:] += scaling.O[:, s, v, :, a]
        constraints[f"shape/{j}"] = (constant, linear)
        held = np.zeros((batch, quadratic.shape[2], compiled.size))
        held[..., Q.slice] = -quadratic[:, s]
        constraints[f"inside/{j}"] = (np.ones(quadratic.shape[2]), held)
    if shape.noisy:
        t = compiled.variable("heard")
        objective[:, t.index] += weight
        forms = np.swapaxes(scaling.O, -1, -2) @ group.direction[:, :, None] @ scaling.O
        constraints["heard"] = law_square(compiled, t, ellipsoid.root(forms.mean(2)), _noise_moments(shape, group))
    return constraints


def _noise_moments(shape: Shape, group: GroupData) -> Array:
    """Second moments of the law's monomials of the noise alone: ndarray (b, g, M, M)."""
    return monomials.moments(group.turn @ group.noise @ np.swapaxes(group.turn, -1, -2), shape.law_degree)


def direction(shape: Shape, solution: sos.Solution, group: GroupData, scaling: Scaling) -> Array:
    """Weights of the next round: the tangent of the volume at what was found, of the size of the first round's."""
    before = group.direction
    found = np.stack([solution[f"W/{s}"] for s in range(shape.steps)], axis=1)
    if shape.noisy:
        moved = scaling.O @ solution["K"][:, None, None]
        found = found + (moved @ _noise_moments(shape, group)[:, :, None] @ np.swapaxes(moved, -1, -2)).mean(2)
    least = np.linalg.eigvalsh(np.nan_to_num(found)).min(axis=(1, 2))
    good = np.asarray(np.isfinite(found).all((1, 2, 3)) & (least > 0))
    W = np.where(good[:, None, None, None], found, np.eye(shape.states))
    W = W + 1e-9 * np.trace(W, axis1=-2, axis2=-1)[..., None, None] * np.eye(shape.states)
    size = np.linalg.det(W) ** (1.0 / shape.states)
    return np.asarray(np.where(good[:, None, None, None], np.linalg.inv(W) * size[..., None, None], before))
