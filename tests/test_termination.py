"""SIGTERM, and the death of the parent: all processes end, nothing half-written remains."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from sensorgraph.cli import run as command
from sensorgraph.termination import Terminated

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="lists processes by /proc")
PROMPT = 5.0
"""[s] within which all processes end."""
SCRIPT = """
import hashlib, os, sys, time
from pathlib import Path
from logs.files import atomic_file
from sensorgraph.files import atomic_folder
from sensorgraph.cli import app, main
from sensorgraph.other_process import OtherProcess

def stuck():
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2 * 10**9)  # for minutes, in C

def loop():
    while True:
        time.sleep(0.01)

def work(kind, *, progress):
    with atomic_file(Path("theirs")) as part:
        part.write_text("half")
        Path("started").touch()
        globals()[kind]()

def _command() -> None:
    with OtherProcess(work, sys.argv[3]), atomic_file(Path("file")) as part, atomic_folder(Path("folder")) as inner:
        part.write_text("half")
        (inner / "half").touch()
        while not Path("started").exists():
            time.sleep(0.01)
        Path("ready").touch()
        globals()[sys.argv[2]]()

if __name__ == "__main__":
    app.command("wait", context_settings={"ignore_unknown_options": True, "allow_extra_args": True})(_command)
    main()
"""
"""A command with two processes, each of which waits in Python (`loop`) or in C (`stuck`) and writes files meanwhile."""


def parents() -> dict[int, int]:
    """Return process -> parent of all processes that are no zombies."""
    out = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                state, parent = (entry / "stat").read_text().rpartition(")")[2].split()[:2]
            except (FileNotFoundError, ProcessLookupError):
                continue
            if state != "Z":
                out[int(entry.name)] = int(parent)
    return out


def descendants(process: int) -> set[int]:
    """Return all descendants of a process."""
    known, found = parents(), {process}
    while more := {child for child, parent in known.items() if parent in found} - found:
        found |= more
    return found - {process}


def wait_for(path: Path, seconds: float = 60.0) -> None:
    until = time.monotonic() + seconds
    while not path.exists():
        assert time.monotonic() < until, f"{path} does not appear"
        time.sleep(0.02)


def assert_all_end(processes: set[int]) -> None:
    until = time.monotonic() + PROMPT
    while alive := processes & parents().keys():
        assert time.monotonic() < until, f"{len(alive)} of {len(processes)} processes live on"
        time.sleep(0.02)


@contextmanager
def started(words: list[str], folder: Path, ready: str) -> Iterator[subprocess.Popen[str]]:
    """Run Python in a folder until a file is there."""
    env = {**os.environ, "PYTHONPATH": str(Path.cwd())}
    process = subprocess.Popen(
        [sys.executable, *words],
        cwd=folder,
        env=env,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        try:
            wait_for(folder / ready)
            yield process
        finally:
            process.kill()


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="there is no other process")
@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        ("loop", "loop"),
        pytest.param("loop", "stuck", marks=pytest.mark.slow),
        pytest.param("stuck", "loop", marks=pytest.mark.slow),
        pytest.param("stuck", "stuck", marks=pytest.mark.slow),
    ],
)
def test_sigterm_ends_all_processes_and_removes_what_is_half_written(
    ours: str, theirs: str, tmp_path: Path
) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    with started(["script.py", "wait", ours, theirs], tmp_path, "ready") as process:
        family = {process.pid, *descendants(process.pid)}
        assert len(family) >= 2
        process.terminate()
        assert_all_end(family - {process.pid})
        assert process.wait(PROMPT) == 143
        assert process.stderr is not None and process.stderr.read() == "terminated\n"
    left = {path.name for path in tmp_path.rglob("*")} - {"__pycache__"}
    assert {name for name in left if not name.endswith(".pyc")} <= {"script.py", "started", "ready", "folder"}


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="there is no other process")
@pytest.mark.parametrize("theirs", ["loop", pytest.param("stuck", marks=pytest.mark.slow)])
def test_other_processes_end_when_the_command_is_killed(theirs: str, tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    with started(["script.py", "wait", "stuck", theirs], tmp_path, "ready") as process:
        family = descendants(process.pid)
        process.kill()
        assert_all_end(family)


def test_a_signal_in_a_finalizer_is_no_traceback() -> None:
    """Python prints and swallows what a finalizer raises; the process still ends, by its second thread."""
    code = (
        "import os, signal, sys, time\nfrom sensorgraph.termination import install\n"
        "class Late:\n    def __del__(self):\n        os.kill(os.getpid(), signal.SIGTERM)\n        time.sleep(0.1)\n"
        "class Wrong:\n    def __del__(self):\n        raise ValueError('told')\n"
        "install('terminated')\nlate = Wrong()\ndel late\nlate = Late()\ndel late\ntime.sleep(30)\n"
    )
    begin = time.monotonic()
    made = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert made.returncode == 143 and time.monotonic() - begin < 20
    assert "told" in made.stderr  # other exceptions are still reported
    assert "Terminated" not in made.stderr and made.stderr.endswith("terminated\n")


def test_terminated_is_no_error_that_a_command_reports(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Also if it arrives while compiled code returns, which raises a SystemError with it as the cause."""
    for error in (Terminated(), SystemError("returned a result with an exception set")):

        def read(*_: object, error: BaseException = error, **__: object) -> None:
            raise error from (None if isinstance(error, Terminated) else Terminated())

        monkeypatch.setattr("logs.read", read)
        assert command(["locate", str(tmp_path / "a.mcap")]) == 143
        assert capsys.readouterr().err.splitlines()[-1] == "terminated"


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize("ready", ["out/config.json", "out/check.mcap", "out/coverage.mcap"])
def test_a_demo_ends_with_all_its_processes(number: signal.Signals, ready: str, tmp_path: Path) -> None:
    with started(["-m", "sensorgraph", "demo", "-o", "out"], tmp_path, ready) as process:
        time.sleep(1.0)
        family = descendants(process.pid)
        process.send_signal(number)
        assert_all_end(family)
        assert process.wait(PROMPT) == (143 if number == signal.SIGTERM else -signal.SIGKILL)
    if number == signal.SIGTERM:
        assert not [path for path in tmp_path.rglob("*") if ".part" in path.name]


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize("seconds", [1.0, 8.0, 20.0])
def test_compile_ends_with_all_its_processes_and_leaves_whole_files(
    number: signal.Signals, code: int, seconds: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernels that are being compiled may be completed first."""
    (tmp_path / "temporary").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    with started(["-m", "sensorgraph", "compile"], tmp_path, "cache") as process:
        time.sleep(seconds)
        family = descendants(process.pid)
        process.send_signal(number)
        assert process.wait(30.0) == code
        assert_all_end(family)
    assert not list((tmp_path / "temporary").iterdir())
    assert not [path for path in (tmp_path / "cache").rglob("*") if path.suffix not in {"", ".nbi", ".nbc"}]
