"""Compile kernels before their first call, in two processes."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba

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


def compile_for(*calls: tuple[Callable[..., object], tuple[object, ...]]) -> None:
    """Compile kernels for the types of these arguments, or load them from the cache, without running them.

    Every second kernel that is not in the cache is compiled by another process at the same time, if the
    machine has more than one processor. The kernels must not call each other.

    Parameters
    ----------
    calls : Kernels, each with the arguments of one call.
    """
    typeof: Any = numba.typeof
    jobs: list[tuple[Any, tuple[Any, ...]]] = [(f, tuple(map(typeof, arguments))) for f, arguments in calls]
    theirs = [job for job in jobs if _is_new(job[0])][1::2] if (os.cpu_count() or 1) > 1 else []
    helper: subprocess.Popen[bytes] | None = None
    if theirs:
        helper = subprocess.Popen(
            [sys.executable, "-c", HELPER], stdin=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        assert helper.stdin is not None
        names = [(f.py_func.__module__, f.py_func.__name__, kinds) for f, kinds in theirs]
        with suppress(BrokenPipeError):  # if the process died at its start, this process compiles its share
            helper.stdin.write(pickle.dumps((sys.path, names)))
            helper.stdin.flush()  # not closed: the helper ends when the pipe closes
    try:
        for function, kinds in jobs:
            if (function, kinds) not in theirs:
                function.compile(kinds)
        if helper is not None:
            helper.wait()
    finally:
        if helper is not None:
            helper.kill()
            with suppress(BrokenPipeError):
                helper.communicate()
    for function, kinds in theirs:
        function.compile(kinds)


def _is_new(compiled: Any) -> bool:
    """Return whether a kernel can be cached on disk and is not cached yet."""
    folder = compiled.stats.cache_path
    return folder is not None and not any(Path(folder).glob(f"*{compiled.__qualname__}*"))
