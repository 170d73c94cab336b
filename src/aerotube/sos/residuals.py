"""Residuals of decisions and multipliers against the program's own data, by plain formulas.

These functions share nothing with the solvers: they evaluate the equations as they stand in the program.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from aerotube.sos.basis import Sampling
from aerotube.sos.domain import Array
from aerotube.sos.program import Structure

Arrays = Mapping[str, Mapping[str, Array]]


def gram_values(sampling: Sampling, grams: Sequence[Array]) -> Array:
    """Values (U,) at the nodes of sum_k g_k p_k' Q_k p_k."""
    total = np.zeros(len(sampling.nodes))
    for block, gram in zip(sampling.blocks, grams, strict=True):
        total += block.weights * np.einsum("ui,ij,uj->u", block.rows, gram, block.rows, optimize=True)
    return total


def moment_matrices(sampling: Sampling, functional: Array) -> tuple[Array, ...]:
    """Moment matrices sum_u y_u g_k(z_u) p_k p_k' of a functional y (U,), one for each block."""
    return tuple(block.rows.T @ ((functional * block.weights)[:, None] * block.rows) for block in sampling.blocks)


def matrix_value(arrays: Mapping[str, Array], values: Array) -> Array:
    """F0 + sum_i d_i F_i."""
    return np.asarray(arrays["F0"] + np.tensordot(values, arrays["F"], axes=1))


def adjoint(structure: Structure, arrays: Arrays, multipliers: Mapping[str, Array]) -> Array:
    """Gradient (m,) with respect to d of sum over constraints of <multiplier, constraint value>."""
    total = np.zeros(structure.size)
    for c in structure.constraints:
        a, y = arrays[c.name], multipliers[c.name]
        if c.kind == "sos":
            total += a["C"].T @ y
        elif c.kind in ("lmi", "logdet"):
            total += np.tensordot(a["F"], y, axes=2)
        elif c.kind == "norm":
            total += a["g"] * y[0] + a["A"].T @ y[1:]
        else:
            total -= a["A"].T @ y
    return total


def constant(structure: Structure, arrays: Arrays, multipliers: Mapping[str, Array]) -> float:
    """Sum over constraints of <multiplier, constraint value at d = 0>."""
    total = 0.0
    for c in structure.constraints:
        a, y = arrays[c.name], multipliers[c.name]
        if c.kind == "sos":
            total += float(a["c"] @ y)
        elif c.kind in ("lmi", "logdet"):
            total += float(np.sum(a["F0"] * y))
        elif c.kind == "norm":
            total += float(a["h"] * y[0] + a["b"] @ y[1:])
        else:
            total += float(a["b"] @ y)
    return total


def log_determinants(structure: Structure, arrays: Arrays, values: Array) -> float:
    """Sum of factor * log det over the log-determinant terms; -inf outside their domain."""
    total = 0.0
    for c in structure.constraints:
        if c.kind == "logdet":
            sign, size = np.linalg.slogdet(matrix_value(arrays[c.name], values))
            total += c.factor * size if sign > 0 else -np.inf
    return total


def primal_violation(
    structure: Structure, arrays: Arrays, values: Array, grams: Mapping[str, Sequence[Array]]
) -> float:
    """Largest relative violation of a constraint by d and its Gram matrices.

    Each constraint is measured against the size of its own data and of its terms at d.
    """
    worst = 0.0
    for c in structure.constraints:
        a = arrays[c.name]
        if c.kind == "sos":
            f = a["c"] + a["C"] @ values
            scale = np.max(np.abs(a["c"]), initial=0.0) + np.max(np.abs(a["C"]) @ np.abs(values), initial=0.0)
            fault = float(np.max(np.abs(f - gram_values(structure.sampling(c.name), grams[c.name]))))
            least = [
                np.linalg.eigvalsh(q)[0] * np.max(b.weights) * b.rows.shape[1]
                for q, b in zip(grams[c.name], structure.sampling(c.name).blocks, strict=True)
            ]
            fault += max(0.0, -float(min(least)))
        elif c.kind in ("lmi", "logdet"):
            scale = np.max(np.abs(a["F0"])) + np.max(np.tensordot(np.abs(values), np.abs(a["F"]), axes=1))
            fault = max(0.0, -float(np.linalg.eigvalsh(matrix_value(a, values))[0]))
        elif c.kind == "norm":
            scale = (
                np.abs(a["h"])
                + np.abs(a["g"]) @ np.abs(values)
                + np.max(np.abs(a["b"]) + np.abs(a["A"]) @ np.abs(values))
            )
            fault = max(0.0, float(np.linalg.norm(a["A"] @ values + a["b"]) - a["g"] @ values - a["h"]))
        else:
            scale = np.max(np.abs(a["b"]) + np.abs(a["A"]) @ np.abs(values))
            fault = max(0.0, float(np.max(a["A"] @ values - a["b"])))
        if fault > 0.0:
            worst = max(worst, fault / max(float(scale), np.finfo(float).tiny))
    return worst
