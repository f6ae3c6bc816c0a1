"""Write files for rerun's viewer (*.rrd), open and serve them, and define their common colours.

Writing needs no viewer. An .rrd has no wall-clock time and can be made again from the MCAP at any time.
"""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from urllib.parse import quote

import rerun as rr
import rerun.blueprint as rrb

from logs.files import atomic_file
from sensorgraph.errors import SensorgraphError

WHITE, ORANGE = (235, 235, 240), (255, 150, 40)
"""Measured; predicted or simulated."""
WALL, DIM, BACKGROUND = (150, 150, 165), (80, 100, 135), (18, 18, 22)
"""Walls; background objects such as the driven path; the background."""

PATIENCE = 30.0
"""[s] Time limit for the start of a viewer or a server."""
SETTLE = 1.5
"""[s] Time after which a viewer without a display has ended; its server answers before."""
FLUSH = 5.0
"""[s] Longest time for which the end of a recording waits for the viewer."""
LOOPBACK = "127.0.0.1"
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
"""Variables of the environment, of which Linux sets one where there is a display."""
"""Viewers accept connections from this machine only."""


@contextmanager
def recorded(path: Path, name: str, layout: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """Yield a recording with a layout; the file is complete at the end, and does not exist after an exception."""
    was_strict = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        with atomic_file(path) as part:
            recording = rr.RecordingStream(
                "sensorgraph",
                recording_id=name,
                send_properties=False,
                batcher_config=rr.ChunkBatcherConfig.NEVER(),  # chunks do not depend on the load of the machine
            )
            recording.set_log_time_enabled(False)
            stream = rr.binary_stream(recording)
            recording.send_blueprint(
                layout, make_active=True, make_default=True
            )  # a browser ignores the default blueprint
            yield recording
            part.write_bytes(stream.read() or b"")  # rerun's own file sink does not report a full disk
            recording.disconnect()
    finally:
        rr.set_strict_mode(was_strict)


@contextmanager
def streamed(name: str, layout: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """Open rerun's viewer on this machine and yield a recording that it shows at once. The viewer stays open at the end.

    Raises
    ------
    SensorgraphError : There is no viewer, or it does not start.
    """
    (port,) = _free_ports(1)
    command = [_viewer(None), "--bind", LOOPBACK, "--port", str(port), "--expect-data-soon"]
    viewer = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    if _has_started(viewer, [port]):
        time.sleep(SETTLE)
    if viewer.poll() is not None or not _answers(port):
        _end(viewer)
        raise SensorgraphError(
            "rerun's viewer does not start, as it needs a display; leave out --show, and open OUT.rrd elsewhere"
        )
    recording = rr.RecordingStream("sensorgraph", recording_id=name, send_properties=False)
    recording.connect_grpc(f"rerun+http://{LOOPBACK}:{port}/proxy")
    recording.send_blueprint(layout, make_active=True, make_default=True)
    try:
        yield recording
        if viewer.poll() is None:  # nobody has closed it
            with suppress(RuntimeError):
                recording.flush(timeout_sec=FLUSH)
    finally:
        recording.disconnect()


def folded() -> tuple[rrb.TimePanel, rrb.BlueprintPanel, rrb.SelectionPanel]:
    """Return the viewer's panels, all collapsed."""
    return (
        rrb.TimePanel(state="collapsed", timeline="time"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def open_viewer(path: Path) -> subprocess.Popen[bytes]:
    """Open a file in rerun's viewer, on this machine only.

    Raises
    ------
    SensorgraphError : There is no viewer, or no display.
    """
    if sys.platform == "linux" and not any(map(os.environ.get, DISPLAYS)):
        raise SensorgraphError(
            f"rerun's viewer needs a display; {path} is written: open it on a machine with a display, or see it in a browser with "
            "--serve in place of --show"
        )
    return subprocess.Popen([_viewer(path), "--bind", LOOPBACK, str(path)])


@contextmanager
def served(path: Path) -> Iterator[str]:
    """Serve a file with rerun's web viewer to this machine until the block ends; yield the address to open.

    Raises
    ------
    SensorgraphError : There is no viewer, or it does not answer.
    """
    page, data = _free_ports(2)
    command = [_viewer(path), str(path), "--serve-web", "--bind", LOOPBACK, "--port", str(data)]
    log = ["--web-viewer-port", str(page)]
    server = subprocess.Popen(
        [sys.executable, "-c", WITH_PARENT, *command, *log],
        stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    try:
        if not _has_started(server, [page, data]):
            raise SensorgraphError(f"rerun's web viewer does not start; try: {' '.join(command)}")
        source = quote(f"rerun+http://{LOOPBACK}:{data}/proxy", safe="")
        yield f"http://{LOOPBACK}:{page}/?url={source}"
    finally:
        _end(server)


WITH_PARENT = """
import os, signal, subprocess, sys, threading

def end_with_parent():
    sys.stdin.buffer.read()
    os.killpg(0, signal.SIGTERM)

threading.Thread(target=end_with_parent, daemon=True).start()
sys.exit(subprocess.call(sys.argv[1:], stdin=subprocess.DEVNULL))
"""
"""Runs a command in a process group that ends when the pipe to this process closes, even if this process is killed."""


def _viewer(path: Path | None) -> str:
    """Return the viewer of this environment, else the viewer in PATH; `path` is the file to open, if there is one yet."""
    own = Path(sys.executable).parent
    viewer = shutil.which("rerun", path=str(own)) or shutil.which("rerun")
    if viewer is None:
        raise SensorgraphError(
            f"no viewer: expected {own / 'rerun'} or `rerun` in PATH; "
            + (
                "install rerun-sdk"
                if path is None
                else f"{path} is written, open it where rerun-sdk is installed"
            )
            + " (`pip install rerun-sdk`)"
        )
    return viewer


def _free_ports(count: int) -> list[int]:
    """Return free ports."""
    with ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for one in sockets:
            one.bind((LOOPBACK, 0))
        return [int(one.getsockname()[1]) for one in sockets]


def _has_started(viewer: subprocess.Popen[bytes], ports: Sequence[int]) -> bool:
    """Wait until a viewer answers on all ports; return whether it does so before it ends and in time."""
    end = time.monotonic() + PATIENCE
    while not all(map(_answers, ports)):
        if viewer.poll() is not None or time.monotonic() > end:
            return False
        time.sleep(0.1)
    return True


def _end(viewer: subprocess.Popen[bytes]) -> None:
    """End the process group of a viewer: `rerun` is a script that starts the viewer as a child."""
    with suppress(ProcessLookupError):
        os.killpg(viewer.pid, signal.SIGTERM)
    viewer.communicate()


def _answers(port: int) -> bool:
    with socket.socket() as one:
        return one.connect_ex((LOOPBACK, port)) == 0
