"""Types with which kernels call each other: numba types a constant as a literal, and would compile a kernel for each."""

from __future__ import annotations

from typing import Any

import numba


def generalise_calls(compiled: Any) -> None:
    """Let other kernels call a kernel with general types, so that it is compiled once for all signed integers.

    `get_call_template` is a method of numba's dispatchers that its manual does not name; without it nothing changes.
    """
    if choose := getattr(compiled, "get_call_template", None):
        compiled.get_call_template = lambda types, names: choose(tuple(map(_general, types)), names)


def _general(kind: Any) -> Any:
    """Return the type without its value, and 64 bits for a signed integer."""
    types: Any = numba.types
    kind = types.unliteral(kind)
    return types.int64 if isinstance(kind, types.Integer) and kind.signed else kind
