"""Files for rerun's viewer (*.rrd): how they are written, and the colours that all of them share.

No viewer is needed to write one. An .rrd is checked strictly, carries no wall-clock time, and can be made again at any
time: the MCAP is the record.
"""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
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
"""Walls; what stands back, such as the driven path; behind everything."""

LOOPBACK = "127.0.0.1"
"""Viewers listen to this machine alone."""


@contextmanager
def recorded(path: Path, name: str, layout: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """Yield a recording to log to, with its own layout; on leaving the file is complete, after an exception not there."""
    was_strict = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        with atomic_file(path) as part:
            recording = rr.RecordingStream(
                "sensorgraph",
                recording_id=name,
                send_properties=False,
                batcher_config=rr.ChunkBatcherConfig.NEVER(),  # chunks do not depend on how busy the machine is
            )
            recording.set_log_time_enabled(False)
            stream = rr.binary_stream(recording)
            recording.send_blueprint(
                layout, make_active=True, make_default=True
            )  # a browser takes no default
            yield recording
            part.write_bytes(stream.read() or b"")  # rerun's own file sink says nothing of a full disk
            recording.disconnect()
    finally:
        rr.set_strict_mode(was_strict)


def folded() -> tuple[rrb.TimePanel, rrb.BlueprintPanel, rrb.SelectionPanel]:
    """Return the viewer's panels, all of them collapsed."""
    return (
        rrb.TimePanel(state="collapsed", timeline="time"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def open_viewer(path: Path) -> subprocess.Popen[bytes]:
    """Open a file in rerun's viewer, on this machine only.

    Raises
    ------
    SensorgraphError : there is no viewer
    """
    return subprocess.Popen([_viewer(path), "--bind", LOOPBACK, str(path)])


@contextmanager
def served(path: Path, *, patience: float = 30.0) -> Iterator[str]:
    """Serve a file with rerun's web viewer, to this machine only; yield the address to open, and end with the block.

    Parameters
    ----------
    patience : [s] to wait for the server

    Raises
    ------
    SensorgraphError : there is no viewer, or it does not answer
    """
    page, data = _free_ports(2)
    command = [_viewer(path), str(path), "--serve-web", "--bind", LOOPBACK, "--port", str(data)]
    log = ["--web-viewer-port", str(page)]
    server = subprocess.Popen(
        [*command, *log], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        end = time.monotonic() + patience
        while not (_answers(page) and _answers(data)):
            if server.poll() is not None or time.monotonic() > end:
                raise SensorgraphError(f"rerun's web viewer does not start; try: {' '.join(command)}")
            time.sleep(0.1)
        source = quote(f"rerun+http://{LOOPBACK}:{data}/proxy", safe="")
        yield f"http://{LOOPBACK}:{page}/?url={source}"
    finally:
        with suppress(ProcessLookupError):
            os.killpg(server.pid, signal.SIGTERM)  # `rerun` is a script that starts the viewer proper
        server.wait()


def _viewer(path: Path) -> str:
    """Return the viewer of this environment, else that of PATH."""
    own = Path(sys.executable).parent
    viewer = shutil.which("rerun", path=str(own)) or shutil.which("rerun")
    if viewer is None:
        raise SensorgraphError(
            f"no viewer: neither {own / 'rerun'} nor one in PATH; {path} is written, open it where "
            "`pip install rerun-sdk` was run"
        )
    return viewer


def _free_ports(count: int) -> list[int]:
    """Return ports that nobody listens on now."""
    with ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for one in sockets:
            one.bind((LOOPBACK, 0))
        return [int(one.getsockname()[1]) for one in sockets]


def _answers(port: int) -> bool:
    with socket.socket() as one:
        return one.connect_ex((LOOPBACK, port)) == 0
