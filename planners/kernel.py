"""`kernel`: the one place of this package that asks numba to compile.

Compiled code is kept on disk. Numba looks only at the file of a kernel to tell whether that is stale, not at the
files of the kernels it calls; here all files of this folder count.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])


def kernel(function: Function) -> Function:
    """Compile a function on its first call and keep the result on disk; x / 0 is inf, as in numpy."""
    return _stored(numba.njit, function)


def inner_kernel(function: Function) -> Function:
    """Compile a kernel for inner loops: it makes and returns no array, and calls inner kernels only.

    So it need not count who holds the arrays that it takes, which would be most of the time of a short one.
    """
    return _inner(function)


def inlined_kernel(function: Function) -> Function:
    """Compile an inner kernel into those that call it: for one that takes so many arrays that handing them over costs."""
    return _inner(function, inline="always")


def _inner(function: Function, **options: str) -> Function:
    try:
        return _stored(partial(numba.njit, _nrt=False, **options), function)
    except KeyError:  # a numba that always counts
        return _stored(partial(numba.njit, **options), function)


def _stored(compiler: Callable[..., Any], function: Function) -> Function:
    compiled = compiler(cache=True, error_model="numpy", nogil=True)(function)
    store = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if store is not None and hasattr(store, "_source_stamp"):
        store._source_stamp = (store._source_stamp, _stamp())
    else:  # another numba: rather compile anew than run what is stale
        compiled = compiler(error_model="numpy", nogil=True)(function)
    return cast(Function, compiled)


@cache
def _stamp() -> tuple[tuple[str, int, int], ...]:
    """Name, time of change and size of every source of this package that holds kernels."""
    here = Path(__file__).parent
    files = [file for file in sorted(here.rglob("*.py")) if b"planners.kernel" in file.read_bytes()]
    stats = [(file.relative_to(here).as_posix(), file.stat()) for file in (Path(__file__), *files)]
    return tuple((name, stat.st_mtime_ns, stat.st_size) for name, stat in stats)
