"""SIGTERM (`docker stop`, systemd, `kill`): clean up as after Ctrl-C, end all processes, and exit with 143.

The handler raises `Terminated` in the main thread. Python runs handlers only between its own instructions, so a
compiled loop delays it, and a C extension may swallow the exception. A second thread, which the system wakes at once,
therefore ends the process when the main thread does not do so in time. Other processes end when this one is gone:
each watches a pipe, or the sentinel of its parent.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from types import FrameType
from typing import Any

INTERRUPTED, TERMINATED = 128 + signal.SIGINT, 128 + signal.SIGTERM
"""Exit codes after a signal, as of a shell."""
REACTION = 2.0
"""[s] until the main thread must have reacted, which a long compiled loop prevents; systemd and Docker allow 10 s in all, or more."""
CLEANUP = 3.5
"""[s] until it must have cleaned up and ended."""
FINISH = 8.0
"""[s] the same if it completes a recording."""


class Terminated(BaseException):
    """SIGTERM arrived. It is no `Exception`, so that only clean-up code sees it."""


class _Watch:
    """What SIGTERM does in this process."""

    def __init__(self, line: str) -> None:
        self.line = line
        self.allowed = REACTION

    def handle(self, number: int, frame: FrameType | None) -> None:
        """Raise `Terminated` in the main thread; ignore the signal from now on."""
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        self.allowed = max(self.allowed, CLEANUP)
        raise Terminated

    def watch(self, pipe: int) -> None:
        """Wait for SIGTERM, whose number the system writes to the pipe; end this process if it outlives its time."""
        while os.read(pipe, 1) != bytes([signal.SIGTERM]):
            pass
        arrived = time.monotonic()
        _end_children()
        while (left := arrived + self.allowed - time.monotonic()) > 0:
            time.sleep(min(left, 0.1))
        _remove_unfinished()
        if self.line:
            with suppress(OSError):
                os.write(2, f"{self.line}\n".encode())
        os._exit(TERMINATED)


_watch: _Watch | None = None


def install(line: str = "") -> None:
    """Let SIGTERM end this process; call it once, in the main thread.

    Parameters
    ----------
    line : Line for standard error if the main thread does not react; if it does, it prints its own.
    """
    global _watch
    if os.name != "posix" or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        return
    read, write = os.pipe()
    os.set_blocking(write, False)
    _watch = _Watch(line)
    threading.Thread(target=_watch.watch, args=(read,), name="SIGTERM", daemon=True).start()
    signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    sys.unraisablehook = partial(_report_unraisable, sys.unraisablehook)
    signal.signal(signal.SIGTERM, _watch.handle)


def _report_unraisable(report: Callable[[Any], Any], args: Any) -> None:
    """Report an exception that a finalizer or callback swallowed; `Terminated` is none: the second thread ends us."""
    if not issubclass(args.exc_type, Terminated):
        report(args)


def allow_to_finish() -> None:
    """Give the main thread more time, because it completes a recording and then ends."""
    if _watch is not None:
        _watch.allowed = FINISH


def _end_children() -> None:
    """Send SIGTERM to the processes of `multiprocessing`, so that they clean up at the same time."""
    multiprocessing = sys.modules.get("multiprocessing")
    for child in multiprocessing.active_children() if multiprocessing else ():
        child.terminate()


def _remove_unfinished() -> None:
    """Remove the temporary files and folders that are being written."""
    for module in ("logs.files", "planners.files", "robotmodic_ident.files", "sensorgraph.files"):
        for path in tuple(getattr(sys.modules.get(module), "unfinished", ())):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
