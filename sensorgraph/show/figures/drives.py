"""Draw drives side by side: coverage over time, and tracks on the floor."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from planners.arena import Arena
from planners.coverage import Coverage
from sensorgraph.show.figures.style import (
    ALARM,
    AMBER,
    CHART_ROOM,
    FINE,
    INK,
    LINE,
    MAX_POINTS,
    SOLID,
    TEAL,
    TEXT,
    TITLE,
    TITLE_ROOM,
    colour_bar,
    draw_floor,
    map_height,
    new_figure,
    reduce_frame,
    save_figure,
)
from sensorgraph.types import Floats


def race_picture(races: dict[str, tuple[Floats, Floats, Coverage]], arena: Arena, path: Path) -> None:
    """Draw drives side by side: share of bins visited over time, and headings visited in each cell.

    Parameters
    ----------
    races : Label -> (minutes (n,), share of the reachable bins (n,) visited by then, Coverage).
    """
    figure = new_figure(10.0, map_height(3.4, arena.bounds, 2.2, 8.0) + CHART_ROOM)
    axes = figure.subplots(1, 1 + len(races), width_ratios=[1.25, *([1.0] * len(races))])
    for (label, (minutes, share, coverage)), colour, chart in zip(
        races.items(), (TEAL, AMBER, ALARM), axes[1:], strict=False
    ):
        axes[0].plot(minutes, 100 * share, color=colour, lw=LINE, label=f"{label}: {100 * share[-1]:.1f} %")
        reachable = coverage.reachable.sum(axis=2)
        seen = np.where(reachable > 0, coverage.covered.sum(axis=2) / np.maximum(reachable, 1), np.nan)
        draw_floor(chart, arena)
        edges_x, edges_y, _ = coverage.edges
        mesh = chart.pcolormesh(edges_x, edges_y, 100 * seen.T, cmap="viridis", vmin=0, vmax=100, zorder=1)
        chart.set_title(f"{label}: headings visited", fontsize=TEXT, color=INK, loc="left")
    axes[0].set(xlim=(0, None), ylim=(0, 103))
    axes[0].set_xlabel("driving time [min]", color=INK)
    axes[0].set_ylabel("reachable (x, y, φ) bins visited [%]", color=INK)
    axes[0].grid(color=SOLID, lw=FINE)
    axes[0].legend(loc="upper left", frameon=False, fontsize=TEXT, labelcolor=INK)
    reduce_frame(axes[0])
    colour_bar(figure, mesh, axes[1:].tolist(), "headings [%]", shrink=0.8, aspect=30, pad=0.02)
    save_figure(figure, path)


def tracks_picture(tracks: Mapping[str, Floats], arena: Arena, path: Path) -> None:
    """Draw tracks (n, 2) [m] on the same floor, one panel each."""
    width = 5.0
    figure = new_figure(width * len(tracks), map_height(width, arena.bounds, 2.0, 8.0) + TITLE_ROOM)
    for axes, (name, track) in zip(
        figure.subplots(1, len(tracks), squeeze=False)[0], tracks.items(), strict=True
    ):
        draw_floor(axes, arena)
        every = max(len(track) // MAX_POINTS, 1)
        axes.plot(*track[::every].T, color=ALARM, lw=0.7, alpha=0.8, zorder=3)
        axes.plot(*track[0], "o", ms=7, mfc="white", mec=INK, mew=1.5, zorder=6)
        axes.set_title(name.replace("_", " "), loc="left", fontsize=TITLE, color=INK)
    save_figure(figure, path)
