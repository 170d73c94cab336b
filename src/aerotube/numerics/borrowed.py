"""Arrays lent to compiled code that does not count who holds them."""

from __future__ import annotations

from typing import Any

from numba.core import types
from numba.extending import intrinsic


def _borrowed(typing_context: Any, value: Any) -> Any:
    """The same value, whose arrays are not counted while it is passed on; any nesting of tuples and arrays.

    Compiled code counts, with an atomic operation, every hand that an array goes through. Where small functions hand
    tables about that costs more than reading them, and threads that read the same table wait for one another's count.
    The original must outlive what is made from it: borrow the arguments of a kernel, inside the kernel.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _uncounted(context, builder, signature.args[0], arguments[0])

    return value(value), generate


borrowed: Any = intrinsic(_borrowed)


def _uncounted(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo = context.get_constant_null(types.MemInfoPointer(types.voidptr))
        array.parent = context.get_constant_null(types.pyobject)
        return array._getvalue()
    if isinstance(kind, (types.Tuple, types.UniTuple, types.NamedTuple, types.NamedUniTuple)):
        for place, part in enumerate(kind.types):
            inner = _uncounted(context, builder, part, builder.extract_value(value, place))
            value = builder.insert_value(value, inner, place)
    return value
