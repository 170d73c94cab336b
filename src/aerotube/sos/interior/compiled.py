"""How the functions of this package are compiled."""

from __future__ import annotations

from typing import Any

from numba import njit

OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}

entry: Any = njit(**OPTIONS)
"""A function that Python calls."""

# Without the wrappers that Python would call, compilation takes half the time.
inner: Any = njit(**{**OPTIONS, "no_cpython_wrapper": True, "no_cfunc_wrapper": True})
"""A function that only compiled functions call."""
