r"""The mean square of the errors to be expected, as a part of the program of a law.

What the end of the beat is expected to cost is :math:`q + 2 p^T\tilde u + |\tilde u|^2` for scaled increments
:math:`\tilde u = \tilde K\varphi(z + v)` (:mod:`aerotube.compensation.expectation`), with v the noise on the
measurement. For a linear law

.. math:: \min\ \mathrm{tr}(N M) + \|\tilde K M_\varphi^{1/2}\|^2 \quad\text{such that}\quad
          z^T N z - q - 2 p^T \tilde K\, E_v\varphi(z + v)

is a sum of squares on the sphere, with M the second moments of the errors to be expected and :math:`M_\varphi` those
of :math:`\varphi(z + v)`. The quadratic form N majorises on the boundary of the set; for a linear map without offset it
is exact and the objective is the mean square, otherwise the objective stands in for it. Where the uncertain
parameters' extremes are taken one by one, N lies above the form at each of them.

A law of higher degree would be judged by how loosely a quadratic form lies above polynomials of degree four and six:
for these the expectation itself is taken, by cubature over normal errors of moments M, to which a small share spread
over the set is added. It is affine in K but for the last term, so that no majorant is needed, and no law of lower
degree, being one of them, has less. Terms of higher degree are charged ten times as if their arguments were spread over
the set. For the steepest law within its limits is a Chebyshev polynomial, which turns back towards the edge of the set
where few errors are expected, and drives away those that come all the same (on the manoeuvre of Table 2 without noise
such cubic laws, charged a third or less, came near to doubling the upper error of linear ones; charged ten times,
cubic and quadratic laws fly better than these with noise and without).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from aerotube import sos
from aerotube.compensation import monomials
from aerotube.compensation.forms import inner_product, law_square, quadratic_forms

if TYPE_CHECKING:
    from aerotube.compensation.law_program import GroupData, Scaling, Shape

Array = NDArray[np.float64]

# What terms of higher degree are charged, as a share of their mean square over the set.
_CAUTION = 10.0


def declare(program: sos.Program, shape: Shape) -> None:
    """Add variables and constraints to a program with a variable ``K``."""
    program.scalar("effort")
    program.norm("effort", size=shape.steps * shape.controls * shape.monomials + 1)
    for s in range(shape.steps if shape.law_degree == 1 else 0):
        program.symmetric(f"N/{s}", shape.states)
        for j in range(shape.means):
            program.sos(f"mean/{s * shape.means + j}", shape.domain, degree=shape.degree)


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
    heard = group.turn @ group.noise @ np.swapaxes(group.turn, -1, -2)
    K, t = compiled.variable("K"), compiled.variable("effort")
    size = scaling.size[:, None, None, None]
    table = monomials.under_noise(group.mean_points, heard, shape.law_degree)
    cross = 2.0 * group.mean_cross @ scaling.gain[:, None, None] / size[..., None]
    constraints: dict[str, tuple[Array, ...]] = {}
    if shape.law_degree > 1:
        by_law = np.einsum("bu,bgcui,bguj->bij", group.mean_weights / shape.means, cross, table, optimize=True)
        objective[:, K.slice] += weight * by_law.reshape(len(by_law), -1)
    else:
        constant = -group.mean_size / size
        linear = np.zeros((*constant.shape, compiled.size))
        by_law = -cross[..., None] * table[:, :, None, :, None, :]
        linear[..., K.slice] = by_law.reshape(*constant.shape, K.size)
        for s in range(shape.steps):
            N = compiled.variable(f"N/{s}")
            linear[:, s, ..., N.slice] = quadratic_forms(compiled.nodes(f"mean/{s * shape.means}"))
            objective[:, N.slice] += weight * inner_product(group.expected[:, s])
            for j in range(shape.means):
                constraints[f"mean/{s * shape.means + j}"] = (constant[:, s, j], linear[:, s, j])
    objective[:, t.index] += weight
    constraints["effort"] = law_square(compiled, t, scaling.mean_root, _law_moments(shape, group, heard))
    return constraints


def _law_moments(shape: Shape, group: GroupData, heard: Array) -> Array:
    """Second moments of the law's monomials of measured errors: ndarray (b, g, M, M)."""
    back = np.swapaxes(group.turn, -1, -2)
    moments = monomials.moments(group.turn @ group.expected @ back + heard, shape.law_degree)
    if shape.law_degree == 1:
        return moments
    spread = group.turn @ (np.eye(shape.states) / (3.0 * shape.states)) @ back
    even = monomials.moments(spread + heard, shape.law_degree)
    curved = even.copy()
    curved[..., : shape.states, :] = curved[..., : shape.states] = 0.0
    return np.asarray(moments + group.least[:, None, None, None] * even + _CAUTION * curved)


def constant(shape: Shape, group: GroupData) -> Array:
    """What the objective leaves out, in its own units: ndarray (b,).

    A law of higher degree's expectation has a part that no law changes; a linear law's is in its majorant.
    """
    weight = dict(shape.weights).get("mean-square", 0.0) / shape.means
    return weight * np.asarray(np.einsum("bu,bgcu->b", group.mean_weights, group.mean_size))
