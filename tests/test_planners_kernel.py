"""Kernels are compiled ahead, side by side, and once for all integers."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

SCRIPT = """
import json
import numpy as np
from planners.array_kernels import is_any, make_heap, pop_least
from planners.kernel import compile_for
heap, costs = np.zeros(3, np.int64), np.zeros(3)
compile_for((make_heap, (heap, 3, costs)), (pop_least, (heap, 3, costs)), (is_any, (costs > 0, 0, 1)))
made = [len(k.signatures) for k in (make_heap, pop_least, is_any)]
hits = [sum(k.stats.cache_hits.values()) for k in (make_heap, pop_least, is_any)]
make_heap(heap, 3, costs)
pop_least(heap, 3, costs)
print(json.dumps([made, hits, [len(k.signatures) for k in (make_heap, pop_least, is_any)]]))
"""


def run(folder: Path) -> str:
    env = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=env, capture_output=True, text=True, check=True, cwd=Path.cwd()
    )
    return done.stdout.strip()


def test_kernels_are_compiled_once_and_kept(tmp_path: Path) -> None:
    """The first run compiles each kernel once, one of them in another process; the second reads all from disk."""
    shared = (os.cpu_count() or 1) > 1
    assert run(tmp_path) == f"[[1, 1, 1], [0, {int(shared)}, 0], [1, 1, 1]]"
    assert run(tmp_path) == "[[1, 1, 1], [1, 1, 1], [1, 1, 1]]"
