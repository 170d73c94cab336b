"""BLAS and LAPACK inside compiled code, without allocation and without the interpreter.

SciPy's own libraries are bound by name, so that compiled functions which use them can be cached. All matrices here are
C-contiguous; a lower triangle in C order is an upper one in Fortran order, which is what the calls below say.
"""

from __future__ import annotations

from typing import Any

import llvmlite.binding as llvm
import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import get_cython_function_address, intrinsic

from aerotube.sos.interior.compiled import inner, keep_apart

_intrinsic: Any = intrinsic


def _bind(module: str, name: str, arguments: int) -> Any:
    symbol = f"aerotube_{name}"
    llvm.add_symbol(symbol, get_cython_function_address(f"scipy.linalg.{module}", name))
    return types.ExternalFunction(symbol, types.void(*[types.voidptr] * arguments))


_dsyrk = _bind("cython_blas", "dsyrk", 10)
_dgemm = _bind("cython_blas", "dgemm", 13)
_dgemv = _bind("cython_blas", "dgemv", 11)
_dtrsm = _bind("cython_blas", "dtrsm", 11)
_dtrsv = _bind("cython_blas", "dtrsv", 8)
_dpotrf = _bind("cython_lapack", "dpotrf", 5)

_U, _L, _N, _T, _R = (np.uint8(ord(letter)) for letter in "ULNTR")


@_intrinsic
def _ref(context: Any, value: Any) -> Any:
    """Address of a copy of a number, as Fortran routines take their arguments."""

    def generate(ctx: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(cgutils.alloca_once_value(builder, arguments[0]), cgutils.voidptr_t)

    return types.voidptr(value), generate


@_intrinsic
def _data(context: Any, array: Any) -> Any:
    """Address of the first entry of an array."""

    def generate(ctx: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = ctx.make_array(signature.args[0])(ctx, builder, arguments[0]).data
        return builder.bitcast(pointer, cgutils.voidptr_t)

    return types.voidptr(array), generate


@inner
def gram_lower(a, out, beta):  # type: ignore[no-untyped-def]
    """Lower triangle of out = a a' + beta out; a (n, k), out (n, n)."""
    keep_apart()
    n, k, one = np.int32(a.shape[0]), np.int32(a.shape[1]), 1.0
    _dsyrk(_ref(_U), _ref(_T), _ref(n), _ref(k), _ref(one), _data(a), _ref(k), _ref(beta), _data(out), _ref(n))


@inner
def multiply(a, b, out):  # type: ignore[no-untyped-def]
    """Out = a b; a (n, k), b (k, l), out (n, l)."""
    keep_apart()
    n, k, m, one, zero = np.int32(a.shape[0]), np.int32(a.shape[1]), np.int32(b.shape[1]), 1.0, 0.0
    _dgemm(
        _ref(_N), _ref(_N), _ref(m), _ref(n), _ref(k), _ref(one), _data(b), _ref(m), _data(a), _ref(k),
        _ref(zero), _data(out), _ref(m),
    )  # fmt: skip


@inner
def multiply_first_transposed(a, b, out):  # type: ignore[no-untyped-def]
    """Out = a' b; a (k, n), b (k, l), out (n, l)."""
    keep_apart()
    n, k, m, one, zero = np.int32(a.shape[1]), np.int32(a.shape[0]), np.int32(b.shape[1]), 1.0, 0.0
    _dgemm(
        _ref(_N), _ref(_T), _ref(m), _ref(n), _ref(k), _ref(one), _data(b), _ref(m), _data(a), _ref(n),
        _ref(zero), _data(out), _ref(m),
    )  # fmt: skip


@inner
def multiply_second_transposed(a, b, out):  # type: ignore[no-untyped-def]
    """Out = a b'; a (n, k), b (l, k), out (n, l)."""
    keep_apart()
    n, k, m, one, zero = np.int32(a.shape[0]), np.int32(a.shape[1]), np.int32(b.shape[0]), 1.0, 0.0
    _dgemm(
        _ref(_T), _ref(_N), _ref(m), _ref(n), _ref(k), _ref(one), _data(b), _ref(k), _data(a), _ref(k),
        _ref(zero), _data(out), _ref(m),
    )  # fmt: skip


@inner
def times_vector(a, x, out, alpha, beta):  # type: ignore[no-untyped-def]
    """Out = alpha a x + beta out; a (n, k)."""
    keep_apart()
    n, k, step = np.int32(a.shape[0]), np.int32(a.shape[1]), np.int32(1)
    _dgemv(
        _ref(_T), _ref(k), _ref(n), _ref(alpha), _data(a), _ref(k), _data(x), _ref(step), _ref(beta), _data(out),
        _ref(step),
    )  # fmt: skip


@inner
def transposed_times_vector(a, x, out, alpha, beta):  # type: ignore[no-untyped-def]
    """Out = alpha a' x + beta out; a (n, k)."""
    keep_apart()
    n, k, step = np.int32(a.shape[0]), np.int32(a.shape[1]), np.int32(1)
    _dgemv(
        _ref(_N), _ref(k), _ref(n), _ref(alpha), _data(a), _ref(k), _data(x), _ref(step), _ref(beta), _data(out),
        _ref(step),
    )  # fmt: skip


@inner
def cholesky(a):  # type: ignore[no-untyped-def]
    """Overwrite the lower triangle of a by its factor; True if a was positive definite."""
    keep_apart()
    n, info = np.int32(a.shape[0]), np.int32(0)
    result = np.empty(1, np.int32)
    result[0] = info
    _dpotrf(_ref(_U), _ref(n), _data(a), _ref(n), _data(result))
    return result[0] == 0


@inner
def subtract_rows(a, at, row, begin, end, columns):  # type: ignore[no-untyped-def]
    """Subtract from rows begin..end, right of column `begin`, what the rows above take from them.

    Rows of a start at `at` and are `row` numbers apart: a[begin:end] -= a[:begin, begin:end]' a[:begin].
    """
    keep_apart()
    m, n, k = np.int32(columns - begin), np.int32(end - begin), np.int32(begin)
    wide, one, minus = np.int32(row), 1.0, -1.0
    above, out = a[at + begin :], a[at + begin * row + begin :]
    _dgemm(
        _ref(_N), _ref(_T), _ref(m), _ref(n), _ref(k), _ref(minus), _data(above), _ref(wide), _data(above), _ref(wide),
        _ref(one), _data(out), _ref(wide),
    )  # fmt: skip


@inner
def solve_lower_vector(factor, x):  # type: ignore[no-untyped-def]
    """Overwrite x by L^-1 x."""
    keep_apart()
    n, step = np.int32(x.shape[0]), np.int32(1)
    _dtrsv(_ref(_U), _ref(_T), _ref(_N), _ref(n), _data(factor), _ref(n), _data(x), _ref(step))


@inner
def solve_upper_vector(factor, x):  # type: ignore[no-untyped-def]
    """Overwrite x by L^-T x."""
    keep_apart()
    n, step = np.int32(x.shape[0]), np.int32(1)
    _dtrsv(_ref(_U), _ref(_N), _ref(_N), _ref(n), _data(factor), _ref(n), _data(x), _ref(step))
