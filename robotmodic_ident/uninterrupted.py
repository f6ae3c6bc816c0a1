"""Complete work that Ctrl-C, SIGTERM and the garbage collector must not interrupt; they take effect afterwards."""

from __future__ import annotations

import gc
import logging
import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import TypeVar

logger = logging.getLogger(__name__)
Result = TypeVar("Result")


def uninterrupted(work: Callable[[], Result]) -> Result:
    """Complete some work even if Ctrl-C or SIGTERM arrives meanwhile; then call the original handler.

    This is mainly for compilers: LLVM calls back into Python, cannot pass on an exception of a handler, and crashes.
    Python handles signals in its main thread; other threads are never interrupted. Numba makes hundreds of thousands of
    objects that stay in use; searching them for garbage would take a fifth of the compile time.
    """
    before = {
        number: handler
        for number in (signal.SIGINT, signal.SIGTERM)
        if callable(handler := signal.getsignal(number)) and not isinstance(handler, _Later)
    }
    if threading.current_thread() is not threading.main_thread() or not before:
        return _uncollected(work)
    later = _Later()
    for number in before:
        signal.signal(number, later)
    try:
        result = _uncollected(work)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    for arrived, frame in later.arrived.items():
        before[signal.Signals(arrived)](arrived, frame)
    return result


def _uncollected(work: Callable[[], Result]) -> Result:
    is_collecting = gc.isenabled()
    gc.disable()
    try:
        return work()
    finally:
        if is_collecting:
            gc.enable()


class _Later:
    """A signal handler that records the signals and warns once."""

    def __init__(self) -> None:
        self.arrived: dict[int, FrameType | None] = {}

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if not self.arrived:
            logger.warning("stopping after the current compilation")
        self.arrived.setdefault(number, frame)
