"""`kernel`: compile functions of this package with numba and cache the code on disk, by numba's public API.

`planners/kernel.py` does the same for `planners` and `sensorgraph`; this package does not depend on those.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar, cast

import numba
from numba.extending import register_jitable

from robotmodic_ident.source_stamp import source_stamp
from robotmodic_ident.uninterrupted import uninterrupted

Function = TypeVar("Function", bound=Callable[..., Any])
KNOWN = dir(getattr(getattr(numba.core, "options", None), "DefaultOptions", None))
OPTIONS: dict[str, Any] = {"error_model": "numpy"}  # x / 0 is inf, as in numpy
OPTIONS |= dict.fromkeys({"no_cfunc_wrapper"} & set(KNOWN), True)  # no entry from C: a tenth of compiling


def kernel(function: Function) -> Function:
    """Compile a function on its first call and cache the result on disk."""
    function.__qualname__ += f".{source_stamp(function.__module__)}"
    compiled: Any = numba.njit(cache=_can_cache(), **OPTIONS)(function)
    compile_ = compiled.compile  # Ctrl-C is deferred, because it would crash LLVM
    compiled.compile = lambda types: uninterrupted(lambda: compile_(types))
    return cast(Function, compiled)


def inner_kernel(function: Function) -> Function:
    """Compile a function where kernels call it, without a Python wrapper; called from Python, it runs as Python."""
    function.__qualname__ += f".{source_stamp(function.__module__)}"
    return register_jitable(cache=_can_cache(), **OPTIONS)(function)


@cache
def _can_cache() -> bool:
    """Return whether numba finds a writable folder for compiled code."""
    try:
        return bool(numba.njit(cache=True)(lambda: None))
    except RuntimeError:
        return False
