"""Work that Ctrl-C must not cut in two: it is done first, and Ctrl-C takes effect afterwards."""

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
    """Do some work to its end however often Ctrl-C comes meanwhile; then let Ctrl-C do what it did before.

    For compilers above all: LLVM calls Python back, which cannot pass a KeyboardInterrupt on, and crashes. Python handles
    signals in its main thread; other threads are not disturbed anyway.
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
    """A signal handler that only notes that the signal came, and says so once."""

    def __init__(self) -> None:
        self.frames: list[FrameType | None] = []

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if not self.frames:
            logger.warning("stopping once what is being compiled is done")
        self.frames.append(frame)
