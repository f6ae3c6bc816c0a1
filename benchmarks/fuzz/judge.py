"""How something ends: with a result or one line of ours, within limits of time and memory; or what is wrong."""

from __future__ import annotations

import contextlib
import io
import resource
import signal
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import NamedTuple

from logs.errors import LogError
from planners.errors import PlanError
from robotmodic_ident.errors import IdentError
from sensorgraph.errors import SensorgraphError

OURS = (LogError, PlanError, IdentError, SensorgraphError)
SECONDS = 10.0
"""[s] of CPU time; a small file takes less."""
MEMORY = 3 * 1024**3
"""[bytes] of address space that a small file may take beyond what is taken at the start."""


class Hung(BaseException):
    """It took longer than SECONDS."""


@contextlib.contextmanager
def limits(seconds: float) -> Iterator[None]:
    """Stop what takes longer than `seconds`, and refuse more than MEMORY."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise Hung

    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    before = signal.signal(signal.SIGPROF, stop)
    resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY, hard))
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signal.signal(signal.SIGPROF, before)


class Ending(NamedTuple):
    """How something ended."""

    wrong: str = ""
    """What is wrong with it."""
    refusal: str = ""
    """The line of ours with which it ended."""

    @property
    def word(self) -> str:
        """`ok`, `refused`, or what is wrong."""
        return self.wrong or ("refused" if self.refusal else "ok")


def judge(action: Callable[[], object], seconds: float = SECONDS) -> Ending:
    """Run something; return how it ends."""
    hidden = io.StringIO()
    try:
        with limits(seconds), warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            with contextlib.redirect_stdout(hidden), contextlib.redirect_stderr(hidden):
                action()
    except OURS as exc:
        text = str(exc)
        if not text.strip() or len(text.splitlines()) > 1:
            return Ending(f"{type(exc).__name__} of {len(text.splitlines())} lines: {text[:60]!r}")
        long = "" if len(text) < 1500 else f"a line of {len(text)} characters: {text[:60]!r}"
        return Ending(long, text)
    except Hung:
        return Ending(f"takes longer than {seconds:g} s")
    except BaseException as exc:
        frames = reversed(traceback.extract_tb(exc.__traceback__))
        frame = next((f for f in frames if "/site-packages/" not in f.filename), None)
        where = "" if frame is None else f" at {Path(frame.filename).name}:{frame.lineno}"
        return Ending(f"{type(exc).__name__}{where}: {' '.join(str(exc).split())[:80]}")
    return Ending()
