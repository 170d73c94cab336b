"""Square tiles of a few rows and columns, held in vector registers.

A tile is `LANES` rows by one, two or three vectors of `LANES` numbers. Compiled functions call these with the place of
a tile's first number in a flat array and the distance between its rows. Written as instructions, because a compiler
keeps no array of a dozen vectors in registers by itself; a processor without wide vectors gets narrower ones.
"""

from __future__ import annotations

from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

LANES = 8 if llvm.get_host_cpu_features().get("avx512f", False) else 4
"""Numbers in a vector."""
WIDEST = 3
"""Vectors beside one another in the widest tile: with more, the registers do not hold it."""

_intrinsic: Any = intrinsic
_REAL = ir.DoubleType()
_VECTOR = ir.VectorType(_REAL, LANES)
_FUSED = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
_INTEGER = ir.IntType(32)
_NUMBERED = ir.Constant(ir.VectorType(_INTEGER, LANES), list(range(LANES)))


class _Writer:
    """Writes the instructions of one tile."""

    def __init__(self, context: Any, builder: Any, signature: Any, arguments: Any) -> None:
        self.context, self.builder, self.signature, self.arguments = context, builder, signature, arguments
        self.fused = builder.module.declare_intrinsic(f"llvm.fmuladd.v{LANES}f64", (), _FUSED)
        self.root = builder.module.declare_intrinsic("llvm.sqrt", [_REAL])

    def base(self, at: int) -> Any:
        """Address of an array argument's first number."""
        array = self.context.make_array(self.signature.args[at])(self.context, self.builder, self.arguments[at])
        return array.data

    def place(self, at: int) -> Any:
        """Address that an array argument and the offset after it name."""
        return self.step(self.base(at), self.arguments[at + 1])

    def vector(self, pointer: Any) -> Any:
        return self.builder.load(self.builder.bitcast(pointer, _VECTOR.as_pointer()), align=8)

    def write(self, value: Any, pointer: Any) -> None:
        self.builder.store(value, self.builder.bitcast(pointer, _VECTOR.as_pointer()), align=8)

    def step(self, pointer: Any, by: Any) -> Any:
        by = by if isinstance(by, ir.Value) else ir.Constant(ir.IntType(64), by)
        return self.builder.gep(pointer, [by])

    def spread(self, value: Any) -> Any:
        """A vector of equal numbers."""
        first = self.builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), value, ir.Constant(_INTEGER, 0))
        pattern = ir.Constant(ir.VectorType(_INTEGER, LANES), [0] * LANES)
        return self.builder.shuffle_vector(first, first, pattern)

    def spread_integer(self, value: Any) -> Any:
        """The same of integers."""
        empty = ir.Constant(ir.VectorType(_INTEGER, LANES), ir.Undefined)
        first = self.builder.insert_element(empty, value, ir.Constant(_INTEGER, 0))
        return self.builder.shuffle_vector(first, first, ir.Constant(ir.VectorType(_INTEGER, LANES), [0] * LANES))

    def vector_under(self, pointer: Any, mask: Any) -> Any:
        """A vector with zeros, and nothing read, where the mask is not set."""
        kinds = [_VECTOR.as_pointer(), _INTEGER, ir.VectorType(ir.IntType(1), LANES), _VECTOR]
        masked = self.builder.module.declare_intrinsic(
            f"llvm.masked.load.v{LANES}f64.p0", (), ir.FunctionType(_VECTOR, kinds)
        )
        place = self.builder.bitcast(pointer, _VECTOR.as_pointer())
        return self.builder.call(masked, [place, ir.Constant(_INTEGER, 8), mask, ir.Constant(_VECTOR, [0.0] * LANES)])

    def pick(self, vector: Any, lane: int) -> Any:
        return self.builder.extract_element(vector, ir.Constant(_INTEGER, lane))

    def rows(self, pointer: Any, stride: Any) -> list[Any]:
        """Addresses of the rows of a tile."""
        found = [pointer]
        for _ in range(LANES - 1):
            found.append(self.step(found[-1], stride))
        return found

    def load_tile(self, pointer: Any, stride: Any, wide: int) -> list[list[Any]]:
        return [
            [self.vector(self.step(row, v * LANES)) for v in range(wide)] for row in self.rows(pointer, stride)
        ]  # fmt: skip

    def store_tile(self, tile: list[list[Any]], pointer: Any, stride: Any) -> None:
        for row, values in zip(self.rows(pointer, stride), tile, strict=True):
            for v, value in enumerate(values):
                self.write(value, self.step(row, v * LANES))

    def accumulate(
        self, tile: list[list[Any]], left: Any, left_stride: Any, right: Any, right_stride: Any, count: Any, sign: int
    ) -> list[list[Any]]:
        """Tile + sign * left' right, left (count, LANES) and right (count, wide)."""
        builder, wide = self.builder, len(tile[0])
        entry, head = builder.block, builder.append_basic_block("head")
        body, done = builder.append_basic_block("body"), builder.append_basic_block("done")
        builder.branch(head)
        builder.position_at_end(head)
        k, a, b = (builder.phi(x.type) for x in (count, left, right))
        sums = [[builder.phi(_VECTOR) for _ in row] for row in tile]
        builder.cbranch(builder.icmp_signed("<", k, count), body, done)
        builder.position_at_end(body)
        columns = [self.vector(self.step(b, v * LANES)) for v in range(wide)]
        new = []
        for r in range(LANES):
            value = builder.load(self.step(a, r))
            value = self.spread(builder.fneg(value) if sign < 0 else value)
            new.append([builder.call(self.fused, [value, columns[v], sums[r][v]]) for v in range(wide)])
        after = builder.add(k, ir.Constant(count.type, 1))
        a_after, b_after = self.step(a, left_stride), self.step(b, right_stride)
        end = builder.block
        builder.branch(head)
        for phi, first, later in ((k, ir.Constant(count.type, 0), after), (a, left, a_after), (b, right, b_after)):
            phi.add_incoming(first, entry)
            phi.add_incoming(later, end)
        for r in range(LANES):
            for v in range(wide):
                sums[r][v].add_incoming(tile[r][v], entry)
                sums[r][v].add_incoming(new[r][v], end)
        builder.position_at_end(done)
        return sums

    def solve(self, tile: list[list[Any]], corner: Any, stride: Any, inverses: Any) -> list[list[Any]]:
        """R'^-1 tile, for the upper triangle R at `corner` with the inverses of its diagonal."""
        builder, out = self.builder, list[list[Any]]()
        triangle = self.rows(corner, stride)
        for j in range(LANES):
            own = tile[j]
            for i in range(j):
                factor = self.spread(builder.fneg(builder.load(self.step(triangle[i], j))))
                own = [builder.call(self.fused, [factor, x, y]) for x, y in zip(out[i], own, strict=True)]
            inverse = self.spread(builder.load(self.step(inverses, j)))
            out.append([builder.fmul(x, inverse) for x in own])
        return out


