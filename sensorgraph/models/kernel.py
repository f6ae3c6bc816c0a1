"""`kernel`: the one place that asks numba to compile; each kernel has a plain numpy twin that the tests hold it against."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])


def kernel(function: Function) -> Function:
    """Compile a function on its first call and keep the result on disk."""
    return cast(Function, numba.njit(cache=True)(function))
