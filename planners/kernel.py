"""`kernel`: the place where this package and `sensorgraph` ask numba to compile.

Compiled code is kept on disk. Numba looks only at the file of a kernel to tell whether that is stale, not at the
files of the kernels it calls; here all files of a package that hold kernels count.
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
    """Compile a function on its first call and keep the result on disk; x / 0 is inf, as in numpy."""
    return _stored(numba.njit, function)


def outer_kernel(function: Function) -> Function:
    """Compile a kernel that makes and returns no array, calls only such kernels, and is called from Python.

    So it need not count who holds the arrays that it takes, which would be most of the time of a short one.
    """
    return _lean(function)


def inner_kernel(function: Function) -> Function:
    """Compile a kernel like `outer_kernel` that kernels call, and nothing else.

    What unpacks Python's objects is a large part of what is compiled, above all for tuples of arrays; here it is left out.
    """
    return _inner(function)


def inlined_kernel(function: Function) -> Function:
    """Compile an inner kernel into those that call it: for one that takes so many arrays that handing them over costs."""
    return _inner(function, forceinline=True)


def _inner(function: Function, **options: bool) -> Function:
    compiled: Any = _lean(function, no_cpython_wrapper=True, **options)

    def add_overload(result: Any) -> None:  # not handed to Python's calls: there is no way in for them
        compiled.overloads[tuple(result.signature.args)] = result

    def refuse(*_: object) -> None:
        raise TypeError(
            f"{function.__name__} is an inner kernel, which only kernels call: make it an outer one"
        )

    compiled.add_overload = add_overload
    compiled._compile_for_args = refuse
    return cast(Function, compiled)


def _lean(function: Function, **options: bool) -> Function:
    try:
        return _stored(partial(numba.njit, _nrt=False, **options), function)
    except KeyError:  # a numba that always counts
        return _stored(partial(numba.njit, **options), function)


def compile_for(*calls: tuple[Callable[..., object], tuple[object, ...]]) -> None:
    """Compile kernels for arguments like these, or read them from disk, without running them.

    Of those that no disk holds, every second one is compiled by another process at the same time, where the machine has
    another processor. The kernels must not call each other.

    Parameters
    ----------
    calls : kernels with the arguments of a call of each
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
        with (
            suppress(BrokenPipeError),
            helper.stdin as pipe,
        ):  # if it died at its start, this process does its part
            pipe.write(pickle.dumps((sys.path, new[1::2])))
    theirs = {name for _, name, _ in new[1::2]} if helper else set()
    try:
        for function, kinds in types:
            if function.py_func.__name__ not in theirs:
                function.compile(kinds)
        if helper is not None:
            helper.wait()
    except BaseException:
        if helper is not None:
            helper.kill()
            helper.wait()
        raise
    for function, kinds in types:
        function.compile(kinds)


HELPER = """
import importlib, pickle, sys
sys.path[:], jobs = pickle.load(sys.stdin.buffer)
for module, name, kinds in jobs:
    getattr(importlib.import_module(module), name).compile(kinds)
"""


def _is_new(compiled: Any) -> bool:
    """Tell whether a kernel can be kept on disk, and is not."""
    store: Any = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    return hasattr(store, "_load_index") and not store._load_index()


def _widen_integers(compiled: Any) -> None:
    """Let the calls in other kernels share one compiled version, whatever integers they pass.

    Numba would compile one more for an int32, and one more for each constant such as 0.
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
    compiler = partial(compiler, error_model="numpy", nogil=True, no_cfunc_wrapper=True)  # none for C's calls
    try:
        compiled = compiler(cache=True)(function)
    except RuntimeError:  # no folder that it could write to
        _say_that_nothing_is_kept()
        compiled = compiler()(function)
    store = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if store is not None and hasattr(store, "_version"):
        # numba reads the rest of a file only if this agrees, so it never looks for a type that has another name now
        store._version = (store._version, _stamp(function.__module__.partition(".")[0]))
    else:  # another numba: rather compile anew than run what is stale
        compiled = compiler()(function)
    _widen_integers(compiled)
    compiled.compile = partial(_compile, compiled.compile)
    return cast(Function, compiled)


def _compile(compile_: Callable[[Any], Any], kinds: Any) -> Any:
    """Compile, those that are called included, to the end even if Ctrl-C comes: LLVM would crash."""
    return uninterrupted(partial(compile_, kinds))


@cache
def _say_that_nothing_is_kept() -> None:
    """Say it once."""
    logger.warning(
        "compiled code cannot be kept, as neither the package's folder nor the user's cache can be written to: every "
        "command compiles anew, for half a minute or so; set NUMBA_CACHE_DIR to a folder that can be written to"
    )


@cache
def _stamp(package: str) -> tuple[tuple[str, int, int], ...]:
    """Name, time of change and size of every source of a package that holds kernels, and of this file."""
    root = Path(sys.modules[package].__file__ or "").parent
    files = [file for file in sorted(root.rglob("*.py")) if b"planners.kernel" in file.read_bytes()]
    names = [file.relative_to(root).as_posix() for file in files]
    stats = [file.stat() for file in (*files, Path(__file__))]
    return tuple((n, s.st_mtime_ns, s.st_size) for n, s in zip((*names, "kernel"), stats, strict=True))
