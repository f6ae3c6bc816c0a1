"""Run a function in a process with limits of time and memory, so that a hang or a crash costs only its own task.

The process is started once for each thread and used for many tasks, because its imports take seconds. It is
replaced after a task that had to be ended. Tasks and answers are lines of JSON.
"""

from __future__ import annotations

import atexit
import json
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

START_SECONDS = 300.0
"""[s] Maximum time in which a process starts and imports."""
TASKS_OF_PROCESS = 200
"""Number of tasks after which a process is replaced, so that its memory stays bounded."""


@dataclass(frozen=True, kw_only=True)
class TaskLimits:
    """TaskLimits of one task."""

    seconds: float = 900.0
    """[s]"""
    megabytes: float = 4000.0
    """[MB] Data of the process, with its libraries."""

    def as_list(self) -> list[float]:
        """Return both limits as plain data."""
        return [self.seconds, self.megabytes]


class TaskError(Exception):
    """A task failed; the message is one line."""


class TaskLimitError(TaskError):
    """A task needs more time or memory than its limits."""


class TaskKilledError(TaskError):
    """The process of a task was killed from outside, as by a system without memory."""


class _Worker:
    """A process that runs tasks one after another."""

    def __init__(self, megabytes: float) -> None:
        self.megabytes, self.n_tasks = megabytes, 0
        self.process = subprocess.Popen(
            [sys.executable, "-m", "sensorgraph.surveying.worker", str(megabytes)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"},
            text=True,
            encoding="utf-8",
        )
        self.lines: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()
        self.is_ready = False

    def _read(self) -> None:
        assert self.process.stdout is not None
        with suppress(ValueError):
            for line in self.process.stdout:
                self.lines.put(line)
        self.lines.put("")

    def line(self, seconds: float) -> str:
        """Return the next line; empty at the end of the process.

        Raises
        ------
        TaskError : No line came in time.
        """
        try:
            return self.lines.get(timeout=seconds)
        except queue.Empty:
            raise TaskLimitError(
                f"takes more than {seconds:g} s; raise the limit or shorten the log"
            ) from None

    def end(self) -> None:
        """Kill the process."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            with suppress(OSError, ValueError):
                if pipe is not None:
                    pipe.close()


_local = threading.local()
_all: set[_Worker] = set()
_is_ending = threading.Event()


def run_limited(work: str, arguments: Mapping[str, Any], limits: TaskLimits) -> Any:
    """Run a function in the process of this thread and return its result.

    Parameters
    ----------
    work : `module:function`, called with one dict, whose result can be written as JSON.

    Raises
    ------
    TaskError : The function failed, or its process crashed, hung or took too much memory.
    """
    worker: _Worker | None = getattr(_local, "worker", None)
    if worker not in _all:  # ended by `end_all`
        worker = None
    if worker is not None and (worker.megabytes != limits.megabytes or worker.n_tasks >= TASKS_OF_PROCESS):
        _drop(worker)
        worker = None
    if worker is None:
        worker = _local.worker = _Worker(limits.megabytes)
        _all.add(worker)
    try:
        if _is_ending.is_set():
            raise TaskKilledError("no task is started any more")
        if not worker.is_ready:
            worker.line(START_SECONDS)
            worker.is_ready = True
        assert worker.process.stdin is not None
        with suppress(OSError):  # the process is gone, and the next line is empty
            worker.process.stdin.write(json.dumps({"work": work, "arguments": dict(arguments)}) + "\n")
            worker.process.stdin.flush()
        worker.n_tasks += 1
        line = worker.line(limits.seconds)
    except BaseException:
        _drop(worker)
        raise
    if not line:
        code = worker.process.wait()
        _drop(worker)
        raise (TaskKilledError if code == -signal.SIGKILL else TaskError)(_crash(code))
    answer = json.loads(line)
    if "error" in answer:
        if answer.get("is_memory"):
            _drop(worker)
            raise TaskLimitError(
                f"needs more than {limits.megabytes:g} MB; raise the limit or shorten the log"
            )
        raise TaskError(answer["error"])
    return answer["result"]


def _crash(code: int) -> str:
    name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
    return f"the process of this log crashed ({name})"


def _drop(worker: _Worker) -> None:
    worker.end()
    _all.discard(worker)
    _local.worker = None


@atexit.register
def end_all() -> None:
    """End all processes of this module; tasks end at once, until `start_again`."""
    _is_ending.set()
    for worker in list(_all):
        worker.end()
        _all.discard(worker)


def start_again() -> None:
    """Allow tasks again after `end_all`."""
    _is_ending.clear()
