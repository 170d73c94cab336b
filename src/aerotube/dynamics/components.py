"""Between arrays, batch first, and components, the form in which equations of motion are written."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Components = tuple[Any, ...]


def split(values: ArrayLike) -> Components:
    """Components of an array (..., n): n contiguous arrays (...)."""
    return tuple(np.ascontiguousarray(np.moveaxis(np.asarray(values, dtype=np.float64), -1, 0)))


def join(parts: Sequence[ArrayLike]) -> Array:
    """Array (..., n) of n components, broadcast against each other."""
    out = np.empty((*np.broadcast_shapes(*(np.shape(part) for part in parts)), len(parts)))
    for i, part in enumerate(parts):
        out[..., i] = part
    return out
