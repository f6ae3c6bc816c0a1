"""Files for rerun's viewer (*.rrd): how they are written, and the colours that all of them share.

No viewer is needed to write one. An .rrd is checked strictly, carries no wall-clock time, and can be made again at any
time: the MCAP is the record.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from sensorgraph.files import atomic_file

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
            recording = rr.RecordingStream("sensorgraph", recording_id=name, send_properties=False)
            recording.save(part, default_blueprint=layout)
            yield recording
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


def open_viewer(path: Path) -> None:
    """Open a file in rerun's viewer, on this machine only."""
    subprocess.Popen(["rerun", "--bind", "127.0.0.1", str(path)])
