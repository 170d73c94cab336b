"""Branching by value that works alike on floats, arrays, Taylor polynomials and in compiled code."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import overload

from aerotube.numerics import taylor_model
from aerotube.numerics.taylor import Taylor, choose


def select(condition: Any, if_true: Any, if_false: Any) -> Any:
    """Take `if_true` where the condition holds, `if_false` elsewhere.

    The counterpart of :func:`numpy.where` for code that is written once for floats, arrays,
    :class:`~aerotube.numerics.taylor.Taylor` polynomials and
    :class:`~aerotube.numerics.taylor_model.TaylorModel`. Both alternatives are evaluated by the caller, so
    both must be defined everywhere.

    Parameters
    ----------
    condition : bool, array of bool, shape (...), or Truth
    if_true, if_false : float, array (...), or Taylor or TaylorModel with batch shape (...)

    Returns
    -------
    float, array, Taylor or TaylorModel
        Of the broadcast shape.
    """
    if isinstance(condition, (bool, np.bool_)):
        return if_true if condition else if_false
    if isinstance(if_true, taylor_model.TaylorModel) or isinstance(if_false, taylor_model.TaylorModel):
        return taylor_model.choose(condition, if_true, if_false)
    if isinstance(if_true, Taylor) or isinstance(if_false, Taylor):
        return choose(condition, if_true, if_false)
    return np.where(condition, if_true, if_false)


@overload(select)
def _select_compiled(condition: Any, if_true: Any, if_false: Any) -> Any:
    def choose(condition: Any, if_true: Any, if_false: Any) -> Any:
        if condition:
            return if_true
        return if_false

    return choose
