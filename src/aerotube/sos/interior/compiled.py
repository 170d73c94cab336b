"""How the functions of this package are compiled."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numba import njit, types
from numba.extending import intrinsic

OPTIONS: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    # Sums may be added up in any order, as vectors do; not a number stays not a number.
    "fastmath": {"reassoc", "contract", "nsz"},
}

entry: Any = njit(**OPTIONS)
"""A function that Python calls."""

# Without the wrappers that Python would call, compilation takes half the time.
inner: Any = njit(**{**OPTIONS, "no_cpython_wrapper": True, "no_cfunc_wrapper": True})
"""A function that only compiled functions call."""


_intrinsic: Any = intrinsic


@_intrinsic
def keep_apart(context: Any) -> Any:
    """Keep the function that calls this from being inlined: large ones would be compiled again wherever used."""

    def generate(ctx: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.function.attributes.add("noinline")
        return ctx.get_dummy_value()

    return types.void(), generate


def forget_stale_code(folder: Path) -> None:
    """Delete compiled code in a folder's cache if any source file of the folder has changed since it was made.

    The compiler's own cache looks at the file of each function alone, and would keep code that has older versions of
    other files' functions and constants built in.
    """
    cache = folder / "__pycache__"
    stamp = repr([(p.name, p.stat().st_size, p.stat().st_mtime_ns) for p in sorted(folder.glob("*.py"))])
    record = cache / "compiled-from.txt"
    if record.is_file() and record.read_text() == stamp:
        return
    for pattern in ("*.nbi", "*.nbc"):
        for path in cache.glob(pattern):
            path.unlink(missing_ok=True)
    try:
        cache.mkdir(exist_ok=True)
        record.write_text(stamp)
    except OSError:
        # An installation that cannot be written to holds no cache to go stale.
        return


forget_stale_code(Path(__file__).parent)
