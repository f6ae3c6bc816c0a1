"""Write a watched run as a file for rerun's viewer: the map with the tracked robot, and the three statements over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from sensorgraph.show.rerun_file import BACKGROUND, DIM, ORANGE, WALL, WHITE, folded, recorded
from sensorgraph.watching.summary import PageData

COLOURS = {
    "ok": (60, 150, 175), "unknown": (110, 115, 130), "ambiguous": (224, 160, 48), "off": (209, 52, 91), "lost": (150, 30, 70),
}  # fmt: skip
NEW, GONE = (209, 52, 91), (90, 130, 240)
ARROW = 0.6
"""[m] Length of the arrow of the robot."""
SERIES = {
    "p_wrong": ("probability that the pose is wrong", ORANGE),
    "share": ("share that the graph predicts", WHITE),
}


def write_watched(data: PageData, path: Path) -> None:
    """Write a watched run as `path` (.rrd)."""
    with recorded(path, "watch", _layout(data)) as recording:
        recording.log("plan", rr.Transform3D(scale=[1, -1, 1]), static=True)  # the 2-D view's y points down
        recording.log("plan/walls", rr.LineStrips2D(list(data.walls), colors=WALL, radii=-0.8), static=True)
        for word in dict.fromkeys(word for _, _, word in data.path_pieces):
            lines = [data.path[a:b, :2] for a, b, own in data.path_pieces if own == word]
            strips = rr.LineStrips2D(lines, colors=COLOURS.get(word, DIM), radii=-0.8)
            recording.log(f"plan/path/{word}", strips, static=True)
        for kind, colour in (("new", NEW), ("gone", GONE)):
            outlines = [
                line for change in data.last.changes if change.kind == kind for line in change.outlines
            ]
            if outlines:
                strips = rr.LineStrips2D(outlines, colors=colour, radii=-2.0)
                recording.log(f"plan/{kind}", strips, static=True)
        _send_statements(recording, data)


def _send_statements(recording: rr.RecordingStream, data: PageData) -> None:
    """Send pose, sentences and series of all statements."""
    known = np.isfinite(data.path[:, 0])
    poses = data.path[known]
    vectors = ARROW * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    time = [rr.TimeColumn("time", duration=data.times[known])]
    colours = [COLOURS.get(word, DIM) for word, is_known in zip(data.words, known, strict=True) if is_known]
    columns = rr.Arrows2D.columns(origins=poses[:, :2], vectors=vectors, colors=colours)
    recording.send_columns("plan/robot", time, columns)
    every = [rr.TimeColumn("time", duration=data.times)]
    for name, values in (("p_wrong", data.p_wrong), ("share", data.shares)):
        label, colour = SERIES[name]
        recording.log(f"series/{name}", rr.SeriesLines(colors=colour, names=label, widths=1.5), static=True)
        recording.send_columns(f"series/{name}", every, rr.Scalars.columns(scalars=values))
    for row, spans in (("pose", data.pose_spans), ("place", data.place_spans), ("robot", data.robot_spans)):
        begun = [rr.TimeColumn("time", duration=[span.first for span in spans])]
        texts = [f"**{span.word}** at {span.first:.0f} s\n\n{span.text}" for span in spans]
        kinds = ["text/markdown"] * len(spans)
        recording.send_columns(f"said/{row}", begun, rr.TextDocument.columns(text=texts, media_type=kinds))


def _layout(data: PageData) -> rrb.Blueprint:
    """Return the layout: the map on the left, the statements on the right, the series below."""
    ends = np.concatenate([data.walls.reshape(-1, 2), data.path[np.isfinite(data.path[:, 0]), :2]])
    (x0, y0), (x1, y1) = ends.min(axis=0) - 1.0, ends.max(axis=0) + 1.0
    plan = rrb.Spatial2DView(
        name="teal ok, grey outside the graph, orange ambiguous, pink off, dark lost; pink outlines new, blue gone",
        origin="/", contents=["/plan/**"], background=BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=[x0, x1], y_range=[-y1, -y0]),
    )  # fmt: skip
    said = [rrb.TextDocumentView(name=row, origin=f"/said/{row}") for row in ("pose", "place", "robot")]
    series = rrb.TimeSeriesView(
        name="probabilities", origin="/series", axis_y=rrb.ScalarAxis(range=(0.0, 1.05))
    )
    right = rrb.Vertical(*said)
    return rrb.Blueprint(
        rrb.Vertical(rrb.Horizontal(plan, right, column_shares=[2, 1]), series, row_shares=[3, 1]),
        *folded(), auto_views=False,
    )  # fmt: skip
