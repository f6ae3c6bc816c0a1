"""`kernel`: compile functions of this package with numba and cache the code on disk.

Cached code is invalidated when any file with kernels changes; numba itself checks only the file of the called kernel.
`planners/kernel.py` does the same for `planners` and `sensorgraph`; this package does not depend on those.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

from robotmodic_ident.uninterrupted import uninterrupted

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Compile a function on its first call and cache the result on disk; x / 0 is inf, as in numpy."""
    return _stored(numba.njit, function)


def inner_kernel(function: Function) -> Function:
    """Compile a kernel that only other kernels call; without a Python wrapper, compilation is much shorter."""
    compiled: Any = _stored(partial(numba.njit, no_cpython_wrapper=True), function)

    def add_overload(result: Any) -> None:  # not registered for calls from Python, as there is no wrapper
        compiled.overloads[tuple(result.signature.args)] = result

    def refuse(*_: object) -> None:
        raise TypeError(f"{function.__name__} is an inner kernel; call it from a kernel only")

    compiled.add_overload = add_overload
    compiled._compile_for_args = refuse
    return cast(Function, compiled)


def _stored(compiler: Callable[..., Any], function: Function) -> Function:
    compiler = partial(compiler, error_model="numpy", no_cfunc_wrapper=True)  # never called from C
    try:
        compiled = compiler(cache=True)(function)
    except RuntimeError:  # no writable folder
        compiled = compiler()(function)
    store = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if store is not None and hasattr(store, "_version"):
        store._version = (
            store._version,
            _stamp(),
        )  # numba uses a cache file only if this value agrees
    else:  # another numba version: recompile rather than run stale code
        compiled = compiler()(function)
    compiled.compile = partial(_compile, compiled.compile)
    return cast(Function, compiled)


def _compile(compile_: Callable[[Any], Any], kinds: Any) -> Any:
    """Compile a kernel and the kernels it calls without interruption, because Ctrl-C would crash LLVM."""
    return uninterrupted(partial(compile_, kinds))


@cache
def _stamp() -> tuple[tuple[str, int, int], ...]:
    """Return name, modification time and size of every file with kernels in this package, and of this file."""
    root = Path(__file__).parent
    files = [file for file in sorted(root.rglob("*.py")) if b"robotmodic_ident.kernel" in file.read_bytes()]
    stats = [(file.relative_to(root).as_posix(), file.stat()) for file in (*files, Path(__file__))]
    return tuple((name, stat.st_mtime_ns, stat.st_size) for name, stat in stats)
