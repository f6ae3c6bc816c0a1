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

from planners.call_types import generalise_calls
from planners.source_stamp import source_stamp
from planners.uninterrupted import uninterrupted

logger = logging.getLogger(__name__)
Function = TypeVar("Function", bound=Callable[..., object])
KNOWN = dir(getattr(getattr(numba.core, "options", None), "DefaultOptions", None))
OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}  # x / 0 is inf, as in numpy
OPTIONS |= dict.fromkeys({"no_cfunc_wrapper"} & set(KNOWN), True)  # no entry from C: a tenth of compiling
LEAN = dict.fromkeys({"_nrt"} & set(KNOWN), False)  # no reference counting; private to numba


def kernel(function: Function, **options: Any) -> Function:
    """Compile a function on its first call and cache the result on disk."""
    function.__qualname__ += f".{source_stamp(function.__module__)}"
    compiled: Any = numba.njit(cache=can_cache(), **OPTIONS, **options)(function)
    compile_ = compiled.compile  # Ctrl-C is deferred, because it would crash LLVM
    compiled.compile = lambda types: uninterrupted(lambda: compile_(types))
    generalise_calls(compiled)
    return cast(Function, compiled)


def outer_kernel(function: Function) -> Function:
    """Compile a kernel that allocates and returns no array, and calls only such kernels; short ones run faster."""
    return kernel(function, **LEAN)


def inner_kernel(function: Function, **options: Any) -> Function:
    """Compile a function like `outer_kernel` where kernels call it; called from Python, it is a Python function."""
    function.__qualname__ += f".{source_stamp(function.__module__)}"
    return register_jitable(cache=can_cache(), **OPTIONS, **LEAN, **options)(function)


def inlined_kernel(function: Function) -> Function:
    """Compile an inner kernel inline into its callers; for kernels with so many arrays that passing them costs time."""
    return inner_kernel(function, forceinline=True)


@cache
def can_cache() -> bool:
    """Return whether numba finds a writable folder for compiled code; warn once if not."""
    try:
        return bool(numba.njit(cache=True)(lambda: None))
    except RuntimeError:
        why = "neither the package folder nor the user cache is writable. Every command compiles again, about 30 s"
        logger.warning("compiled code cannot be kept: %s; set NUMBA_CACHE_DIR to a writable folder", why)
        return False
