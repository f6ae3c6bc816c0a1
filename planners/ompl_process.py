"""OMPL in a process of its own: how it is asked, and what answers there.

It is seeded once as its first call: the same queries give the same paths whatever ran before (its random streams
advance over a whole process), a crash in the bindings becomes an error here, and what the bindings leak or print at
their exit stays there. Searches stop by count, never by the clock, so that a plan does not depend on the load of the
machine. What runs there imports little: a process for each of a hundred queries must start fast.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planners.errors import PlanError

INSTALL = "OMPL is not installed; pip install 'ompl>=2.0.1,<2.1' (Linux or macOS 15+; on Windows use WSL)"
MISSING = 3
"""Exit code of the process when ompl cannot be imported."""
CHECK_STEP = 0.01
"""[m] between the states of a motion that OMPL checks."""
SLACK = 0.002
"""[m] that OMPL keeps beyond the clearance, where start and goal do; where none does, it may miss as much."""

Floats = NDArray[np.float64]


def ask(module: str, **question: Any) -> dict[str, np.ndarray]:
    """Run a module of ours as a fresh process that answers a question; both are arrays by name."""
    package = Path(__file__).parent.parent
    others = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(package), *others])}
    sent = io.BytesIO()
    np.savez(sent, **question)
    with subprocess.Popen(
        [sys.executable, "-P", "-m", module],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment,
    ) as process:
        try:
            answer, complaint = process.communicate(sent.getvalue())
        except BaseException:
            process.kill()
            raise
    if process.returncode == MISSING:
        raise PlanError(INSTALL)
    if process.returncode != 0:
        last = complaint.decode(errors="replace").strip().splitlines()[-1:] or ["no message"]
        raise PlanError(
            f"OMPL ended with code {process.returncode} ({last[0]}); please report the arena and seed"
        )
    with np.load(io.BytesIO(answer)) as data:
        return dict(data)


def serve(work: Callable[[Any, Any, Mapping[str, np.ndarray]], dict[str, Any]]) -> int:
    """Answer the question on standard input by `work(ompl.base, ompl.geometric, question)`; return an exit code."""
    try:
        from ompl import base, geometric, util  # type: ignore[import-untyped]
    except ImportError:
        return MISSING
    with np.load(io.BytesIO(sys.stdin.buffer.read())) as data:
        question = dict(data)
    util.RNG.setSeed(int(question["seed"]) % (2**31 - 1) + 1)  # must be the first call; 0 is refused
    util.setLogLevel(util.LOG_NONE)
    answer = io.BytesIO()
    np.savez(answer, **work(base, geometric, question))
    sys.stdout.buffer.write(answer.getvalue())
    sys.stdout.buffer.flush()
    return 0


class Countdown:
    """Say stop after so many questions."""

    def __init__(self, left: int) -> None:
        self.left = left

    def __call__(self) -> bool:
        self.left -= 1
        return self.left < 0


class Field:
    """The distance field as plain lists, which a callback reads several times faster than an array."""

    def __init__(self, distance: Floats, origin: Floats, step: float) -> None:
        self.rows: list[list[float]] = distance.tolist()
        self.low = (float(origin[0] + step / 2), float(origin[1] + step / 2))
        self.step = step
        self.size = (distance.shape[0] - 1, distance.shape[1] - 1)
        self.least = 0.0

    def value(self, x: float, y: float) -> float:
        """Interpolate the distance [m]; 0 off the raster."""
        u, v = (x - self.low[0]) / self.step, (y - self.low[1]) / self.step
        i, j = int(u), int(v)
        if (
            u < 0 or v < 0 or i >= self.size[0] or j >= self.size[1]
        ):  # bounds are closed: x may be the far one
            return 0.0
        a, b = u - i, v - j
        near, far = self.rows[i], self.rows[i + 1]
        return (1 - a) * ((1 - b) * near[j] + b * near[j + 1]) + a * ((1 - b) * far[j] + b * far[j + 1])

    def is_valid(self, state: Any) -> bool:
        """Answer OMPL, with a real bool."""
        return bool(self.value(state[0], state[1]) >= self.least)
