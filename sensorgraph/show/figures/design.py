"""Draw a designed controller: its predicted drives, the real drive, and their wall distances."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from planners.arena import Arena
from sensorgraph.identification.design import ControllerDesign
from sensorgraph.identification.design_task import SAMPLE_STEP
from sensorgraph.show.figures.style import (
    ALARM,
    FINE,
    INK,
    SOLID,
    TEAL,
    TITLE,
    TITLE_ROOM,
    draw_floor,
    map_height,
    new_figure,
    reduce_frame,
    save_figure,
)
from sensorgraph.types import Floats
from sensorgraph.world.drive import ExecutedDrive
from sensorgraph.world.wall_distance import WallDistance

DISTANCE_BINS = 60


def design_picture(
    found: ControllerDesign, path: Path, driven: ExecutedDrive | None = None, arena: Arena | None = None
) -> None:
    """Draw the predicted drives in the graph's walls, the real drive if there is one, and their wall distances."""
    width = 5.0
    figure = new_figure(2 * width + 0.6, map_height(width, found.walls.bounds, 2.6, 8.0) + TITLE_ROOM)
    floor, chart = figure.subplots(1, 2)
    draw_floor(floor, arena or found.walls)
    every = max(1, round(SAMPLE_STEP / 0.01))
    for drive in found.tracks:
        floor.plot(*drive.poses[::every, :2].T, color=TEAL, lw=0.8, alpha=0.6, zorder=3)
    floor.plot(*found.start[:2], "o", ms=7, mfc="white", mec=INK, mew=1.5, zorder=6)
    floor.set_title(
        "predicted drives" + (" and real drive" if driven is not None else ""),
        loc="left",
        fontsize=TITLE,
        color=INK,
    )
    own = WallDistance(found.walls)
    predicted = [_distances(drive, own) for drive in found.tracks]
    top = max(float(np.max(part)) for part in predicted)
    edges = np.linspace(0.0, 1.1 * top, DISTANCE_BINS)
    shares = np.array([_share_below(part, edges) for part in predicted])
    chart.fill_between(
        edges,
        shares.min(axis=0),
        shares.max(axis=0),
        color=TEAL,
        alpha=0.35,
        lw=0,
        label="predicted, range",
    )
    chart.plot(edges, shares.mean(axis=0), color=TEAL, lw=1.5, label="predicted, mean")
    if driven is not None:
        floor.plot(*driven.poses[::every, :2].T, color=ALARM, lw=1.2, zorder=4)
        real = WallDistance(arena or found.walls)
        chart.plot(edges, _share_below(_distances(driven, real), edges), color=ALARM, lw=1.5, label="driven")
    chart.axvline(found.task.wall_distance, color=INK, lw=1.0, ls=":", label="requested")
    chart.set_title("cumulative distribution of wall distance", loc="left", fontsize=TITLE, color=INK)
    chart.set_xlabel("distance from the robot's centre to the nearest wall [m]", color=INK)
    chart.set_ylabel("share of time", color=INK)
    chart.grid(color=SOLID, lw=FINE)
    chart.legend(loc="upper left", frameon=False, fontsize=8.5, labelcolor=INK)
    reduce_frame(chart)
    save_figure(figure, path)


def _distances(drive: ExecutedDrive, walls: WallDistance) -> Floats:
    poses = drive.at(np.arange(drive.stamps[0], drive.stamps[-1], SAMPLE_STEP))
    return np.array([walls(x, y) for x, y in poses[:, :2]])


def _share_below(distances: Floats, edges: Floats) -> Floats:
    return np.asarray((distances[:, None] <= edges).mean(axis=0))