def _zeros(wide: int) -> list[list[Any]]:
    return [[ir.Constant(_VECTOR, [0.0] * LANES)] * wide for _ in range(LANES)]


def _make_hadamard(wide: int) -> Any:
    @_intrinsic
    def hadamard(
        context: Any, x: Any, x_at: Any, x_column: Any, y: Any, y_at: Any, y_column: Any, row: Any, k: Any,
        c: Any, c_at: Any, c_row: Any, begin: Any,
    ) -> Any:  # fmt: skip
        def generate(ctx: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            w = _Writer(ctx, builder, signature, arguments)
            stride, count = arguments[6], arguments[7]
            first, second = (
                w.accumulate(_zeros(wide), w.place(at), stride, w.step(w.base(at), arguments[at + 2]), stride, count, 1)
                for at in (0, 3)
            )
            out, row_stride = w.place(8), arguments[10]
            fresh = builder.icmp_signed("!=", arguments[11], ir.Constant(arguments[11].type, 0))
            with builder.if_else(fresh) as (then, otherwise):
                with then:
                    tile = [
                        [builder.fmul(p, q) for p, q in zip(a, b, strict=True)]
                        for a, b in zip(first, second, strict=True)
                    ]
                    w.store_tile(tile, out, row_stride)
                with otherwise:
                    before = w.load_tile(out, row_stride, wide)
                    tile = [
                        [builder.call(w.fused, [p, q, s]) for p, q, s in zip(a, b, c, strict=True)]
                        for a, b, c in zip(first, second, before, strict=True)
                    ]
                    w.store_tile(tile, out, row_stride)
            return ctx.get_dummy_value()

        return types.void(x, x_at, x_column, y, y_at, y_column, row, k, c, c_at, c_row, begin), generate

    return hadamard


def _make_eliminate(wide: int) -> Any:
    @_intrinsic
    def eliminate(
        context: Any, a: Any, rows_at: Any, tile_at: Any, corner_at: Any, above_at: Any, row: Any, k: Any,
        inverses: Any, inverses_at: Any,
    ) -> Any:  # fmt: skip
        def generate(ctx: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            w = _Writer(ctx, builder, signature, arguments)
            base, stride = w.base(0), arguments[5]
            left, out, corner, right = (w.step(base, arguments[at]) for at in (1, 2, 3, 4))
            tile = w.accumulate(w.load_tile(out, stride, wide), left, stride, right, stride, arguments[6], -1)
            w.store_tile(w.solve(tile, corner, stride, w.place(7)), out, stride)
            return ctx.get_dummy_value()

        return types.void(a, rows_at, tile_at, corner_at, above_at, row, k, inverses, inverses_at), generate

    return eliminate


def _counted(builder: Any, count: Any) -> Any:
    """Loop over whole vectors of a row of `count` numbers."""
    return cgutils.for_range_slice(
        builder, ir.Constant(count.type, 0), count, ir.Constant(count.type, LANES), count.type
    )  # fmt: skip


@_intrinsic
def add_scaled_row(
    context: Any, x: Any, x_at: Any, y: Any, y_at: Any, factor: Any, count: Any, out: Any, out_at: Any
) -> Any:
    """Out = x + factor * y for `count` numbers, and zero up to a whole number of vectors."""

    def generate(ctx: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        w = _Writer(ctx, builder, signature, arguments)
        left, right, target = w.place(0), w.place(2), w.place(6)
        scale, count = w.spread(arguments[4]), arguments[5]
        narrow = builder.trunc(count, _INTEGER)
        with _counted(builder, count) as (k, _):
            rest = builder.sub(narrow, builder.trunc(k, _INTEGER))
            mask = builder.icmp_signed("<", _NUMBERED, w.spread_integer(rest))
            first, second = (w.vector_under(w.step(p, k), mask) for p in (left, right))
            w.write(builder.call(w.fused, [scale, second, first]), w.step(target, k))
        return ctx.get_dummy_value()

    return types.void(x, x_at, y, y_at, factor, count, out, out_at), generate


@_intrinsic
def subtract_rows(context: Any, a: Any, at: Any, row: Any, count: Any, x: Any, x_at: Any, factors_at: Any) -> Any:
    """Subtract from `count` numbers of x those of `LANES` rows of a times as many factors, which lie in x as well."""

    def generate(ctx: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        w = _Writer(ctx, builder, signature, arguments)
        rows, target = w.rows(w.place(0), arguments[2]), w.place(4)
        factors = w.step(w.base(4), arguments[6])
        spread = [w.spread(builder.fneg(builder.load(w.step(factors, r)))) for r in range(LANES)]
        with _counted(builder, arguments[3]) as (k, _):
            place = w.step(target, k)
            sums = [w.vector(place), ir.Constant(_VECTOR, [0.0] * LANES)]
            for r in range(LANES):
                sums[r % 2] = builder.call(w.fused, [spread[r], w.vector(w.step(rows[r], k)), sums[r % 2]])
            w.write(builder.fadd(*sums), place)
        return ctx.get_dummy_value()

    return types.void(a, at, row, count, x, x_at, factors_at), generate


@_intrinsic
def subtract_products(context: Any, a: Any, at: Any, row: Any, count: Any, x: Any, x_at: Any, out_at: Any) -> Any:
    """Subtract from `LANES` numbers of x the products of as many rows of a with `count` others of x."""

    def generate(ctx: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        w = _Writer(ctx, builder, signature, arguments)
        rows, right = w.rows(w.place(0), arguments[2]), w.place(4)
        out = w.step(w.base(4), arguments[6])
        rooms = [cgutils.alloca_once_value(builder, ir.Constant(_VECTOR, [0.0] * LANES)) for _ in range(LANES)]
        with _counted(builder, arguments[3]) as (k, _):
            column = w.vector(w.step(right, k))
            for r in range(LANES):
                value = builder.call(w.fused, [w.vector(w.step(rows[r], k)), column, builder.load(rooms[r])])
                builder.store(value, rooms[r])
        add = builder.module.declare_intrinsic(
            f"llvm.vector.reduce.fadd.v{LANES}f64", (), ir.FunctionType(_REAL, [_REAL, _VECTOR])
        )
        for r in range(LANES):
            total = builder.call(add, [ir.Constant(_REAL, 0.0), builder.load(rooms[r])], fastmath=("reassoc",))
            place = w.step(out, r)
            builder.store(builder.fsub(builder.load(place), total), place)
        return ctx.get_dummy_value()

    return types.void(a, at, row, count, x, x_at, out_at), generate


def _make_corner_solve(transposed: bool) -> Any:
    @_intrinsic
    def corner_solve(
        context: Any, a: Any, at: Any, row: Any, inverses: Any, inverses_at: Any, x: Any, x_at: Any
    ) -> Any:
        def generate(ctx: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            w = _Writer(ctx, builder, signature, arguments)
            rows, inverse, place = w.rows(w.place(0), arguments[2]), w.place(3), w.place(5)
            found: dict[int, Any] = {}
            for r in range(LANES) if transposed else reversed(range(LANES)):
                value = builder.load(w.step(place, r))
                for q, known in found.items():
                    factor = builder.load(w.step(rows[q], r) if transposed else w.step(rows[r], q))
                    value = builder.fsub(value, builder.fmul(factor, known, flags=("contract",)), flags=("contract",))
                found[r] = builder.fmul(value, builder.load(w.step(inverse, r)))
            for r, value in found.items():
                builder.store(value, w.step(place, r))
            return ctx.get_dummy_value()

        return types.void(a, at, row, inverses, inverses_at, x, x_at), generate

    return corner_solve


solve_corner, solve_corner_transposed = _make_corner_solve(False), _make_corner_solve(True)
hadamard1, hadamard2, hadamard3 = (_make_hadamard(wide) for wide in range(1, WIDEST + 1))
eliminate1, eliminate2, eliminate3 = (_make_eliminate(wide) for wide in range(1, WIDEST + 1))


@_intrinsic
def corner(context: Any, a: Any, tile_at: Any, above_at: Any, row: Any, k: Any, inverses: Any, inverses_at: Any) -> Any:
    """Factor a tile on the diagonal, less what the k rows above take from it: upper triangle, zeros below.

    Writes the inverses of the diagonal; False if a pivot is not positive.
    """

    def generate(ctx: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        w = _Writer(ctx, builder, signature, arguments)
        base, stride = w.base(0), arguments[3]
        out, above, inverse_at = w.step(base, arguments[1]), w.step(base, arguments[2]), w.place(5)
        tile = w.accumulate(w.load_tile(out, stride, 1), above, stride, above, stride, arguments[4], -1)
        rows, good = [row[0] for row in tile], ir.Constant(ir.IntType(1), 1)
        for j in range(LANES):
            pivot = w.pick(rows[j], j)
            good = builder.and_(good, builder.fcmp_ordered(">", pivot, ir.Constant(_REAL, 0.0)))
            inverse = builder.fdiv(ir.Constant(_REAL, 1.0), builder.call(w.root, [pivot]))
            builder.store(inverse, w.step(inverse_at, j))
            rows[j] = builder.fmul(rows[j], w.spread(inverse))
            for i in range(j + 1, LANES):
                factor = w.spread(builder.fneg(w.pick(rows[j], i)))
                rows[i] = builder.call(w.fused, [factor, rows[j], rows[i]])
        nothing = ir.Constant(_VECTOR, [0.0] * LANES)
        for j in range(LANES):
            keep = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [int(i >= j) for i in range(LANES)])
            rows[j] = builder.select(keep, rows[j], nothing)
        w.store_tile([[row] for row in rows], out, stride)
        return good

    return types.boolean(a, tile_at, above_at, row, k, inverses, inverses_at), generate
