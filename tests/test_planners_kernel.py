"""Kernels are compiled ahead, side by side, and once for all integers."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import further

SCRIPT = """
import gc, json
import numpy as np
from planners.array_kernels import is_any, make_heap, pop_least
from planners.kernel import compile_for
heap, costs = np.zeros(3, np.int64), np.zeros(3)
compile_for((make_heap, (heap, 3, costs)), (pop_least, (heap, 3, costs)), (is_any, (costs > 0, 0, 1)))
made = [len(k.signatures) for k in (make_heap, pop_least, is_any)]
hits = [sum(k.stats.cache_hits.values()) for k in (make_heap, pop_least, is_any)]
make_heap(heap, 3, costs)
pop_least(heap, 3, costs)
assert gc.isenabled()
print(json.dumps([made, hits, [len(k.signatures) for k in (make_heap, pop_least, is_any)]]))
"""


NOWHERE = """
import numba.core.caching as caching
for made in (vars(caching)[name] for name in ("_CacheImpl", "CacheImpl") if name in vars(caching)):
    made._locator_classes = []
"""
"""As on a read-only file system."""


def run(folder: Path, script: str = SCRIPT) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    command = [sys.executable, "-c", script]
    return subprocess.run(command, env=env, capture_output=True, text=True, check=True, cwd=Path.cwd())


def test_kernels_are_compiled_once_and_kept(tmp_path: Path) -> None:
    """The first run compiles each kernel once, one of them in another process; the second reads all from disk."""
    shared = (os.cpu_count() or 1) > 1
    assert run(tmp_path).stdout.strip() == f"[[1, 1, 1], [0, {int(shared)}, 0], [1, 1, 1]]"
    assert run(tmp_path).stdout.strip() == "[[1, 1, 1], [1, 1, 1], [1, 1, 1]]"


def test_where_nothing_can_be_kept_it_works_and_says_so_once(tmp_path: Path) -> None:
    done = run(tmp_path, NOWHERE + SCRIPT)
    assert done.stdout.strip() == "[[1, 1, 1], [0, 0, 0], [1, 1, 1]]"
    (line,) = done.stderr.splitlines()
    assert line.startswith("compiled code cannot be kept") and "NUMBA_CACHE_DIR" in line


STILLBORN = """
import subprocess
class Stillborn(subprocess.Popen):
    def __init__(self, command, **options):
        super().__init__([command[0], "-c", "raise SystemExit(1)"], **options)
        self.wait()
subprocess.Popen = Stillborn
import os
os.cpu_count = lambda: 2
"""
"""A helper that dies before it is told what to compile."""


def test_without_its_helper_a_process_compiles_alone(tmp_path: Path) -> None:
    assert run(tmp_path, STILLBORN + SCRIPT).stdout.strip() == "[[1, 1, 1], [0, 0, 0], [1, 1, 1]]"


INNER = """
import numpy as np
from planners.kernel import inner_kernel, outer_kernel

@inner_kernel
def twice(x: float) -> float:
    return 2 * x

@outer_kernel
def sum_of_twice(x: np.ndarray) -> float:
    total = 0.0
    for value in x:
        total += twice(value)
    return total

print(sum_of_twice(np.arange(4.0)))
try:
    twice(1.0)
except TypeError as error:
    print(error)
"""


def test_an_inner_kernel_serves_kernels_and_refuses_python(tmp_path: Path) -> None:
    script = tmp_path / "inner.py"
    script.write_text(NOWHERE + INNER)
    total, refusal = run(
        tmp_path, f"exec(compile(open({str(script)!r}).read(), {str(script)!r}, 'exec'))"
    ).stdout.splitlines()
    assert total == "12.0"
    assert refusal.startswith("twice is an inner kernel")


INTERRUPTED = """
import signal
import numba.core.event as event
from {package}.kernel import inner_kernel, kernel

def interrupt(number, frame):
    raise KeyboardInterrupt

class Interrupt(event.Listener):
    def on_start(self, what):
        signal.raise_signal(signal.{number})
    on_end = on_start

signal.signal(signal.{number}, interrupt)

@inner_kernel
def half(x):
    return x / 2

@kernel
def quarter(x):
    return half(half(x))

event.register("numba:llvm_lock", Interrupt())  # begins and ends again and again while LLVM is at work
event.register("numba:compile", Interrupt())
try:
    quarter(1.0)
except KeyboardInterrupt:
    print("interrupted", len(quarter.signatures), len(half.signatures))
signal.signal(signal.{number}, signal.SIG_IGN)
print(quarter(8.0))
"""


@pytest.mark.parametrize(
    ("number", "package"),
    [
        ("SIGINT", "planners"), ("SIGTERM", "robotmodic_ident"),
        *further(("SIGINT", "robotmodic_ident"), ("SIGTERM", "planners")),
    ],
)  # fmt: skip
def test_a_signal_while_a_kernel_compiles_is_handled_once_it_is_compiled(
    number: str, package: str, tmp_path: Path
) -> None:
    """Also if it comes again, and within the kernels that it calls."""
    done = run(tmp_path, INTERRUPTED.format(package=package, number=number))
    assert done.stdout == "interrupted 1 1\n2.0\n"
    assert done.stderr.count("stopping after the current compilation") == 1
