"""Schur complements of sampled constraints, their factors, and trial factors, made tile by tile (see `lanes`).

Orders are padded to whole tiles. All products have the form of a transpose times a matrix, whose rows are contiguous:
the form in which a tile takes one load for each of its vectors and one for each of its rows.
"""

from __future__ import annotations

from aerotube.sos.interior import blas, lanes
from aerotube.sos.interior.compiled import inner, keep_apart
from aerotube.sos.interior.lanes import LANES

PANEL = 64
"""Rows that are factored between two large products."""


@inner
def padded(count):  # type: ignore[no-untyped-def]
    """Least multiple of the tile's size that is not below count."""
    return (count + LANES - 1) // LANES * LANES


@inner
def gram_product(x, x_at, y, y_at, row, k, order, c, c_at, c_row, begin):  # type: ignore[no-untyped-def]
    """Upper tiles of c (+)= (x'x) o (y'y); x, y (k, order) with the same distance between rows."""
    keep_apart()
    for j in range(0, order, 3 * LANES):
        wide = min(3, (order - j) // LANES)
        for i in range(0, j + wide * LANES, LANES):
            # Tiles left of the diagonal are left out.
            first = max(i, j)
            own, at = wide - (first - j) // LANES, c_at + i * c_row + first
            if own == 3:
                lanes.hadamard3(x, x_at + i, x_at + first, y, y_at + i, y_at + first, row, k, c, at, c_row, begin)
            elif own == 2:
                lanes.hadamard2(x, x_at + i, x_at + first, y, y_at + i, y_at + first, row, k, c, at, c_row, begin)
            else:
                lanes.hadamard1(x, x_at + i, x_at + first, y, y_at + i, y_at + first, row, k, c, at, c_row, begin)


@inner
def eliminate_rows(a, a_at, row, begin, end, columns, inverses, inverses_at):  # type: ignore[no-untyped-def]
    """Factor rows begin..end of a matrix from which what is above has been eliminated; False at a bad pivot."""
    keep_apart()
    for j in range(begin, end, LANES):
        k, left = j - begin, a_at + begin * row + j
        own, at = a_at + j * row + j, inverses_at + j
        if not lanes.corner(a, own, left, row, k, inverses, at):
            return False
        c = j + LANES
        while c < columns:
            tile, above = a_at + j * row + c, a_at + begin * row + c
            wide = min(3, (columns - c) // LANES)
            if wide == 3:
                lanes.eliminate3(a, left, tile, own, above, row, k, inverses, at)
            elif wide == 2:
                lanes.eliminate2(a, left, tile, own, above, row, k, inverses, at)
            else:
                lanes.eliminate1(a, left, tile, own, above, row, k, inverses, at)
            c += 3 * LANES
    return True


@inner
def factor(a, a_at, row, order, columns, inverses, inverses_at):  # type: ignore[no-untyped-def]
    """Overwrite a = [H, C] (order, columns) by [R, R'^-1 C], H = R'R; False if H is not positive definite.

    Of H, the upper triangle of tiles is read, and written with zeros below the diagonal of R. Order and columns are
    whole tiles. Also writes the inverses of the diagonal of R.
    """
    keep_apart()
    for j in range(0, order, PANEL):
        end = min(order, j + PANEL)
        if j > 0:
            blas.subtract_rows(a, a_at, row, j, end, columns)
        if not eliminate_rows(a, a_at, row, j, end, columns, inverses, inverses_at):
            return False
    return True


@inner
def divide_by_transpose(a, row, order, inverses, x):  # type: ignore[no-untyped-def]
    """Overwrite x by R'^-1 x, for the factor R in rows of a and the inverses of its diagonal."""
    keep_apart()
    for j in range(0, order, LANES):
        lanes.solve_corner_transposed(a, j * row + j, row, inverses, j, x, j)
        after = j + LANES
        lanes.subtract_rows(a, j * row + after, row, order - after, x, after, j)


@inner
def divide(a, row, order, inverses, x):  # type: ignore[no-untyped-def]
    """Overwrite x by R^-1 x."""
    keep_apart()
    for j in range(order - LANES, -1, -LANES):
        after = j + LANES
        lanes.subtract_products(a, j * row + after, row, order - after, x, after, j)
        lanes.solve_corner(a, j * row + j, row, inverses, j, x, j)


@inner
def longest_step(value, change, most, halvings, room):  # type: ignore[no-untyped-def]
    """A step (not quite the longest) up to `most` that keeps value + step * change positive definite.

    Trial factorisations on a grid that is finer towards long steps; `room` is scratch for a padded matrix and its
    pivots.
    """
    keep_apart()
    if stays(value, change, most, room):
        return most
    low, high, middle = 0.0, most, 0.85 * most
    for _ in range(halvings):
        if stays(value, change, middle, room):
            low = middle
        else:
            high = middle
        middle = 0.5 * (low + high)
    tiny = 0
    while low == 0.0 and tiny < 6:
        high *= 0.1
        tiny += 1
        if stays(value, change, high, room):
            low = high
    return low


@inner
def stays(value, change, step, room):  # type: ignore[no-untyped-def]
    """Whether value + step * change is positive definite."""
    keep_apart()
    n = value.shape[0]
    row = padded(n)
    left, right = value.reshape(n * n), change.reshape(n * n)
    for i in range(n):
        # Left of the diagonal's tile nothing is read.
        first = i // LANES * LANES
        lanes.add_scaled_row(left, i * n + first, right, i * n + first, step, n - first, room, i * row + first)
    for i in range(n, row):
        for j in range(i // LANES * LANES, row):
            room[i * row + j] = 0.0
        room[i * (row + 1)] = 1.0
    return eliminate_rows(room, 0, row, 0, row, row, room, row * row)
