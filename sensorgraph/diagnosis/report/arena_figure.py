"""Draw the arena from above: end points of measured rays, coloured by residual, before and after the amendment.

Another picture shows the path of the next run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planners.arena import Arena
from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.report.comparison import ComparedScans, SimulatedScans
from sensorgraph.diagnosis.scan.consequence import LEAST_CHANGE
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.show.figures.style import (
    ALARM,
    AMBER,
    INK,
    SOFT,
    TEAL,
    colour_bar,
    draw_floor,
    new_figure,
    save_figure,
)
from sensorgraph.types import Bools, Floats, Ints

MAX_POINTS, MAX_LOST_POINTS = 6000, 1500
"""Maximum numbers of end points and of missing returns in the picture."""
MAX_ROUTE_POINTS, MAX_STROKES = 2000, 150
"""Numbers of path points and of heading strokes in the picture."""


def arena_picture(finding: Finding, compared: ComparedScans, path: Path) -> None:
    """Draw the end points of rays, coloured by residual, before and after."""
    from matplotlib.collections import LineCollection

    x0, y0, x1, y1 = compared.limits
    aspect = (y1 - y0) / (x1 - x0)
    models = [
        ("before: simulator without effects", compared.before),
        ("after: simulator with the effects found", compared.after),
    ]
    if not compared.is_amended:
        models = [("measured against the simulator", compared.before)]
    stacked = aspect < 0.5
    across, down = (1, len(models)) if stacked else (len(models), 1)
    wide = float(min(8.6 if across == 1 else 4.1, 6.6 / aspect))
    factor = compared.magnification
    enlarged = f"\ndifferences magnified {factor} times" if factor > 1 else ""
    lines = 1 + enlarged.count("\n")
    figure = new_figure(
        max(wide * across + 1.5, 5.5),
        wide * aspect * down + 0.5 + (0.3 + 0.2 * lines) * down + 0.35 * _loses_rays(compared),
    )
    charts = list(figure.subplots(down, across, sharex=True, sharey=True, squeeze=False).ravel())
    top = float(f"{100 * max(1.2 * compared.typical_residual, 2.5 * compared.sigma):.1g}")
    colours = _diverging()
    for axes, (title, model) in zip(charts, models, strict=False):
        draw_floor(axes, compared.arena)
        axes.plot(compared.poses[:, 0], compared.poses[:, 1], color=SOFT, lw=0.6, alpha=0.5, zorder=1)
        dots = _points(axes, compared, model, top, colours)
        axes.set_title(title + enlarged, fontsize=9.5, color=INK, loc="left")
        axes.set(xlim=(x0, x1), ylim=(y0, y1))
        moved = _displaced(compared.before.walls, model.walls)
        axes.add_collection(
            LineCollection(list(moved), colors=TEAL, linewidths=1.4, linestyles=(0, (4, 2)), zorder=6)
        )
        _draw_marks(axes, compared, marks(finding, compared.arena))
    if len(charts) == 2 and not stacked:
        charts[1].set_ylabel("")
    colour_bar(
        figure,
        dots,
        charts,
        "measured − simulated [cm]",
        location="right",
        shrink=0.75,
        aspect=35,
        pad=0.015,
        extend="both",
    )
    handles, labels = charts[0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower left", frameon=False, fontsize=8, labelcolor=INK)
    save_figure(figure, path)


def _loses_rays(compared: ComparedScans) -> bool:
    """Return whether more returns are missing than with a careful setup."""
    return bool(compared.before.missing.mean() > SCAN.noise.loss[1])


def _displaced(walls: Floats, other: Floats) -> Floats:
    """Return the walls of `other` that moved along their normal; a change of length does not count."""
    if walls.shape != other.shape or len(walls) == 0:
        return np.zeros((0, 2, 2))
    way = walls[:, 1] - walls[:, 0]
    normal = np.stack([-way[:, 1], way[:, 0]], axis=1) / np.maximum(np.hypot(*way.T), 1e-9)[:, None]
    off = np.abs(((other - walls) * normal[:, None]).sum(axis=2)).max(axis=1)
    return np.asarray(other[off > LEAST_CHANGE])


def _diverging() -> Any:
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("short-long", ["#0b4f6c", TEAL, "#cfd4dc", ALARM, "#7d1130"])


def _points(axes: Any, compared: ComparedScans, model: SimulatedScans, top: float, colours: Any) -> Any:
    """Draw a random sample of end points, coloured by residual, and the expected end points of missing returns."""
    rng = np.random.default_rng(0)
    flat = _sampled(rng, np.isfinite(model.residual) & model.clear, MAX_POINTS)
    residual = model.residual.ravel()[flat]
    ends = compared.ends(flat, compared.enlarged_ranges(model).ravel()[flat])
    dots = axes.scatter(
        ends[:, 0],
        ends[:, 1],
        c=100 * residual,
        s=3.0,
        cmap=colours,
        vmin=-top,
        vmax=top,
        linewidths=0,
        zorder=5,
        rasterized=True,
    )
    missing = _sampled(rng, model.missing, MAX_LOST_POINTS)
    if len(missing) and _loses_rays(compared):
        ends = compared.ends(missing, model.aimed.ravel()[missing])
        label = f"no return where one is expected ({100 * model.missing.mean():.1f} % of all rays)"
        axes.scatter(
            ends[:, 0],
            ends[:, 1],
            s=9,
            facecolors="none",
            edgecolors=AMBER,
            linewidths=0.7,
            zorder=5,
            label=label,
        )
    return dots


def _sampled(rng: np.random.Generator, some: Bools, most: int) -> Ints:
    """Return the flat indices of at most `most` random rays of some, in order."""
    flat = np.flatnonzero(some)
    return np.sort(rng.choice(flat, most, replace=False)) if len(flat) > most else flat


def _draw_marks(axes: Any, compared: ComparedScans, shown: Sequence[PlaceMark]) -> None:
    """PlaceMark the places of effects and of unexplained differences: walls by a band, others by a ring."""
    from matplotlib.collections import LineCollection

    for mark in shown:
        if mark.walls:
            axes.add_collection(
                LineCollection(
                    mark.walls, colors=ALARM, linewidths=5.0, alpha=0.35, zorder=3.5, capstyle="round"
                )
            )
        else:
            axes.plot(*mark.xy, "o", ms=20, mfc="none", mec=ALARM, mew=1.6, zorder=7)
        _label(axes, compared, mark.xy, mark.title)


def _label(axes: Any, compared: ComparedScans, xy: tuple[float, float], text: str) -> None:
    x0, y0, x1, y1 = compared.limits
    right, upper = xy[0] > (x0 + x1) / 2, xy[1] > (y0 + y1) / 2
    axes.annotate(
        text, xy, xytext=(-16 if right else 16, -22 if upper else 22), textcoords="offset points",
        ha="right" if right else "left", va="center", fontsize=8.5, color=ALARM, zorder=8,
        bbox={"boxstyle": "round,pad=0.25", "fc": "white", "ec": "none", "alpha": 0.85},
        arrowprops={"arrowstyle": "-", "color": ALARM, "lw": 0.8},
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaceMark:
    """The place of an effect, or of an unexplained difference."""

    title: str
    xy: tuple[float, float]
    """[m, map]"""
    walls: list[Floats]
    """(2, 2) [m] each: sections of walls; empty for other places."""


def marks(finding: Finding, arena: Arena) -> list[PlaceMark]:
    """Return the marks of all effects, and of an unexplained difference, that have a place."""
    found = [(a.effect.title, point_of(a), wall_sections(arena, a)) for a in finding.effects]
    deviation = None if finding.unknown is None else finding.unknown.deviation
    if deviation is not None:
        name = deviation.label.split(",")[0] if deviation.partition.startswith("wall") else ""
        walls = [w for n, w in zip(arena.names, arena.walls, strict=True) if n == name]
        found.append(("unknown", deviation.xy, walls))
    out = []
    for title, xy, walls in found:
        if walls:
            x, y = np.mean(walls, axis=(0, 1)).tolist()
            out.append(PlaceMark(title=title, xy=(x, y), walls=walls))
        elif xy is not None:
            out.append(PlaceMark(title=title, xy=xy, walls=[]))
    return out


def point_of(a: Amendment) -> tuple[float, float] | None:
    """Return the point (x, y) [m, map] of an effect, if it has one."""
    if a.effect.place == "spot" and {"x", "y"} <= set(a.parameters):
        return float(a["x"]), float(a["y"])
    return None if a.location is None else a.location.xy


def wall_sections(arena: Arena, a: Amendment) -> list[Floats]:
    """Return the walls, or the part of a wall, of an effect; each (2, 2) [m]."""
    pairs = zip(arena.names, arena.walls, strict=True)
    chosen = [wall for name, wall in pairs if a.place and a.place in (name, name.rsplit("/", 1)[0])]
    if len(chosen) == 1 and {"a", "b"} <= set(a.parameters):
        first, last = chosen[0]
        direction = (last - first) / max(float(np.hypot(*(last - first))), 1e-9)
        return [np.stack([first + a["a"] * direction, first + a["b"] * direction])]
    return chosen


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
