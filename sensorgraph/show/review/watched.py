"""A watched run in rerun, statement by statement: the map with the tracked robot, and the three statements over time.

The same calls write a file and feed a viewer that is open while the robot drives.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from sensorgraph.show.rerun_file import BACKGROUND, ORANGE, WALL, WHITE, folded, recorded, streamed
from sensorgraph.types import Floats
from sensorgraph.watching.messages import outlines_of
from sensorgraph.watching.status import WatchStatus
from sensorgraph.watching.summary import ROWS, words_of

COLOURS = {
    "ok": (60, 150, 175), "unknown": (110, 115, 130), "ambiguous": (224, 160, 48), "off": (209, 52, 91), "lost": (150, 30, 70),
}  # fmt: skip
OUTLINES = {"new": (209, 52, 91), "gone": (90, 130, 240), "moved": (170, 110, 190)}
ARROW = 0.6
"""[m] Length of the arrow of the robot."""
PATH = "plan/path"
SERIES = {
    "p_wrong": ("probability that the pose is wrong", ORANGE),
    "share": ("share that the graph predicts", WHITE),
}


@contextmanager
def watched_recording(walls: Floats, path: Path) -> Iterator[WatchRecording]:
    """Open rerun's viewer and yield a recording that it shows as it grows; the file is complete at the end.

    Parameters
    ----------
    walls : (n, 2, 2) [m, map]

    Raises
    ------
    SensorgraphError : There is no viewer, or it does not start.
    """
    layout = _layout(walls)
    with streamed("watch", layout) as shown, recorded(path, "watch", layout) as kept:
        yield WatchRecording((shown, kept), walls)


class WatchRecording:
    """Statements over time; `add` takes one after the other."""

    def __init__(self, streams: Sequence[rr.RecordingStream], walls: Floats) -> None:
        self.streams = streams
        self._first: float | None = None
        self._at: Floats | None = None
        self._said: dict[str, str] = {}
        self._outlined: Sequence[bytes] | None = None
        # the y-axis of a 2-D view points down
        self._log("plan", rr.Transform3D(scale=[1, -1, 1]), static=True)
        self._log("plan/walls", rr.LineStrips2D(list(walls), colors=WALL, radii=-0.8), static=True)
        for name, (label, colour) in SERIES.items():
            self._log(f"series/{name}", rr.SeriesLines(colors=colour, names=label, widths=1.5), static=True)

    def add(self, status: WatchStatus) -> None:
        """Show one status."""
        self._first = status.t if self._first is None else self._first
        t, words = status.t - self._first, words_of(status)
        for stream in self.streams:
            stream.set_time("time", duration=t)
        self._add_pose(status, words[0])
        self._log("series/p_wrong", rr.Scalars(status.pose.p_wrong))
        if status.share_predicted is not None:
            self._log("series/share", rr.Scalars(status.share_predicted))
        for row, word, text in zip(ROWS, words, status.sentences(), strict=True):
            if text != self._said.get(row):
                self._said[row] = text
                since = status.pose.since - self._first if row == "pose" else t
                page = f"**{word}** since {since:.0f} s\n\n{text}"
                self._log(f"said/{row}", rr.TextDocument(page, media_type="text/markdown"))
        markers = outlines_of(status)
        outlined = [one.points.tobytes() for one in markers]
        if outlined != self._outlined:
            self._outlined = outlined
            for kind, colour in OUTLINES.items():
                lines = [one.points for one in markers if one.namespace == kind]
                self._log(f"plan/{kind}", rr.LineStrips2D(lines, colors=colour, radii=-2.0))

    def _add_pose(self, status: WatchStatus, word: str) -> None:
        """Show the robot, and its way since the last status."""
        pose, before = status.pose.pose, self._at
        self._at = None if pose is None else pose[:2]
        if pose is None:
            self._log("plan/robot", rr.Arrows2D.cleared())
            return
        arrow = ARROW * np.array([[np.cos(pose[2]), np.sin(pose[2])]])
        self._log("plan/robot", rr.Arrows2D(origins=[pose[:2]], vectors=arrow, colors=COLOURS[word]))
        if before is not None:
            self._log(PATH, rr.LineStrips2D([[before, pose[:2]]], colors=COLOURS[word], radii=-0.8))

    def _log(self, entity: str, what: rr.AsComponents, *, static: bool = False) -> None:
        for stream in self.streams:
            stream.log(entity, what, static=static)


def _layout(walls: Floats) -> rrb.Blueprint:
    """Return the layout: the map on the left, the statements on the right, the series below."""
    ends = walls.reshape(-1, 2)
    (x0, y0), (x1, y1) = ends.min(axis=0) - 1.0, ends.max(axis=0) + 1.0
    whole = rrb.VisibleTimeRanges(
        timeline="time", start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    plan = rrb.Spatial2DView(
        name="teal ok, grey outside the graph, orange ambiguous, pink off, dark lost; pink outlines new, blue gone, violet moved",
        origin="/", contents=["/plan/**"], background=BACKGROUND, overrides={PATH: whole},
        visual_bounds=rrb.VisualBounds2D(x_range=[x0, x1], y_range=[-y1, -y0]),
    )  # fmt: skip
    said = [rrb.TextDocumentView(name=row, origin=f"/said/{row}") for row in ROWS]
    series = rrb.TimeSeriesView(
        name="probabilities", origin="/series", axis_y=rrb.ScalarAxis(range=(0.0, 1.05))
    )
    right = rrb.Vertical(*said)
    return rrb.Blueprint(
        rrb.Vertical(rrb.Horizontal(plan, right, column_shares=[2, 1]), series, row_shares=[3, 1]),
        *folded(), auto_views=False,
    )  # fmt: skip
