"""Files for rerun's viewer (*.rrd): how they are written, and the colours that all of them share.

No viewer is needed to write one. An .rrd is checked strictly, carries no wall-clock time, and can be made again at any
time: the MCAP is the record.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from logs.files import atomic_file
from sensorgraph.errors import SensorgraphError

WHITE, ORANGE = (235, 235, 240), (255, 150, 40)
"""Measured; predicted or simulated."""
WALL, DIM, BACKGROUND = (150, 150, 165), (80, 100, 135), (18, 18, 22)
"""Walls; what stands back, such as the driven path; behind everything."""


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
            recording.send_blueprint(layout, make_active=False, make_default=True)
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
    """Open a file in rerun's viewer, on this machine only; the viewer of this environment goes before that of PATH.

    Raises
    ------
    SensorgraphError : there is no viewer
    """
    own = Path(sys.executable).parent
    viewer = shutil.which("rerun", path=str(own)) or shutil.which("rerun")
    if viewer is None:
        raise SensorgraphError(
            f"no viewer: neither {own / 'rerun'} nor one in PATH; {path} is written, open it where "
            "`pip install rerun-sdk` was run"
        )
    return subprocess.Popen([viewer, "--bind", "127.0.0.1", str(path)])
