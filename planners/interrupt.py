"""Ctrl-C between two pieces of work, not within one, so that what was found by then stays whole."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from typing import Any, TypeVar

Result = TypeVar("Result")


def defer_interrupt(work: Callable[[], Result]) -> tuple[Result, bool]:
    """Do some work to its end even if Ctrl-C comes meanwhile; a second Ctrl-C is let through.

    Python handles signals in its main thread; work in other threads is not disturbed anyway.

    Returns
    -------
    result of the work, and whether Ctrl-C came

    Raises
    ------
    KeyboardInterrupt : Ctrl-C came twice
    """
    if threading.current_thread() is not threading.main_thread():
        return work(), False
    was_asked = False

    def noted(signum: int, frame: Any) -> None:
        nonlocal was_asked
        if was_asked:
            raise KeyboardInterrupt
        was_asked = True

    before = signal.signal(signal.SIGINT, noted)
    try:
        return work(), was_asked
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)
