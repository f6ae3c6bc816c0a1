"""Draw a plan: the route with time as colour, the bins that count, and the bins left out with the reason."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from logs.transforms import distances_along
from planners import Plan
from planners.arena import Arena
from planners.holes import REASON_TEXTS, cut_off, unmet
from sensorgraph.show.figures.style import (
    ALARM,
    AMBER,
    FINE,
    FLOOR,
    HEADLINE,
    INK,
    LEGEND_ROOM,
    MAX_POINTS,
    SMALL,
    SOFT,
    SOLID,
    TEAL,
    TITLE,
    colour_bar,
    draw_floor,
    map_height,
    new_figure,
    reduce_frame,
    save_figure,
)

STEPS_PER_SIDE = 400
"""Number of route points along the longer side of the arena."""
MAX_RULED_CELLS = 40
"""Maximum number of cells along the longer side for which grid lines are drawn."""
REASONS = {
    "no_way_found": ALARM,
    "not_driven": AMBER,
    "no_forward_drive_there_and_back": "#8a6fb5",
    "behind_narrow_gaps": "#5b6b8c",
}
"""Colours of planners.holes.REASON_TEXTS."""
COUNTS = ("not_driven", "no_way_found")
"""Reasons that are failures of the plan; drawn on top of the others."""


def plan_picture(plan: Plan, arena: Arena, path: Path) -> None:
    """Draw the route with time as colour, its start and its missed bins, and coverage over time."""
    width = 10.0
    figure = new_figure(width, map_height(width * 0.60, arena.bounds, 3.2, 11.0) + LEGEND_ROOM)
    left, right = figure.subplots(1, 2, width_ratios=[2.4, 1.0])
    _route(figure, left, plan)
    draw_floor(left, arena)
    _no_go(left, plan)
    legend_above(left)
    _coverage_curve(right, plan)
    report = plan.report
    title_flush_left(
        figure,
        f"{100 * report['coverage']:.2f} % of {report['reachable_cells']:,} (x, y, φ) bins in "
        f"{_hours(report['drive_time_s'])}, {report['ratio']:.2f} of the reference time",
    )
    save_figure(figure, path)


def reach_picture(plan: Plan, arena: Arena, path: Path) -> None:
    """Draw the bins that count in each cell and, in a second panel, the bins left out by reason."""
    left_out = unmet(plan.coverage, plan.reach, plan.lost)
    behind = cut_off(plan.reach)
    panels = 2 if behind.any() or any(where.any() for where in left_out.values()) else 1
    width = 5.6
    tall = map_height(width - 0.6, arena.bounds, 2.0, 9.0)
    figure = new_figure(width * panels + 0.5, tall + 1.4)
    axes = figure.subplots(1, panels, squeeze=False)[0]
    _what_counts(figure, axes[0], plan, arena)
    if panels == 2:
        _left_out(axes[1], plan, arena)
    save_figure(figure, path)


def _route(figure: Any, axes: Any, plan: Plan) -> None:
    from matplotlib.collections import LineCollection

    poses, stamps = plan.trajectory.poses, plan.trajectory.stamps
    extent = max(_side(plan), 1e-9)
    driven = distances_along(poses)
    step = max(extent / STEPS_PER_SIDE, driven[-1] / MAX_POINTS)
    shown = np.append(np.flatnonzero(np.diff(np.floor(driven / step), prepend=-1.0)), len(driven) - 1)
    line, when = poses[shown, :2], stamps[shown] / 60.0
    pieces = np.stack([line[:-1], line[1:]], axis=1)
    route = LineCollection(
        list(pieces),
        array=when[:-1],
        cmap="viridis",
        linewidths=float(np.clip(9.0 / extent, 0.7, 1.3)),
        zorder=2,
    )
    route.set_capstyle("round")
    axes.add_collection(route)
    spins = plan.stops[abs(plan.stops[:, 3]) > np.pi]
    size = float(np.clip(220.0 / extent**2, 1.0, 10.0))
    dot: dict[str, Any] = {"color": INK, "alpha": 0.5, "linewidths": 0, "zorder": 3}
    axes.scatter(spins[:, 0], spins[:, 1], s=size, **dot)
    if len(spins):
        axes.scatter([], [], s=10.0, label="turn > 180°", **dot)
    _holes(axes, plan)
    _start(axes, plan)
    placing = {"location": "right", "fraction": 0.025, "shrink": 0.8, "aspect": 45, "pad": 0.015}
    colour_bar(figure, route, axes, "time [min]", **placing)


def _holes(axes: Any, plan: Plan) -> None:
    """Shade each cell by the share of its headings that the drive misses."""
    from matplotlib.colors import to_rgb

    grid = plan.coverage
    missing = (grid.reachable & ~grid.covered).sum(axis=2) / np.maximum(grid.reachable.sum(axis=2), 1)
    if not missing.any():
        return
    shade = np.empty((*missing.T.shape, 4))
    shade[..., :3], shade[..., 3] = to_rgb(ALARM), 0.4 * missing.T
    x, y, _ = grid.edges
    axes.imshow(shade, origin="lower", extent=(x[0], x[-1], y[0], y[-1]), interpolation="nearest", zorder=1)
    cells = f"headings missed in {int((missing > 0).sum()):,} cells"
    axes.scatter([], [], marker="s", s=40, color=ALARM, alpha=0.3, linewidths=0, label=cells)


def _side(plan: Plan) -> float:
    """Return the longer side [m] of the planned grid."""
    return float(max(plan.reach.shape) * plan.reach.cell)


def _coverage_curve(axes: Any, plan: Plan) -> None:
    """Draw the share of bins visited over driving time."""
    stamps, share = plan.growth()
    minutes = stamps / 60.0
    axes.fill_between(minutes, 100 * share, color=TEAL, alpha=0.15, linewidth=0)
    axes.plot(minutes, 100 * share, color=TEAL, lw=1.8)
    reference = plan.report["t_ref_s"] / 60.0
    axes.axvline(reference, color=SOFT, lw=1.0, ls=(0, (4, 3)))
    axes.annotate(
        "reference time", (reference, 3), rotation=90, ha="right", va="bottom", fontsize=SMALL, color=SOFT
    )
    axes.set(xlim=(0, max(float(minutes[-1]), reference) * 1.02), ylim=(0, 101.5))
    axes.set_xlabel("driving time [min]", color=INK)
    axes.set_ylabel("bins covered [%]", color=INK)
    axes.grid(color=SOLID, lw=FINE)
    reduce_frame(axes)


def _what_counts(figure: Any, axes: Any, plan: Plan, arena: Arena) -> None:
    """Shade each cell by the share of its headings that count; a line bounds the area of the robot's centre."""
    grid, free = plan.coverage, plan.reach
    share = 100 * grid.reachable.mean(axis=2)
    draw_floor(axes, arena, solid=2)
    x, y, _ = grid.edges
    shown = np.where(share > 0, share, np.nan).T
    lines = {"edgecolors": FLOOR, "linewidth": 0.3} if max(share.shape) <= MAX_RULED_CELLS else {}
    mesh = axes.pcolormesh(x, y, shown, cmap="GnBu", vmin=-30, vmax=170, zorder=1, **lines)
    mx, my = free.mask.shape
    nodes_x, nodes_y = (
        low + (np.arange(n) + 0.5) * free.step for low, n in zip(free.origin, (mx, my), strict=True)
    )
    depth = np.where(cut_off(free), 0.0, free.distance)
    axes.contour(nodes_x, nodes_y, depth.T, levels=[free.clearance], colors=[TEAL], linewidths=0.8, zorder=3)
    if share[share > 0].min() < 100:
        colour_bar(
            figure, mesh, axes, "headings that count [%]", fraction=0.03, shrink=0.7, aspect=40, pad=0.02,
            boundaries=np.arange(101), ticks=[0, 25, 50, 75, 100],
        )  # fmt: skip
    _start(axes, plan)
    _no_go(axes, plan)
    axes.plot([], [], color=TEAL, lw=0.9, label="limit of the robot's centre")
    cells, bins = int((share > 0).sum()), int(grid.reachable.sum())
    _panel_title(axes, f"Bins that count: {bins:,} in {cells:,} cells", 4)


