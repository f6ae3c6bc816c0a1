"""Draw the path of the next run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from planners.arena import Arena
from sensorgraph.show.figures.style import (
    ALARM,
    INK,
    draw_floor,
    new_figure,
    save_figure,
)
from sensorgraph.types import Floats

MAX_ROUTE_POINTS, MAX_STROKES = 2000, 150
"""Numbers of path points and of heading strokes in the picture."""


def next_run_picture(poses: Floats, arena: Arena, path: Path) -> None:
    """Draw the path (n, 3) [m, m, rad] of the next run in the arena, coloured by time."""
    from matplotlib.collections import LineCollection

    x0, y0, x1, y1 = arena.bounds
    aspect = float(np.clip((y1 - y0) / max(x1 - x0, 1e-9), 0.2, 3.0))
    wide = min(6.0, 5.5 / aspect)
    figure = new_figure(wide + 1.2, wide * aspect + 0.8)
    axes = figure.subplots()
    draw_floor(axes, arena)
    moved = np.concatenate([[True], np.hypot(*np.diff(poses[:, :2], axis=0).T) > 1e-4])
    way = poses[moved][:: max(1, int(moved.sum()) // MAX_ROUTE_POINTS), :2]
    share = np.linspace(0, 1, max(len(way) - 1, 1))
    pieces = list(np.stack([way[:-1], way[1:]], axis=1))
    line = LineCollection(pieces, array=share[: len(pieces)], cmap="viridis", linewidths=1.4, zorder=3)
    axes.add_collection(line)
    some = poses[:: max(1, len(poses) // MAX_STROKES)]
    axes.quiver(
        some[:, 0], some[:, 1], np.cos(some[:, 2]), np.sin(some[:, 2]), np.linspace(0, 1, len(some)),
        cmap="viridis", scale=22, width=0.003, headwidth=0, headlength=0, headaxislength=0, zorder=4,
    )  # fmt: skip
    axes.plot(*poses[0, :2], "o", ms=8, mfc="white", mec=ALARM, mew=2.0, zorder=6)
    axes.set_title(
        "start: ring; time: dark to bright; strokes: heading of the robot", fontsize=9, color=INK, loc="left"
    )
    save_figure(figure, path)
