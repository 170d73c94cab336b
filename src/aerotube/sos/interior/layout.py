"""From a structure to flat arrays that compiled code can walk, and the memory of one solve.

Compiled functions take one integer table and one heap of numbers each for the structure and for the state: the few
arguments keep compilation short. The accessors at the end give the parts their names.
"""

from __future__ import annotations

from functools import lru_cache
from math import prod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerotube.sos.basis import sampling
from aerotube.sos.certificate import normal_inverse
from aerotube.sos.domain import Array
from aerotube.sos.interior.compiled import inner
from aerotube.sos.interior.tiles import padded
from aerotube.sos.program import Constraint, Data, Structure

SOS, LMI, NORM, LINEAR = np.arange(4)
_KINDS = {"sos": SOS, "lmi": LMI, "logdet": LMI, "norm": NORM, "linear": LINEAR}
Ints = NDArray[np.int64]

# All places are NumPy integers: plain ones would have every function compiled anew for each of them.

# Rows of Layout.con, one column for each constraint.
KIND, ROWS, VECTOR, FIRST, LAST, COMPACT, FACTOR_AT, FLAT, GROUP, TARGET, FOLD = np.arange(11)
# Rows of Layout.blk, one column for each matrix block (Gram matrix or matrix inequality).
ORDER, MATRIX, BASIS, WEIGHT, OWNER, TURNED = np.arange(6)
# Matrix storages: one entry for each entry of each block.
Q, Z, LQ, LZ, INVERSE, DQ, DZ, E, T, MISFIT, BEST_Q, KEPT_DQ, KEPT_DZ, SCALE, BACK, SURE_Q, NEXT_Q, NEXT_Z = np.arange(
    18
)
# Vector storages: one entry for each node, cone entry and linear row.
Y, DY, S, DS, RESIDUAL, A, K2, W, ROOT, BEST_Y, KEPT_DY, KEPT_DS, SURE_Y, NEXT_Y, NEXT_S = np.arange(18, 33)
# Decision storages, (m + 1) entries.
D, DD, RHS, U2, RD, OBJECTIVE, COLUMN, BEST_D, KEPT_DD, SURE_D, NEXT_D = np.arange(33, 44)
# The rest: data, factors, scratch.
G, V, FACTOR, ROOM, TALL, WIDEQ, SCRATCH, SHORT = np.arange(44, 52)
SCHUR, SCHUR_FACTOR, LOCAL, EXTENT, ROW, NUMBER = np.arange(52, 58)
# Sizes.
M, VECTORS, MATRICES, GROUPS, LENGTH, DEGREE, SPACE, FLATS, TURNS = np.arange(58, 67)
_COUNT = 67


class Layout(NamedTuple):
    """Where everything lies.

    Attributes
    ----------
    con : (11, constraints)
        Kind; rows (U, order, 1 + k, rows); offset in vector storage; first and last + 1 block; offset of its data
        (rows x width, or width x k^2 of a matrix inequality); offset of its Schur factor; offset in a program's flat
        data; first row scale (one for all rows, but one for each linear row); places in `numbers` of its
        log-determinant factor and of the norm of the map from values at the nodes to the least changes of Gram
        matrices that make them.
    blk : (6, blocks)
        Order N; offset in matrix storage; places of P (U x N) and g (U, or -1 for 1) in `numbers`; its constraint;
        place of P' (N x U, rows padded to whole tiles) after Layout.at[TURNS] in `numbers`.
    numbers : (...)
        Bases, weights, starting functionals (vector storage), norms of changes, log-determinant factors.
    at : (67,)
        Offset of each storage in the heap, and the sizes.
    """

    con: Ints
    blk: Ints
    numbers: Array
    at: Ints


class State(NamedTuple):
    """The memory of one solve: numbers, and integers (status and counts, widths, active columns, failures)."""

    heap: Array
    ints: Ints


