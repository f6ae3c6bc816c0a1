"""OMPL in a separate process: the client (`call_ompl`) and the server (`serve`).

Each request is answered in a fork that is seeded first. Equal queries therefore give equal paths, whatever
ran before, although OMPL's random streams advance over the life of a process. A crash of the bindings becomes
an error of the caller. Memory leaks and prints at exit stay in the fork. Searches stop by iteration count,
not by time, so a plan does not depend on the load of the machine. The process imports little, so it starts
fast.
"""

from __future__ import annotations

import atexit
import io
import os
import select
import signal
import struct
import subprocess
import sys
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from planners.errors import PlanError
from planners.types import ROUND_OFF, Floats

INSTALL_HINT = (
    "OMPL is not installed; pip install 'ompl>=2.0.1,<2.1' (Linux or macOS 15+; on Windows use WSL)"
)
EXIT_WITHOUT_OMPL = 3
"""Exit code of the process if ompl cannot be imported."""

HEADER = struct.Struct("<qq")
"""Length of the following message, and an exit code."""
JOIN_PLANNERS = (
    "RRTConnect", "BFMT", "BITstar", "BKPIECE1", "FMT", "InformedRRTstar", "KPIECE1", "LBKPIECE1", "RRT", "RRTstar", "SORRTstar",
)  # fmt: skip
"""Planners of ompl.geometric 2.0.1 that run from Python; the first is the default.

Excluded: PRM and PRMstar, whose threads never end when they call Python, and AORRTC, which crashes."""
CHECK_STEP = 0.01
"""[m] between the states of a motion that OMPL checks."""
CLEARANCE_SLACK = 0.002
"""[m] Added to the clearance in OMPL where start and goals allow it. A certified path may be this much below the
clearance, and it is the smallest margin of a plan."""


class _OmplServer:
    """A process that has imported OMPL and forks for each request."""

    def __init__(self, module: str) -> None:
        root = Path(__file__).parents[2]  # the folder that contains `planners`
        others = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-m", module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # only the client handles Ctrl-C
            env=os.environ
            | {"PYTHONPATH": os.pathsep.join([str(root), *others]), "OPENBLAS_NUM_THREADS": "1"},
        )

    def response_to(self, request: bytes) -> tuple[int, bytes]:
        """Return the exit code of the fork, and its response or error message."""
        sent, got = self.process.stdin, self.process.stdout
        assert sent is not None and got is not None
        try:
            sent.write(HEADER.pack(len(request), 0) + request)
            sent.flush()
            head = got.read(HEADER.size)
            if len(head) == HEADER.size:
                size, code = HEADER.unpack(head)
                return code, got.read(size)
        except BrokenPipeError:
            pass
        return self.process.wait(), b""

    def close(self) -> None:
        """Kill the process and its fork."""
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.communicate()


_idle: dict[tuple[str, str, int], list[_OmplServer]] = {}
"""Idle servers, by module, environment, and the process that started them."""
_lock = threading.Lock()


@atexit.register
def _close_all() -> None:
    for (_, _, owner), servers in _idle.items():
        for server in servers:
            if owner == os.getpid():
                server.close()
    _idle.clear()


def call_ompl(module: str, **request: Any) -> dict[str, np.ndarray]:
    """Send a request to a server and return its response; both are arrays by name.

    Parameters
    ----------
    module : Dotted name of the server module, run by `python -m`.

    Raises
    ------
    PlanError : OMPL is not installed, or the process failed.
    """
    sent = io.BytesIO()
    np.savez(sent, **request)
    kind = module, os.environ.get("PYTHONPATH", ""), os.getpid()
    with _lock:
        servers = _idle.setdefault(kind, [])
        server = servers.pop() if servers else _OmplServer(module)
    try:
        code, response = server.response_to(sent.getvalue())
    except BaseException:
        server.close()
        raise
    if server.process.poll() is None:
        with _lock:
            servers.append(server)
    else:
        server.close()
    if code == EXIT_WITHOUT_OMPL:
        raise PlanError(INSTALL_HINT)
    if code != 0:
        (detail,) = response.decode(errors="replace").strip().splitlines()[:1] or ["no message"]
        own = str(request.get("planner", ""))
        if ":" in own:  # a custom planner
            raise PlanError(f"join planner {own!r} ended with code {code} ({detail}); fix it, or use another")
        raise PlanError(f"OMPL ended with code {code} ({detail}); please report the arena and the seed")
    with np.load(io.BytesIO(response)) as data:
        return dict(data)


