"""`kernel`: the one place where this package asks numba to compile.

`planners/kernel.py` does the same for `planners` and `sensorgraph`. There are two because the packages below
`sensorgraph` know nothing of each other; both keep compiled code on disk, and both count every file of the package
that holds kernels when they tell whether it is stale: numba itself looks only at the file of the kernel that is called.
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
    """Compile a function on its first call and keep the result on disk; x / 0 is inf, as in numpy."""
    return _stored(numba.njit, function)


def inner_kernel(function: Function) -> Function:
    """Compile a kernel that other kernels call, and nothing else: the way in from Python would be much of it."""
    compiled: Any = _stored(partial(numba.njit, no_cpython_wrapper=True), function)

    def add_overload(result: Any) -> None:  # not handed to Python's calls: there is no way in for them
        compiled.overloads[tuple(result.signature.args)] = result

    def refuse(*_: object) -> None:
        raise TypeError(f"{function.__name__} is an inner kernel, which only kernels call")

    compiled.add_overload = add_overload
    compiled._compile_for_args = refuse
    return cast(Function, compiled)


def _stored(compiler: Callable[..., Any], function: Function) -> Function:
    compiler = partial(compiler, error_model="numpy", no_cfunc_wrapper=True)  # C calls none of them
    try:
        compiled = compiler(cache=True)(function)
    except RuntimeError:  # no folder that it could write to
        compiled = compiler()(function)
    store = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if store is not None and hasattr(store, "_version"):
        store._version = (
            store._version,
            _stamp(),
        )  # numba reads the rest of a cache file only if this agrees
    else:  # another numba: rather compile anew than run what is stale
        compiled = compiler()(function)
    compiled.compile = partial(_compile, compiled.compile)
    return cast(Function, compiled)


def _compile(compile_: Callable[[Any], Any], kinds: Any) -> Any:
    """Compile, those that are called included, to the end even if Ctrl-C comes: LLVM would crash."""
    return uninterrupted(partial(compile_, kinds))


@cache
def _stamp() -> tuple[tuple[str, int, int], ...]:
    """Name, time of change and size of every file of this package that holds kernels, and of this one."""
    root = Path(__file__).parent
    files = [file for file in sorted(root.rglob("*.py")) if b"robotmodic_ident.kernel" in file.read_bytes()]
    stats = [(file.relative_to(root).as_posix(), file.stat()) for file in (*files, Path(__file__))]
    return tuple((name, stat.st_mtime_ns, stat.st_size) for name, stat in stats)
