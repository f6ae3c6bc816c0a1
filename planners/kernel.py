"""`kernel`: the single place where this package and `sensorgraph` compile with numba.

Compiled code is cached on disk. Numba detects stale code from the source file of the kernel alone, not from
the files of the kernels that it calls. Here a change of any file with kernels in the package makes the cache
stale.
"""

from __future__ import annotations

import logging
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

from planners.uninterrupted import uninterrupted

logger = logging.getLogger(__name__)
Function = TypeVar("Function", bound=Callable[..., object])


def kernel(function: Function) -> Function:
    """Compile a function on its first call and cache the result on disk; x / 0 is inf, as in numpy."""
    return _stored(numba.njit, function)


def outer_kernel(function: Function) -> Function:
    """Compile a kernel that is called from Python, allocates and returns no array, and calls only such kernels.

    Reference counting of its array arguments is switched off; it would dominate the run time of a short kernel.
    """
    return _lean(function)


def inner_kernel(function: Function) -> Function:
    """Compile a kernel like `outer_kernel` that only other kernels call.

    It has no wrapper that unpacks Python objects, which would be a large part of the compile time, in
    particular for tuples of arrays.
    """
    return _inner(function)


def inlined_kernel(function: Function) -> Function:
    """Compile an inner kernel inline into its callers; for kernels with so many arrays that passing them costs time."""
    return _inner(function, forceinline=True)


def _inner(function: Function, **options: bool) -> Function:
    compiled: Any = _lean(function, no_cpython_wrapper=True, **options)

    def add_overload(result: Any) -> None:  # not registered for calls from Python, which have no wrapper
        compiled.overloads[tuple(result.signature.args)] = result

    def refuse(*_: object) -> None:
        raise TypeError(
            f"{function.__name__} is an inner kernel, which only kernels may call; make it an outer kernel"
        )

    compiled.add_overload = add_overload
    compiled._compile_for_args = refuse
    return cast(Function, compiled)


def _lean(function: Function, **options: bool) -> Function:
    try:
        return _stored(partial(numba.njit, _nrt=False, **options), function)
    except KeyError:  # a numba version that always counts references
        return _stored(partial(numba.njit, **options), function)


def compile_for(*calls: tuple[Callable[..., object], tuple[object, ...]]) -> None:
    """Compile kernels for the types of these arguments, or load them from the cache, without running them.

    Every second kernel that is not in the cache is compiled by another process at the same time, if the
    machine has more than one processor. The kernels must not call each other.

    Parameters
    ----------
    calls : Kernels, each with the arguments of one call.
    """
    typeof: Any = numba.typeof
    types: list[tuple[Any, tuple[Any, ...]]] = [
        (function, tuple(typeof(a) for a in arguments)) for function, arguments in calls
    ]
    new = [(f.py_func.__module__, f.py_func.__name__, kinds) for f, kinds in types if _is_new(f)]
    helper: subprocess.Popen[bytes] | None = None
    if len(new) > 1 and (os.cpu_count() or 1) > 1:
        helper = subprocess.Popen(
            [sys.executable, "-c", HELPER], stdin=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        assert helper.stdin is not None
        with suppress(BrokenPipeError):  # if the process died at its start, this process compiles its share
            helper.stdin.write(pickle.dumps((sys.path, new[1::2])))
            helper.stdin.flush()  # not closed: the helper ends when the pipe closes
    theirs = {name for _, name, _ in new[1::2]} if helper else set()
    try:
        for function, kinds in types:
            if function.py_func.__name__ not in theirs:
                function.compile(kinds)
        if helper is not None:
            helper.wait()
    finally:
        if helper is not None:
            helper.kill()
            with suppress(BrokenPipeError):
                helper.communicate()
    for function, kinds in types:
        function.compile(kinds)


HELPER = """
import importlib, os, pickle, sys, threading
sys.path[:], jobs = pickle.load(sys.stdin.buffer)

def end_with_parent():
    sys.stdin.buffer.read()
    os._exit(1)

threading.Thread(target=end_with_parent, daemon=True).start()
for module, name, kinds in jobs:
    getattr(importlib.import_module(module), name).compile(kinds)
"""


def _is_new(compiled: Any) -> bool:
    """Return whether a kernel can be cached on disk and is not cached yet."""
    store: Any = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    return hasattr(store, "_load_index") and not store._load_index()


def _widen_integers(compiled: Any) -> None:
    """Make calls from other kernels share one compiled version for all integer types.

    Numba would compile one more version for an int32, and one for each constant such as 0.
    """
    choose = compiled.get_call_template

    def get_call_template(args: tuple[Any, ...], kws: dict[str, Any]) -> Any:
        return choose(tuple(map(_wide, args)), {name: _wide(kind) for name, kind in kws.items()})

    compiled.get_call_template = get_call_template


def _wide(kind: Any) -> Any:
    types: Any = numba.types
    kind = types.unliteral(kind)
    narrow = isinstance(kind, types.Integer) and kind.bitwidth < 64
    return types.int64 if narrow else kind


def _stored(compiler: Callable[..., Any], function: Function) -> Function:
    compiler = partial(compiler, error_model="numpy", nogil=True, no_cfunc_wrapper=True)
    try:
        compiled = compiler(cache=True)(function)
    except RuntimeError:  # no folder is writable
        _warn_of_missing_cache()
        compiled = compiler()(function)
    store = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if store is not None and hasattr(store, "_version"):
        # numba loads the rest of a file only if this agrees, so it never looks up a type that has been renamed
        store._version = (store._version, _stamp(function.__module__.partition(".")[0]))
    else:  # an unknown version of numba: compile on each run instead of running stale code
        compiled = compiler()(function)
    _widen_integers(compiled)
    compiled.compile = partial(_compile, compiled.compile)
    return cast(Function, compiled)


def _compile(compile_: Callable[[Any], Any], kinds: Any) -> Any:
    """Compile a kernel and the kernels that it calls; Ctrl-C is deferred, because it would crash LLVM."""
    return uninterrupted(partial(compile_, kinds))


@cache
def _warn_of_missing_cache() -> None:
    """Warn once that compiled code cannot be cached."""
    logger.warning(
        "compiled code cannot be kept: neither the package folder nor the user cache is writable. Every command "
        "compiles again, which takes about 30 s; set NUMBA_CACHE_DIR to a writable folder"
    )


@cache
def _stamp(package: str) -> tuple[tuple[str, int, int], ...]:
    """Return name, modification time and size of every source file with kernels in a package, and of this file."""
    root = Path(sys.modules[package].__file__ or "").parent
    files = [file for file in sorted(root.rglob("*.py")) if b"planners.kernel" in file.read_bytes()]
    names = [file.relative_to(root).as_posix() for file in files]
    stats = [file.stat() for file in (*files, Path(__file__))]
    return tuple((n, s.st_mtime_ns, s.st_size) for n, s in zip((*names, "kernel"), stats, strict=True))
