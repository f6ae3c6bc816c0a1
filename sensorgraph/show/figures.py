"""Pictures for reports; matplotlib is imported when the first is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from planners.arena import Arena
from sensorgraph.files import whole
from sensorgraph.types import Floats

INK, SOFT, FLOOR, SOLID, ALARM = "#23262f", "#8b90a0", "#ffffff", "#d9dce4", "#d1345b"
MOST_POINTS = 60_000
"""Of a drawn path."""


def new_figure(width: float, height: float, *, layout: Any = "constrained") -> Any:
    """Return an empty figure of so many inches, which no window shows."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=150, layout=layout, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Any, path: Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    with whole(path) as part:
        figure.savefig(part, format="png", metadata={"Software": None})


def draw_floor(axes: Any, arena: Arena, *, solid: int = -1) -> None:
    """Draw free space, what is solid, and the walls; `solid` is the zorder of what is solid."""
    from matplotlib.collections import LineCollection

    x0, y0, x1, y1 = arena.bounds
    pad = 0.02 * max(x1 - x0, y1 - y0)
    axes.set_facecolor(FLOOR)
    fill_solid(axes, arena, pad=pad, zorder=solid)
    axes.add_collection(LineCollection(list(arena.walls), colors=INK, linewidths=1.3, zorder=4))
    axes.set_xlabel("x [m]", color=INK)
    axes.set_ylabel("y [m]", color=INK)
    axes.set(xlim=(x0 - pad, x1 + pad), ylim=(y0 - pad, y1 + pad), aspect="equal")
    quiet(axes)


def fill_solid(
    axes: Any,
    arena: Arena,
    shift: Floats | tuple[float, float] = (0.0, 0.0),
    *,
    pad: float = 0.0,
    zorder: int,
) -> None:
    """Fill what is not free within the arena's bounds and `pad` [m] around, all moved by `shift` (2,) [m]."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    frame = arena.free.envelope.buffer(pad, join_style="mitre") if pad else arena.free.envelope
    solid = frame.difference(arena.free)
    for polygon in getattr(solid, "geoms", [solid]):
        rings = [np.asarray(ring.coords)[:, :2] + shift for ring in (polygon.exterior, *polygon.interiors)]
        outline = Outline.make_compound_path(*(Outline(ring, closed=True) for ring in rings if len(ring)))
        axes.add_patch(PathPatch(outline, facecolor=SOLID, edgecolor="none", zorder=zorder))


def quiet(axes: Any) -> None:
    """Take the frame back to two thin lines."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(SOFT)
    axes.tick_params(colors=INK, labelsize=8, length=3)
    axes.set_axisbelow(True)


def race_picture(races: dict[str, tuple[Any, Any, Any]], arena: Arena, path: Path) -> None:
    """Draw ways of driving side by side: bins visited over time, and where each has been.

    Parameters
    ----------
    races : label -> (minutes (n,), share of the reachable bins (n,) by then, Coverage)
    """
    x0, y0, x1, y1 = arena.bounds
    figure = new_figure(10.0, float(np.clip(3.4 * (y1 - y0) / max(x1 - x0, 1e-9), 2.2, 8.0)) + 0.7)
    axes = figure.subplots(1, 1 + len(races), width_ratios=[1.25, *([1.0] * len(races))])
    for (label, (minutes, share, coverage)), colour, chart in zip(
        races.items(), ("#2a788e", "#c9892b", ALARM), axes[1:], strict=False
    ):
        axes[0].plot(minutes, 100 * share, color=colour, lw=1.9, label=f"{label}: {100 * share[-1]:.1f} %")
        reachable = coverage.reachable.sum(axis=2)
        seen = np.where(reachable > 0, coverage.covered.sum(axis=2) / np.maximum(reachable, 1), np.nan)
        draw_floor(chart, arena)
        edges_x, edges_y, _ = coverage.edges
        mesh = chart.pcolormesh(edges_x, edges_y, 100 * seen.T, cmap="viridis", vmin=0, vmax=100, zorder=1)
        chart.set_title(f"{label}: headings visited", fontsize=9, color=INK, loc="left")
    axes[0].set(xlim=(0, None), ylim=(0, 103))
    axes[0].set_xlabel("driven [min]", color=INK)
    axes[0].set_ylabel("reachable (x, y, φ) bins visited [%]", color=INK)
    axes[0].grid(color=SOLID, lw=0.6)
    axes[0].legend(loc="upper left", frameon=False, fontsize=9, labelcolor=INK)
    quiet(axes[0])
    bar = figure.colorbar(mesh, ax=axes[1:].tolist(), shrink=0.8, aspect=30, pad=0.02)
    bar.set_label("headings [%]", color=INK, fontsize=8)
    bar.ax.tick_params(labelsize=8, colors=INK)
    bar.outline.set_visible(False)
    save_figure(figure, path)


def tracks_picture(tracks: Mapping[str, Floats], arena: Arena, path: Path) -> None:
    """Draw tracks (n, 2) [m] side by side over the same floor, one panel each."""
    x0, y0, x1, y1 = arena.bounds
    width = 5.0
    tall = float(np.clip(width * (y1 - y0) / max(x1 - x0, 1e-9), 2.0, 8.0))
    figure = new_figure(width * len(tracks), tall + 0.6)
    for axes, (name, track) in zip(
        figure.subplots(1, len(tracks), squeeze=False)[0], tracks.items(), strict=True
    ):
        draw_floor(axes, arena)
        every = max(len(track) // MOST_POINTS, 1)
        axes.plot(*track[::every].T, color=ALARM, lw=0.7, alpha=0.8, zorder=3)
        axes.plot(*track[0], "o", ms=7, mfc="white", mec=INK, mew=1.5, zorder=6)
        axes.set_title(name.replace("_", " "), loc="left", fontsize=10.5, color=INK)
    save_figure(figure, path)


def growth_picture(races: Mapping[str, Mapping[str, tuple[Floats, Floats]]], path: Path) -> None:
    """Draw coverage against driving time, a panel for each arena and a line for each way of driving.

    Parameters
    ----------
    races : arena -> label -> (seconds (n,), share of the reachable bins (n,) met by then)
    """
    figure = new_figure(5.2 * len(races), 3.9)
    for number, (arena, lines) in enumerate(races.items()):
        axes = figure.add_subplot(1, len(races), number + 1)
        longest = max(float(stamps[-1]) for stamps, _ in lines.values())
        unit, seconds = ("h", 3600.0) if longest > 2 * 3600 else ("min", 60.0)
        for (label, (stamps, share)), colour in zip(
            lines.items(), ("#2a788e", "#7ad151", "#c9892b", ALARM), strict=False
        ):
            name = f"{label.replace('_', ' ')}: {100 * share[-1]:.0f} %"
            axes.plot(stamps / seconds, 100 * share, color=colour, lw=1.9, label=name)
        axes.set(xlim=(0, None), ylim=(0, 103))
        axes.set_title(arena, loc="left", fontsize=10.5, color=INK)
        axes.set_xlabel(f"driven [{unit}]", color=INK)
        axes.grid(color=SOLID, lw=0.6)
        axes.legend(loc="upper left", frameon=False, fontsize=8.5, labelcolor=INK)
        quiet(axes)
        if number == 0:
            axes.set_ylabel("reachable (x, y, φ) bins met [%]", color=INK)
    save_figure(figure, path)
