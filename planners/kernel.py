"""`kernel`: the single place where this package and `sensorgraph` compile with numba, by its public API.

Compiled code is cached on disk by the name of the kernel and its source file. The names end with a hash of all that
the file takes from other modules, which numba does not compare.
"""

import logging
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar, cast

import numba
from numba.extending import register_jitable

from planners.source_stamp import source_stamp
from planners.uninterrupted import uninterrupted

logger = logging.getLogger(__name__)
Function = TypeVar("Function", bound=Callable[..., object])
KNOWN = dir(getattr(getattr(numba.core, "options", None), "DefaultOptions", None))
LEAN = dict.fromkeys({"_nrt"} & set(KNOWN), False)  # no reference counting; private to numba


def kernel(function: Function, **options: Any) -> Function:
    """Compile a function on its first call and cache the result on disk; x / 0 is inf, as in numpy."""
    function.__qualname__ += f".{source_stamp(function.__module__)}"
    compiled: Any = numba.njit(cache=can_cache(), error_model="numpy", nogil=True, **options)(function)
    compile_ = compiled.compile  # Ctrl-C is deferred, because it would crash LLVM
    compiled.compile = lambda types: uninterrupted(lambda: compile_(types))
    if choose := getattr(compiled, "get_call_template", None):  # how other kernels call it
        compiled.get_call_template = lambda types, names: choose(tuple(map(_general, types)), names)
    return cast(Function, compiled)


def _general(kind: Any) -> Any:
    """Return the type of a call's argument, so that a kernel is compiled once for constants and all signed integers."""
    types: Any = numba.types
    kind = types.unliteral(kind)
    return types.int64 if isinstance(kind, types.Integer) and kind.signed else kind


def outer_kernel(function: Function) -> Function:
    """Compile a kernel that allocates and returns no array, and calls only such kernels; short ones run faster."""
    return kernel(function, **LEAN)


def inner_kernel(function: Function, **options: Any) -> Function:
    """Compile a function like `outer_kernel` where kernels call it; called from Python, it is a Python function."""
    function.__qualname__ += f".{source_stamp(function.__module__)}"
    return register_jitable(cache=can_cache(), error_model="numpy", nogil=True, **LEAN, **options)(function)


def inlined_kernel(function: Function) -> Function:
    """Compile an inner kernel inline into its callers; for kernels with so many arrays that passing them costs time."""
    return inner_kernel(function, forceinline=True)


@cache
def can_cache() -> bool:
    """Return whether numba finds a writable folder for compiled code; warn once if not."""
    try:
        return bool(numba.njit(cache=True)(lambda: None))
    except RuntimeError:
        why = "cannot be kept: neither the package folder nor the user cache is writable. Every command compiles again,"
        logger.warning(
            "compiled code %s which takes about 30 s; set NUMBA_CACHE_DIR to a writable folder", why
        )
        return False
