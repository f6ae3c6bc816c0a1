"""Work in another process: its result, its errors, its progress, and its end."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from sensorgraph.other_process import OtherProcess
from sensorgraph.types import Progress, ProgressBars

seen: list[tuple[str, str, int, int]] = []


@contextmanager
def noted(title: str, unit: str = "") -> Iterator[Progress]:
    yield lambda done, total: seen.append((title, unit, done, total))


def count(n: int, *, progress: ProgressBars) -> tuple[int, int]:
    with progress("counting", "things") as tick:
        for k in range(n):
            tick(k, n)
            time.sleep(0.05)
    return n, os.getpid()


def fail(*, progress: ProgressBars) -> None:
    raise ValueError("no such thing")


def die(*, progress: ProgressBars) -> None:
    os._exit(3)


def test_it_gives_the_result_and_tells_its_progress() -> None:
    with OtherProcess(count, 40) as other:
        n, process = other.result(noted)
    assert n == 40
    assert (process != os.getpid()) == ((os.cpu_count() or 1) > 1)
    assert {stage[:2] for stage in seen} == {("counting", "things")}


def test_on_one_processor_it_works_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    with OtherProcess(count, 2) as other:
        assert other.result(noted) == (2, os.getpid())


def test_errors_come_over() -> None:
    with OtherProcess(fail) as other, pytest.raises(ValueError, match="no such thing"):
        other.result(noted)


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="would end this process")
def test_a_process_that_dies_is_an_error() -> None:
    with OtherProcess(die) as other, pytest.raises(RuntimeError, match="die ended without an answer"):
        other.result(noted)


SLOW = """
import multiprocessing, time
from pathlib import Path

if multiprocessing.current_process().name != "MainProcess":
    Path("started").touch()
    time.sleep(9)

def work(*, progress):
    pass
"""
"""A module that its process imports when Ctrl-C comes."""
INTERRUPTED = """
import os, signal, time
from pathlib import Path
from slow import work
from sensorgraph.other_process import OtherProcess

if __name__ == "__main__":
    try:
        with OtherProcess(work):
            while not Path("started").exists():
                time.sleep(0.01)
            try:
                os.killpg(0, signal.SIGINT)
                time.sleep(9)
            finally:
                time.sleep(0.3)  # as a busy process takes
    except KeyboardInterrupt:
        print("interrupted")
"""


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="there is no other process")
def test_ctrl_c_while_the_process_starts_ends_both_in_silence(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(SLOW)
    (tmp_path / "interrupted.py").write_text(INTERRUPTED)
    done = subprocess.run(
        [sys.executable, "interrupted.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path.cwd())},
        capture_output=True,
        text=True,
        timeout=30,
        start_new_session=True,
    )
    assert (done.stdout, done.stderr) == ("interrupted\n", "")
