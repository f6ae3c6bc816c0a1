"""Complete work that Ctrl-C must not interrupt; Ctrl-C takes effect afterwards."""

from __future__ import annotations

import logging
import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import TypeVar

logger = logging.getLogger(__name__)
Result = TypeVar("Result")


def uninterrupted(work: Callable[[], Result]) -> Result:
    """Complete some work even if Ctrl-C is pressed meanwhile; then call the original handler of Ctrl-C.

    This is mainly for compilers: LLVM calls back into Python, cannot pass on a KeyboardInterrupt, and crashes.
    Python handles signals in its main thread; other threads are never interrupted.
    """
    before = signal.getsignal(signal.SIGINT)
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or not callable(before) or isinstance(before, _Later):
        return work()
    later = _Later()
    signal.signal(signal.SIGINT, later)
    try:
        result = work()
    finally:
        signal.signal(signal.SIGINT, before)
    if later.frames:
        before(signal.SIGINT, later.frames[0])
    return result


class _Later:
    """A signal handler that records the signal and warns once."""

    def __init__(self) -> None:
        self.frames: list[FrameType | None] = []

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if not self.frames:
            logger.warning("stopping after the current compilation")
        self.frames.append(frame)
