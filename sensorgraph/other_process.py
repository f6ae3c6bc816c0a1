"""Run a function in another process while this process continues."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import parent_process, resource_tracker
from multiprocessing.connection import Connection, wait
from types import TracebackType
from typing import Any, Generic, TypeVar

from sensorgraph import termination
from sensorgraph.garbage import search_less_often
from sensorgraph.termination import Terminated
from sensorgraph.types import Progress, ProgressBars

Result = TypeVar("Result")
MESSAGE_PERIOD = 0.2
"""[s] Interval of progress messages."""


class OtherProcess(Generic[Result]):
    """A function that runs in another process or, on a machine with one processor, here when `result` is called.

    Parameters
    ----------
    work : Function at module level that takes `arguments` and the keyword `progress`.
    """

    def __init__(self, work: Callable[..., Result], *arguments: object) -> None:
        self._work, self._arguments = work, arguments
        self._process: multiprocessing.process.BaseProcess | None = None
        self._stage: tuple[str, str, int, int] | None = None
        self._answer: tuple[bool, Any] | None = None

    def __enter__(self) -> OtherProcess[Result]:
        if (os.cpu_count() or 1) > 1:
            context = multiprocessing.get_context("spawn")
            ours, theirs = context.Pipe()
            self._process = context.Process(target=_run, args=(theirs,), daemon=True)
            resource_tracker.ensure_running()  # else it starts with the process and does not block Ctrl-C
            with _interrupt_blocked():  # also for the new process, until it can end without a traceback
                self._process.start()
            theirs.close()
            self._reader = threading.Thread(target=self._exchange, args=(ours,), daemon=True)
            self._reader.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process is not None:
            self._process.terminate()
            self._process.join(2 * termination.CLEANUP)
            self._process.kill()
            self._process.join()

    def result(self, progress: ProgressBars) -> Result:
        """Wait for the result and show the progress of the work.

        Raises
        ------
        Exception : The exception of the work.
        RuntimeError : The process ended without an answer.
        """
        if self._process is None:
            return self._work(*self._arguments, progress=progress)
        while self._reader.is_alive():
            stage = self._stage
            if stage is None:
                self._reader.join(MESSAGE_PERIOD)
                continue
            with progress(*stage[:2]) as tick:
                while self._reader.is_alive() and self._stage is not None and self._stage[:2] == stage[:2]:
                    tick(*self._stage[2:])
                    self._reader.join(MESSAGE_PERIOD)
        if self._answer is None:
            raise RuntimeError(f"{self._work.__name__} ended without an answer: was its process killed?")
        is_done, value = self._answer
        if not is_done:
            raise value
        result: Result = value
        return result

    def _exchange(self, pipe: Connection) -> None:
        """Send the work; receive messages (stage, unit, done, total) and the last message (success, result or error)."""
        try:
            pipe.send((self._work, self._arguments))
        except OSError:
            return
        except Exception as error:  # an argument cannot be pickled
            self._answer = False, error
            return
        while True:
            try:
                message = pipe.recv()
            except (EOFError, OSError):
                return
            if len(message) == 2:
                self._answer = message
                return
            self._stage = message


def _block_interrupt(is_blocked: bool) -> None:
    """Block or unblock Ctrl-C on systems that can block signals."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK if is_blocked else signal.SIG_UNBLOCK, {signal.SIGINT})


@contextmanager
def _interrupt_blocked() -> Iterator[None]:
    """Block Ctrl-C until the end of the block; processes started within inherit this."""
    _block_interrupt(True)
    try:
        yield
    finally:
        _block_interrupt(False)


def _end_with_parent() -> None:
    """End this process as on SIGTERM when its parent is gone, even if that was killed."""
    parent = parent_process()
    if parent is None:
        return

    def watch() -> None:
        wait([parent.sentinel])
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, name="parent", daemon=True).start()


def _run(pipe: Connection) -> None:
    """Receive the work, run it in this process, and send its progress and its result.

    The work is received only here, because its imports take seconds, in which SIGTERM may arrive.
    """

    @contextmanager
    def progress(title: str, unit: str = "") -> Iterator[Progress]:
        last = 0.0

        def tick(done: int, total: int) -> None:
            nonlocal last
            if time.monotonic() - last > MESSAGE_PERIOD:
                last = time.monotonic()
                pipe.send((title, unit, done, total))

        yield tick

    try:
        termination.install()
        search_less_often()
        _end_with_parent()
        _block_interrupt(False)
        try:
            work, arguments = pipe.recv()
            answer = True, work(*arguments, progress=progress)
        except Exception as error:
            pipe.send((False, error))
        else:
            pipe.send(answer)
    except (KeyboardInterrupt, OSError):  # OSError: the other process is gone
        return
    except Terminated:
        os._exit(termination.TERMINATED)  # the shutdown of the interpreter takes seconds