def _left_out(axes: Any, plan: Plan, arena: Arena) -> None:
    """Shade each cell by the share of its headings that the plan leaves out, with one colour per reason."""
    from matplotlib.colors import to_rgb

    free, grid = plan.reach, plan.coverage
    draw_floor(axes, arena, solid=3)
    behind = cut_off(free)
    layers = [("behind_narrow_gaps", 1.0 * behind, f"{behind.sum() * free.step**2:.2g} m²")]
    for why, where in unmet(grid, free, plan.lost).items():
        layers.append((why, where.mean(axis=2), f"{int(where.sum()):,} bins"))
    x, y, _ = grid.edges
    for why, share, amount in sorted(layers, key=lambda layer: layer[0] in COUNTS):
        if not share.any():
            continue
        least = 0.8 if why in COUNTS else 0.25
        shade = np.empty((*share.T.shape, 4))
        shade[..., :3] = to_rgb(REASONS[why])
        shade[..., 3] = np.where(share > 0, least + (1 - least) * share, 0.0).T
        axes.imshow(
            shade, origin="lower", extent=(x[0], x[-1], y[0], y[-1]), interpolation="nearest", zorder=1
        )
        name = f"{REASON_TEXTS[why]}: {amount}"
        axes.scatter([], [], marker="s", s=40, color=REASONS[why], linewidths=0, label=name)
    missing = int(grid.reachable.sum()) - int(grid.covered.sum())
    _panel_title(axes, f"Left out: {missing:,} of the bins that count", 2)


