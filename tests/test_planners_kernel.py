"""Kernels are compiled once and kept, by public numba."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import numba
import pytest
from conftest import further

from planners.kernel import kernel

MODULE = """
from planners.kernel import kernel

@kernel
def add(x, y):
    return x + y

@kernel
def multiply(x, y):
    return x * y

@kernel
def divide(x, y):
    return x / y
"""
SCRIPT = """
import gc, json
from three import add, divide, multiply
kernels = add, divide, multiply
assert [k(1.0, 2.0) for k in kernels] == [3.0, 0.5, 2.0]
assert gc.isenabled()
print(json.dumps([[len(k.signatures) for k in kernels], [sum(k.stats.cache_hits.values()) for k in kernels]]))
"""


NOWHERE = """
import numba.core.caching as caching
for made in (vars(caching)[name] for name in ("_CacheImpl", "CacheImpl") if name in vars(caching)):
    made._locator_classes = []
"""
"""As on a read-only file system."""


def run(folder: Path, script: str = "", before: str = "") -> subprocess.CompletedProcess[str]:
    """Run a script with the modules of a folder, and with compiled code kept in the folder."""
    module, file = folder / "three.py", folder / "script.py"
    if not module.exists():  # numba 0.61 compares the time of the file
        module.write_text(MODULE)
    file.write_text(before + (script or SCRIPT))
    paths = os.pathsep.join([str(Path.cwd()), os.environ.get("PYTHONPATH", "")])
    env = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONPATH": paths}
    command = [sys.executable, str(file)]
    return subprocess.run(command, env=env, capture_output=True, text=True, check=True, cwd=Path.cwd())


def test_kernels_are_compiled_once_and_kept(tmp_path: Path) -> None:
    """The first run compiles each kernel once; the second reads all from disk."""
    assert run(tmp_path).stdout.strip() == "[[1, 1, 1], [0, 0, 0]]"
    assert run(tmp_path).stdout.strip() == "[[1, 1, 1], [1, 1, 1]]"


def test_where_nothing_can_be_kept_it_works_and_says_so_once(tmp_path: Path) -> None:
    done = run(tmp_path, before=NOWHERE)
    assert done.stdout.strip() == "[[1, 1, 1], [0, 0, 0]]"
    (line,) = done.stderr.splitlines()
    assert line.startswith("compiled code cannot be kept") and "NUMBA_CACHE_DIR" in line


@pytest.mark.slow
def test_compile_refuses_in_one_line_where_nothing_can_be_kept(tmp_path: Path) -> None:
    done = run(tmp_path, "from sensorgraph.cli import run\nprint(run(['compile']))", NOWHERE)
    assert done.stdout == "2\n"
    (line,) = done.stderr.splitlines()
    assert "NUMBA_CACHE_DIR" in line


INNER = """
import numpy as np
from {package}.kernel import inner_kernel, kernel

@inner_kernel
def twice(x):
    return 2 * x

@kernel
def sum_of_twice(x):
    total = 0.0
    for value in x:
        total += twice(value)
    return total

print(sum_of_twice(np.arange(4.0)), len(sum_of_twice.signatures), twice(1.5), twice("ab"))
"""


@pytest.mark.slow
@pytest.mark.parametrize("package", ["planners", *further("robotmodic_ident")])
def test_an_inner_kernel_is_compiled_into_kernels_and_is_a_function_of_python(
    package: str, tmp_path: Path
) -> None:
    for before in ("", NOWHERE):
        done = run(tmp_path, INNER.format(package=package), before)
        assert done.stdout == "12.0 1 3.0 abab\n"


LEAN = """
from planners.kernel import inlined_kernel, inner_kernel, outer_kernel

@inlined_kernel
def half(x):
    return x / 2

@inner_kernel
def quarter(x):
    return half(half(x))

@outer_kernel
def fill(x):
    for i in range(len(x)):
        x[i] = quarter(x[i]) + quarter(1)
"""
WITHOUT_PRIVATE_OPTIONS = """
import numba.core.cpu as cpu
import numba.core.options as options
for kind in (options.DefaultOptions, *cpu.CPUTargetOptions.__mro__):
    for name in [name for name in vars(kind) if name in ("_nrt", "no_cfunc_wrapper")]:
        delattr(kind, name)
"""


@kernel
def doubled(x: int) -> int:
    return 2 * x


def test_kernels_that_pass_a_constant_or_any_signed_integer_call_one_compiled_kernel() -> None:
    called, types = cast(Any, doubled), cast(Any, numba.types)
    for kind in (types.literal(1), types.int32, types.int64):
        called.get_call_template((kind,), {})
    assert called.signatures == [(types.int64,)]


def test_kernels_have_no_entry_from_c(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody calls them from C, and to compile the entry takes a tenth of the time."""
    monkeypatch.setattr("planners.kernel.can_cache", lambda: False)  # kept code cannot be inspected

    def halved(x: int) -> float:
        return x / 2

    compiled = cast(Any, kernel(halved))
    assert compiled(3) == 1.5
    (code,) = compiled.inspect_llvm().values()
    assert "cpython" in code and "cfunc" not in code