def serve(work: Callable[[Any, Any, Mapping[str, np.ndarray]], dict[str, Any]]) -> int:
    """Serve requests on standard input by `work(ompl.base, ompl.geometric, request)`, each in a fork.

    Returns
    -------
    An exit code when the input ends.
    """
    responses = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # OMPL may print
    try:
        from ompl import base, geometric, util  # type: ignore[import-untyped]
    except ImportError:
        return EXIT_WITHOUT_OMPL

    def respond(request: bytes) -> bytes:
        with np.load(io.BytesIO(request)) as data:
            arrays = dict(data)
        util.RNG.setSeed(int(arrays["seed"]) % (2**31 - 1) + 1)  # must be the first call; 0 is refused
        util.setLogLevel(util.LOG_NONE)
        response = io.BytesIO()
        np.savez(response, **work(base, geometric, arrays))
        return response.getvalue()

    while len(head := sys.stdin.buffer.read(HEADER.size)) == HEADER.size:
        code, response = _forked(respond, sys.stdin.buffer.read(HEADER.unpack(head)[0]))
        responses.write(HEADER.pack(len(response), code) + response)
        responses.flush()
    return 0


def _forked(work: Callable[[bytes], bytes], request: bytes) -> tuple[int, bytes]:
    """Run `work` in a fork; return its exit code, negative for a signal, and its response or error message."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        code, response = 1, b""
        try:
            code, response = 0, work(request)
        except BaseException as exc:
            response = f"{type(exc).__name__}: {exc}".encode()
        finally:
            with os.fdopen(write, "wb") as pipe:
                pipe.write(response)
            os._exit(code)
    os.close(write)
    response = _response_of(child, read)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), response


def _response_of(child: int, read: int) -> bytes:
    """Return what a fork writes to a pipe until it closes it; if the client is gone, end the fork and this process."""
    poll, parts = select.poll(), list[bytes]()
    poll.register(read, select.POLLIN)
    poll.register(sys.stdin.fileno(), 0)  # reports only the end of the input
    while True:
        ready = dict(poll.poll())
        if read in ready:
            part = os.read(read, 1 << 20)
            if not part:
                os.close(read)
                return b"".join(parts)
            parts.append(part)
        elif ready:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            os._exit(0)


def planner_named(name: str, geometric: Any, information: Any) -> Any:
    """Make a planner for a SpaceInformation: one of ompl.geometric by name, or a custom one as module:Class."""
    module, _, kind = name.rpartition(":")
    return getattr(import_module(module) if module else geometric, kind)(information)


class IterationLimit:
    """A termination condition that becomes true after `left` calls."""

    def __init__(self, left: int) -> None:
        self.left = left

    def __call__(self) -> bool:
        self.left -= 1
        return self.left < 0


class DistanceField:
    """The distance field as nested lists, which a Python callback reads several times faster than an array."""

    def __init__(self, distance: Floats, origin: Floats, step: float) -> None:
        self.rows: list[list[float]] = distance.tolist()
        self.low = (float(origin[0] + step / 2), float(origin[1] + step / 2))
        self.step = step
        self.size = (distance.shape[0] - 1, distance.shape[1] - 1)
        self.clearance = 0.0

    def value(self, x: float, y: float) -> float:
        """Interpolate the distance [m]; 0 outside the raster."""
        u, v = (x - self.low[0]) / self.step, (y - self.low[1]) / self.step
        i, j = int(u), int(v)
        if (
            u < 0 or v < 0 or i >= self.size[0] or j >= self.size[1]
        ):  # OMPL's bounds are closed: x may be the upper one
            return 0.0
        a, b = u - i, v - j
        near, far = self.rows[i], self.rows[i + 1]
        return (1 - a) * ((1 - b) * near[j] + b * near[j + 1]) + a * ((1 - b) * far[j] + b * far[j + 1])


@dataclass(frozen=True, kw_only=True)
class SamplingStage:
    """One attempt of the planner; the stages run in order until one succeeds."""

    window: float
    """[m] around start and goals, within which states are sampled."""
    max_step: float
    """[m] maximum length of the tree's edges."""
    iterations: int
    """Maximum number of iterations."""


