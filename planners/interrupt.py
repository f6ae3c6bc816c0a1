"""Ctrl-C between two pieces of work, not within one: what is found by then stays whole."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from typing import Any, TypeVar

Result = TypeVar("Result")


def defer_interrupt(work: Callable[[], Result]) -> tuple[Result, bool]:
    """Do some work to its end though Ctrl-C comes meanwhile, and tell whether it did; a second one is let through.

    Python has signals handled by its main thread: other threads are not disturbed by Ctrl-C anyway.
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