@lru_cache(maxsize=64)
def layout(structure: Structure) -> Layout:
    """Lay out a structure (cached)."""
    m, constraints = structure.size, structure.constraints
    con = np.zeros((11, len(constraints)), dtype=np.int64)
    blk: list[tuple[int, int, int, int, int, int]] = []
    bases: list[Array] = [np.zeros(0)]
    turned: list[Array] = []
    weights: list[Array] = []
    interior: list[Array] = []
    vectors = matrices = compact = factors = groups = tall = turning = weighing = 0
    flat, degree = m, 0
    for i, c in enumerate(constraints):
        kind = _KINDS[c.kind]
        rows = c.size + 1 if kind == NORM else c.size
        entries = rows * rows if kind == LMI else rows
        con[:9, i] = kind, rows, vectors, len(blk), 0, compact, factors, flat, groups
        compact += (m + 1) * entries
        flat += (m + 1) * entries
        groups += rows if kind == LINEAR else 1
        degree += {SOS: 0, LMI: rows, NORM: 1, LINEAR: rows}[kind]
        if kind != LMI:
            vectors += rows
            interior.append(structure.sampling(c.name).interior if kind == SOS else np.zeros(rows))
        if kind == LMI:
            blk.append((rows, matrices, 0, -1, i, 0))
            matrices += entries
        elif kind == SOS:
            wide = pad(rows)
            factors += wide * (wide + pad(m + 1) + 1)
            for block in structure.sampling(c.name).blocks:
                plain = bool(np.all(block.weights == 1.0))
                blk.append((len(block.basis), matrices, tall, -1 if plain else weighing, i, turning))
                matrices += len(block.basis) ** 2
                tall += block.rows.size
                degree += len(block.basis)
                turning += len(block.basis) * wide
                bases.append(block.rows.ravel())
                turned.append(np.pad(block.rows.T, ((0, 0), (0, wide - rows))).ravel())
                if not plain:
                    weights.append(block.weights)
                    weighing += rows
        con[LAST, i] = len(blk)
    table = np.array(blk, dtype=np.int64).reshape(len(blk), 6).T.copy()
    table[WEIGHT][table[WEIGHT] >= 0] += tall + turning
    con[FOLD] = tall + turning + weighing + vectors + np.arange(len(constraints))
    con[TARGET] = con[FOLD] + len(constraints)
    folds = np.array([_fold(c) if c.kind == "sos" else 0.0 for c in constraints])
    targets = np.array([c.factor for c in constraints])
    sampled = sum(c.kind == "sos" for c in constraints)
    nodes = max([c.size for c in constraints if c.kind == "sos"], default=1)
    order = max([1, *table[ORDER].tolist()])
    widest = max([nodes, order * order, *con[ROWS].tolist()])
    # Scratch for the reduction of one constraint (P' over the factor of Z, that factor's inverse), and
    # for work on one block.
    space = pad(nodes) * order + order * order
    room = max(4 * order * order + widest, pad(order) * (pad(order) + 1))
    lengths = np.array(
        [matrices] * 18 + [vectors] * 15 + [m + 1] * 11
        + [compact, compact, factors, space, pad(nodes) * order, turning, room]
        + [4 * (pad(widest) + m + 1), (m + 1) ** 2, m * m, (m + 1) ** 2 * (1 + sampled), groups * (m + 1), groups, 24]
    )  # fmt: skip
    at = np.zeros(_COUNT, dtype=np.int64)
    # Every storage starts at a multiple of eight numbers, a cache line.
    starts = np.concatenate([[0], np.cumsum(-(-lengths // 8) * 8)])
    at[: len(lengths)] = starts[:-1]
    at[M], at[VECTORS], at[MATRICES], at[GROUPS] = m, vectors, matrices, groups
    at[LENGTH], at[DEGREE], at[SPACE], at[FLATS], at[TURNS] = starts[-1], degree, space, flat, tall
    return Layout(con, table, np.concatenate([*bases, *turned, *weights, *interior, folds, targets]), at)


def pad(count: int) -> int:
    """Round up to whole tiles."""
    return int(padded.py_func(count))


def _fold(c: Constraint) -> float:
    """Norm of the least-norm map from values at the nodes to Gram matrices, by the power method."""
    assert c.domain is not None
    weights = sampling(c.domain, c.degree, c.weights)
    inverse = normal_inverse(c.domain, c.degree, c.weights)
    vector = np.ones(len(weights.nodes))
    for _ in range(30):
        vector = inverse @ (vector / np.linalg.norm(vector))
    return float(np.sqrt(np.linalg.norm(vector)))


def memory(lay: Layout) -> State:
    """Allocate the memory of one solve."""
    constraints = lay.con.shape[1]
    ints = np.zeros(8 + constraints * (int(lay.at[M]) + 3), dtype=np.int64)
    return State(np.zeros(int(lay.at[LENGTH])), ints)


@lru_cache(maxsize=64)
def _plan(structure: Structure) -> tuple[tuple[str, str, int, int, int], ...]:
    """Name, key, start, length and number of axes of every array in a program's flat data."""
    plan, at = [], structure.size
    for c in structure.constraints:
        for key, shape in c.shapes(structure.size).items():
            plan.append((c.name, key, at, prod(shape), len(shape)))
            at += prod(shape)
    return tuple(plan)


def flatten(data: Data, lay: Layout) -> Array:
    """Numbers of all programs of a batch, (programs, flat): the objective, then the arrays of each constraint.

    Raises
    ------
    ValueError
        If a number is not finite, naming the constraint.
    """
    batch, length = data.batch, int(lay.at[FLATS])
    out = np.empty((*batch, length))
    out[..., : data.structure.size] = data.objective
    for name, key, at, size, axes in _plan(data.structure):
        array = data.constraints[name][key]
        out[..., at : at + size] = array.reshape(*array.shape[: array.ndim - axes], size)
    if not np.isfinite(out).all():
        data.check()
    return out.reshape(data.count, length)


@inner
def matrix_at(store, start, rows, columns):  # type: ignore[no-untyped-def]
    """Matrix (rows, columns) inside a flat store."""
    return store[start : start + rows * columns].reshape((rows, columns))


@inner
def block(lay, st, name, b):  # type: ignore[no-untyped-def]
    """Block b of a matrix storage, (N, N)."""
    n, start = lay.blk[ORDER, b], lay.at[name] + lay.blk[MATRIX, b]
    return st.heap[start : start + n * n].reshape((n, n))


@inner
def entries(lay, st, name, b):  # type: ignore[no-untyped-def]
    """Block b of a matrix storage, flat (N^2,)."""
    n, start = lay.blk[ORDER, b], lay.at[name] + lay.blk[MATRIX, b]
    return st.heap[start : start + n * n]


@inner
def failed(lay, st):  # type: ignore[no-untyped-def]
    """Whether a constraint's system could not be factored, (constraints,)."""
    start = 8 + lay.con.shape[1] * (lay.at[M] + 2)
    return st.ints[start : start + lay.con.shape[1]]


@inner
def part(lay, st, name, i):  # type: ignore[no-untyped-def]
    """Constraint i's part of a vector storage, (rows,)."""
    start = lay.at[name] + lay.con[VECTOR, i]
    return st.heap[start : start + lay.con[ROWS, i]]


@inner
def decision(lay, st, name):  # type: ignore[no-untyped-def]
    """A decision storage, (m + 1,)."""
    start = lay.at[name]
    return st.heap[start : start + lay.at[M] + 1]


@inner
def compact(lay, st, name, i):  # type: ignore[no-untyped-def]
    """Constraint i's data (G or V): (rows, width), or (width, entries) of matrix inequalities."""
    rows, width, start = lay.con[ROWS, i], st.ints[8 + i], lay.at[name] + lay.con[COMPACT, i]
    if lay.con[KIND, i] == LMI:
        return st.heap[start : start + width * rows * rows].reshape((width, rows * rows))
    return st.heap[start : start + rows * width].reshape((rows, width))


@inner
def active(lay, st, i):  # type: ignore[no-untyped-def]
    """Decision variables that constraint i holds, in order, and m for its constants."""
    start = 8 + lay.con.shape[1] + i * (lay.at[M] + 1)
    return st.ints[start : start + st.ints[8 + i]]


@inner
def rows_of(lay, b):  # type: ignore[no-untyped-def]
    """P of block b, (U, N)."""
    return matrix_at(lay.numbers, lay.blk[BASIS, b], lay.con[ROWS, lay.blk[OWNER, b]], lay.blk[ORDER, b])


@inner
def turned_of(lay, b):  # type: ignore[no-untyped-def]
    """P' of block b, (N, U) with rows padded to whole tiles."""
    return matrix_at(
        lay.numbers, lay.at[TURNS] + lay.blk[TURNED, b], lay.blk[ORDER, b], padded(lay.con[ROWS, lay.blk[OWNER, b]])
    )


@inner
def weights_of(lay, b):  # type: ignore[no-untyped-def]
    """Weights g of block b, (U,), or empty where they are one."""
    start = lay.blk[WEIGHT, b]
    return lay.numbers[start : start + lay.con[ROWS, lay.blk[OWNER, b]]] if start >= 0 else lay.numbers[:0]


@inner
def tall_of(lay, st, b):  # type: ignore[no-untyped-def]
    """Scratch (U, N) for block b."""
    return matrix_at(st.heap, lay.at[TALL], lay.con[ROWS, lay.blk[OWNER, b]], lay.blk[ORDER, b])


@inner
def wide_of(lay, st, name, b):  # type: ignore[no-untyped-def]
    """Storage (N, U) of block b, rows padded to whole tiles: scratch TALL, or L_Q' P' (WIDEQ), kept for every block."""
    start = lay.at[name] + (lay.blk[TURNED, b] if name == WIDEQ else 0)
    return matrix_at(st.heap, start, lay.blk[ORDER, b], padded(lay.con[ROWS, lay.blk[OWNER, b]]))
