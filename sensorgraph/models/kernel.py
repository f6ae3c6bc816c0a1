"""`kernel`: the one place that asks numba to compile; each kernel has a plain numpy twin that the tests hold it against.

Compiled code is kept on disk. Numba looks only at the file of a kernel to tell whether that is stale, not at the
files of the kernels it calls; here all files of this folder count.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])


def kernel(function: Function) -> Function:
    """Compile a function on its first call and keep the result on disk; x / 0 is inf, as in numpy."""
    compiled = numba.njit(cache=True, error_model="numpy")(function)
    store = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if store is not None and hasattr(store, "_source_stamp"):
        store._source_stamp = (store._source_stamp, _stamp())
    else:  # another numba: rather compile anew than run what is stale
        compiled = numba.njit(error_model="numpy")(function)
    return cast(Function, compiled)


def inlined(function: Function) -> Function:
    """Return a kernel for use within another one, which takes its body in: no call with twenty arrays for each ray."""
    plain = getattr(function, "py_func", function)
    return cast(Function, numba.njit(inline="always", error_model="numpy")(plain))


@cache
def _stamp() -> tuple[tuple[str, int, int], ...]:
    """Name, time of change and size of every source beside this one."""
    files = sorted(Path(__file__).parent.glob("*.py"))
    return tuple((file.name, file.stat().st_mtime_ns, file.stat().st_size) for file in files)