@pytest.mark.slow
def test_kernels_need_no_private_option_of_numba(tmp_path: Path) -> None:
    (tmp_path / "lean.py").write_text(LEAN)
    script = (
        "import lean, numpy as np; x = np.arange(3.0); lean.fill(x); print(x, lean.fill.stats.cache_hits)"
    )
    for before in ("", WITHOUT_PRIVATE_OPTIONS):
        assert run(tmp_path, script, before).stdout.startswith("[0.25 0.5  0.75]")


@pytest.mark.parametrize("file", ["planners/kernel.py", "robotmodic_ident/kernel.py"])
def test_kernels_use_no_private_attribute(file: str) -> None:
    """`_nrt` is an option, and used only where numba has it."""
    tree = ast.parse(Path(file).read_text())
    names = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    texts = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)}
    assert {n for n in names if n.startswith("_")} <= {"__qualname__", "__module__", "__name__", "__code__"}
    assert {t for t in texts if isinstance(t, str) and t.startswith("_")} <= {"_nrt"}


PACKAGE = {
    "__init__": "",
    "numbers": "SCALE = 2.0",
    "pair": "from typing import NamedTuple\nclass Pair(NamedTuple):\n    a: float\n    b: float",
    "inner": "from {package}.kernel import inner_kernel\n@inner_kernel\ndef change(x):\n    return x + 1",
    "between": (
        "from {package}.kernel import inner_kernel\nfrom stale.inner import change\n"
        "@inner_kernel\ndef twice(x):\n    return change(change(x))"
    ),
    "outer": (
        "from {package}.kernel import kernel\nfrom stale.between import twice\nfrom stale.numbers import SCALE\n"
        "from stale.pair import Pair\n@kernel\ndef outer(p):\n    return SCALE * twice(p.a)"
    ),
}
"""Modules of a package whose last one calls kernels of the others."""


@pytest.mark.parametrize("package", ["planners", *further("robotmodic_ident")])
@pytest.mark.slow
def test_code_is_compiled_again_after_a_change_of_what_it_calls_or_takes(
    package: str, tmp_path: Path
) -> None:
    folder = tmp_path / "stale"
    folder.mkdir()
    for name, text in PACKAGE.items():
        (folder / f"{name}.py").write_text(text.format(package=package))
    script = "from stale.outer import Pair, outer; print(outer(Pair(1.0, 9.0)), sum(outer.stats.cache_hits.values()))"
    assert run(tmp_path, script).stdout == "6.0 0\n"
    assert run(tmp_path, script).stdout == "6.0 1\n"
    for name, before, after, result in (
        ("inner", "x + 1", "x + 20", "82.0 0\n"),
        ("numbers", "2.0", "3.0", "123.0 0\n"),
        ("pair", "a: float\n    b", "b: float\n    a", "147.0 0\n"),
    ):
        file = folder / f"{name}.py"
        file.write_text(file.read_text().replace(before, after))
        assert run(tmp_path, script).stdout == result
    name = "from stale.outer import outer; print(outer.py_func.__qualname__)"
    here, moved = run(tmp_path, name).stdout, tmp_path / "elsewhere"
    moved.mkdir()
    folder.rename(moved / "stale")
    assert run(moved, name).stdout == here  # so the cache beside the modules stays valid


@pytest.mark.slow
def test_the_names_of_the_kernels_are_the_same_in_every_process() -> None:
    script = (
        "import re, sys, planners.planning, sensorgraph.demo, sensorgraph.localization.locate\n"
        "values = [v for m in list(sys.modules.values()) for v in list(vars(m).values())]\n"
        "names = {str(getattr(v, '__qualname__', '')) for v in values if callable(v)}\n"
        "print(*sorted(n for n in names if re.search('[.][0-9a-f]{12}$', n)))"
    )
    first, second = (
        subprocess.run(
            [sys.executable, "-c", script],
            env=os.environ | {"PYTHONHASHSEED": seed}, capture_output=True, text=True, check=True,
        ).stdout
        for seed in ("1", "2")
    )  # fmt: skip
    assert first == second and len(first.split()) > 100


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
    print("interrupted", len(quarter.signatures))
signal.signal(signal.{number}, signal.SIG_IGN)
print(quarter(8.0))
"""


@pytest.mark.parametrize(
    ("number", "package"),
    [
        ("SIGINT", "planners"),
        *further(("SIGTERM", "robotmodic_ident"), ("SIGINT", "robotmodic_ident"), ("SIGTERM", "planners")),
    ],
)  # fmt: skip
def test_a_signal_while_a_kernel_compiles_is_handled_once_it_is_compiled(
    number: str, package: str, tmp_path: Path
) -> None:
    """Also if it comes again, and within the kernels that it calls."""
    done = run(tmp_path, INTERRUPTED.format(package=package, number=number))
    assert done.stdout == "interrupted 1\n2.0\n"
    assert done.stderr.count("stopping after the current compilation") == 1
