"""Draw a located run: returns, track and its status, accepted and rejected loop closures, rival places."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from logs.motion import Motion
from logs.run import Run
from sensorgraph.localization.locate import deviations
from sensorgraph.localization.result import Localization
from sensorgraph.localization.scans import laser_rays
from sensorgraph.show.figures.style import (
    ALARM,
    AMBER,
    FINE,
    INK,
    LINE,
    SOFT,
    SOLID,
    TEAL,
    TEXT,
    TITLE_ROOM,
    map_height,
    new_figure,
    reduce_frame,
    save_figure,
)
from sensorgraph.types import Floats

MOST_POINTS = 400_000
"""Maximum number of returns that are drawn."""


def localization_picture(run: Run, found: Localization, path: Path, *, walls: Floats | None = None) -> None:
    """Draw the track of the robot and its returns in the map.

    Parameters
    ----------
    walls : (n, 2, 2) [m, map] Walls of the known place. None: no walls are drawn.
    """
    ok = np.array(found.status) == "ok"
    shown = np.flatnonzero(ok) if ok.any() else np.arange(len(ok))
    points = _returns(run, found, shown)
    inside = points if len(points) else found.poses[:, :2]
    low, high = np.percentile(inside, 0.5, axis=0) - 1.0, np.percentile(inside, 99.5, axis=0) + 1.0
    bounds = (low[0], low[1], high[0], high[1])
    figure = new_figure(9.0, map_height(8.4, bounds, 3.0, 12.0) + TITLE_ROOM)
    figure.get_layout_engine().set(h_pad=0.12)  # [in] else the title is cut
    axes = figure.subplots()
    if walls is not None:
        for wall in walls:
            axes.plot(wall[:, 0], wall[:, 1], color=SOLID, lw=LINE, zorder=0)
    axes.plot(points[:, 0], points[:, 1], ",", color=INK, alpha=0.5, zorder=1)
    _draw_track(axes, found)
    if found.rivals:
        x, y = np.concatenate(list(found.rivals.values()))[:, :2].T
        axes.plot(x, y, "x", color=AMBER, zorder=4, label=f"rival places: {len(x)}")
    for closures, colour, label in ((found.kept, SOFT, "accepted"), (found.refused, ALARM, "rejected")):
        for i, one in enumerate(closures):
            ends = found.poses[[one.first, one.second], :2]
            text = f"loop closures {label}: {len(closures)}" if i == 0 else None
            axes.plot(ends[:, 0], ends[:, 1], color=colour, lw=0.5 * FINE, alpha=0.8, zorder=1.5, label=text)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    sigma = np.median(deviations(found)[shown, :2])
    axes.set_title(
        f"{ok.sum():,} of {len(ok):,} scans located, median standard deviation {100 * sigma:.1f} cm",
        fontsize=TEXT,
        color=INK,
        loc="left",
    )
    axes.legend(loc="upper right", fontsize=TEXT, frameon=True, framealpha=0.8, labelcolor=INK)
    reduce_frame(axes)
    save_figure(figure, path)


def _draw_track(axes: object, found: Localization) -> None:
    colours = {"ok": TEAL, "ambiguous": AMBER, "lost": ALARM}
    states = np.array(found.status)
    for word, colour in colours.items():
        if (states == word).any():
            x, y = np.where((states == word)[:, None], found.poses[:, :2], np.nan).T
            axes.plot(x, y, color=colour, lw=2 * FINE, zorder=2, label=f"track: {word}")  # type: ignore[attr-defined]


def _returns(run: Run, found: Localization, shown: np.ndarray) -> Floats:
    """Return the end points (n, 2) [m] of rays in map, thinned and deskewed with the located motion."""
    sensor = found.sensor or run.sensor
    scans = shown[:: max(1, len(shown) * sensor.n_rays // MOST_POINTS)]
    track = np.column_stack([found.poses[shown, :2], np.unwrap(found.poses[shown, 2])])
    motion = Motion(stamps=run.stamps[shown], poses=track)
    rays = laser_rays(sensor, run.stamps[scans], motion, sensor.ray_delays)
    poses = found.poses[scans]
    cos, sin = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    x0 = poses[:, :1] + cos * rays[..., 0] - sin * rays[..., 1]
    y0 = poses[:, 1:2] + sin * rays[..., 0] + cos * rays[..., 1]
    ranges = np.where(np.isfinite(run.ranges[scans]), run.ranges[scans], np.nan)
    angle = poses[:, 2:] + rays[..., 2]
    points = np.stack([x0 + ranges * np.cos(angle), y0 + ranges * np.sin(angle)], axis=-1).reshape(-1, 2)
    seen: Floats = points[np.isfinite(points).all(axis=1)]
    return seen
