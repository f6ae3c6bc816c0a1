"""Defer Ctrl-C until a piece of work is complete, so that its result stays consistent."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from typing import Any, TypeVar

Result = TypeVar("Result")


def defer_interrupt(work: Callable[[], Result]) -> tuple[Result, bool]:
    """Complete some work even if Ctrl-C is pressed meanwhile; a second Ctrl-C takes effect at once.

    Python handles signals in its main thread; work in other threads is never interrupted.

    Returns
    -------
    The result of the work, and whether Ctrl-C was pressed.

    Raises
    ------
    KeyboardInterrupt : Ctrl-C was pressed twice.
    """
    if threading.current_thread() is not threading.main_thread():
        return work(), False
    was_interrupted = False

    def note_interrupt(signum: int, frame: Any) -> None:
        nonlocal was_interrupted
        if was_interrupted:
            raise KeyboardInterrupt
        was_interrupted = True

    before = signal.signal(signal.SIGINT, note_interrupt)
    try:
        return work(), was_interrupted
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)