def _panel_title(axes: Any, text: str, columns: int) -> None:
    """Write a panel's title above its legend, which has `columns` columns."""
    rows = -(-len(axes.get_legend_handles_labels()[1]) // columns)
    axes.set_title(text, loc="left", fontsize=TITLE, color=INK, pad=7 + 13 * rows)
    legend_above(axes, columns)


def _start(axes: Any, plan: Plan) -> None:
    """Mark the start and the end of the drive."""
    first, last = plan.trajectory.poses[[0, -1], :2]
    apart = np.hypot(*(last - first)) > 0.02
    name = "start" if apart else "start and end"
    axes.plot(*first, "o", ms=8, mfc="white", mec=ALARM, mew=2.0, zorder=6, ls="", label=name)
    if apart:
        axes.plot(*last, "s", ms=6.5, mfc="white", mec=INK, mew=1.8, zorder=6, ls="", label="end")


def _no_go(axes: Any, plan: Plan) -> None:
    """Hatch the no-go zones."""
    from matplotlib.patches import Polygon

    for number, corners in enumerate(plan.report.get("no_go", [])):
        style: dict[str, Any] = {
            "facecolor": "none",
            "edgecolor": REASONS["not_driven"],
            "linewidth": 1.0,
            "hatch": "////",
        }
        label = "_" if number else "no-go"
        axes.add_patch(Polygon(np.array(corners), zorder=3.5, label=label, **style))


def legend_above(axes: Any, columns: int = 4) -> None:
    """Put the legend above the axes."""
    axes.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, frameon=False, fontsize=SMALL, labelcolor=INK,
        borderaxespad=0.3, borderpad=0.0, handletextpad=0.4, columnspacing=1.4,
    )  # fmt: skip


def title_flush_left(figure: Any, text: str) -> None:
    """Write the title of the figure, flush left."""
    figure.suptitle(text, x=0.012, ha="left", fontsize=HEADLINE, color=INK)


def _hours(seconds: float) -> str:
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min"