class OmplProblem(ABC):
    """One OMPL problem, reused for every query, so that nothing leaks and its random streams continue.

    The constants of its subclasses were set with `python -m benchmarks.coverage_planners --arena --random 10 --first 1`
    (each `--drive`), by failed joins and planning time.
    """

    stages: Sequence[SamplingStage]
    n_solutions: int
    """Number of solutions per query, among which the best is chosen."""

    def __init__(
        self,
        base: Any,
        geometric: Any,
        space: Any,
        request: Mapping[str, np.ndarray],
        is_valid: Callable[[DistanceField, Any], bool],
    ) -> None:
        distance, origin, step = request["distance"], request["origin"], float(request["step"])
        self.base, self.space, self.clearance = base, space, float(request["clearance"])
        self.low, self.high = origin, origin + np.array(distance.shape) * step
        self._bound(self.low, self.high)
        self.field = DistanceField(distance, origin, step)
        self.setup = geometric.SimpleSetup(space)
        self.information = self.setup.getSpaceInformation()
        self.information.setStateValidityCheckingResolution(CHECK_STEP / space.getMaximumExtent())
        self.setup.setStateValidityChecker(partial(is_valid, self.field))  # it holds no OMPL object
        self.planner = planner_named(str(request["planner"]), geometric, self.information)
        self.setup.setPlanner(self.planner)

    @abstractmethod
    def path_of(self, path: Any, simplifier: Any) -> Floats | None:
        """Return the states (k, n) of a solution, after it is simplified; None if it is not valid."""

    def set_clearance(self, places: Floats) -> None:
        """Set the clearance of a query, with some slack if these places (n, 2) [m] allow it."""
        lowest = min(self.field.value(*place) for place in places.tolist())
        self.field.clearance = min(self.clearance + CLEARANCE_SLACK, max(lowest, self.clearance)) - ROUND_OFF

    def solutions(self, here: Any, there: list[Any], places: Floats) -> list[Floats]:
        """Return paths to one of the goals, sampled around places (n, 2) [m]; an empty list if none is found."""
        for stage in self.stages:
            if hasattr(self.planner, "setRange"):
                self.planner.setRange(stage.max_step)
            low, high = places.min(axis=0) - stage.window, places.max(axis=0) + stage.window
            self._bound(np.maximum(low, self.low), np.minimum(high, self.high))
            first = self._attempt(here, there, stage.iterations)
            if first is not None:
                others = [self._attempt(here, there, stage.iterations) for _ in range(self.n_solutions - 1)]
                return [first, *(path for path in others if path is not None)]
            self.field.clearance = self.clearance - ROUND_OFF
        return []

    def _attempt(self, here: Any, there: list[Any], iterations: int) -> Floats | None:
        goals = self.base.GoalStates(self.information)
        for state in there:
            goals.addState(state)
        self.setup.clear()
        self.setup.setStartState(here)
        self.setup.setGoal(goals)
        self.setup.solve(self.base.PlannerTerminationCondition(IterationLimit(iterations)))
        if not self.setup.haveExactSolutionPath():  # the status is true for approximate solutions too
            return None
        return self.path_of(self.setup.getSolutionPath(), self.setup.getPathSimplifier())

    def _bound(self, low: Floats, high: Floats) -> None:
        bounds = self.base.RealVectorBounds(2)
        for axis in range(2):
            bounds.setLow(axis, float(low[axis]))
            bounds.setHigh(axis, float(high[axis]))
        self.space.setBounds(bounds)
