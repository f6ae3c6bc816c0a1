"""Pictures for reports; matplotlib is imported when the first is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from planners.arena import Arena, Floats
from sensorgraph.files import whole

if TYPE_CHECKING:
    from planners import Plan

INK, SOFT, FLOOR, SOLID, ALARM = "#23262f", "#8b90a0", "#ffffff", "#d9dce4", "#d1345b"
MOST_POINTS = 60_000
"""Of a drawn path."""


def plan_picture(plan: Plan, arena: Arena, path: Path, *, title: str = "") -> None:
    """Draw the plan over the arena with time as colour, its start and holes, and coverage over time."""
    x0, y0, x1, y1 = arena.bounds
    width = 10.0
    tall = float(np.clip(width * 0.60 * (y1 - y0) / max(x1 - x0, 1e-9), 3.2, 11.0))
    figure = new_figure(width, tall + 1.2)
    left, right = figure.subplots(1, 2, width_ratios=[2.4, 1.0])
    _route(figure, left, plan)
    draw_floor(left, arena)
    _coverage_curve(right, plan)
    report = plan.report
    hours, minutes = divmod(round(report["drive_time_s"] / 60), 60)
    lead = f"{title}:  " if title else ""
    figure.suptitle(
        f"{lead}{100 * report['coverage']:.2f} % of {report['reachable_cells']:,} (x, y, φ) bins in {hours} h {minutes:02d} min, "
        f"{report['ratio']:.2f} of the reference time",
        x=0.012, ha="left", fontsize=11.5, color=INK,
    )  # fmt: skip
    save_figure(figure, path)


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


def draw_floor(axes: Any, arena: Arena) -> None:
    """Draw free space, what is solid, and the walls."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    x0, y0, x1, y1 = arena.bounds
    pad = 0.02 * max(x1 - x0, y1 - y0)
    axes.set_facecolor(SOLID)
    for polygon in getattr(arena.free, "geoms", [arena.free]):
        rings = [np.asarray(ring.coords)[:, :2] for ring in (polygon.exterior, *polygon.interiors)]
        outline = Outline.make_compound_path(*(Outline(ring, closed=True) for ring in rings))
        axes.add_patch(PathPatch(outline, facecolor=FLOOR, edgecolor="none", zorder=0))
    axes.add_collection(LineCollection(list(arena.walls), colors=INK, linewidths=1.3, zorder=4))
    axes.set_xlabel("x [m]", color=INK)
    axes.set_ylabel("y [m]", color=INK)
    axes.set(xlim=(x0 - pad, x1 + pad), ylim=(y0 - pad, y1 + pad), aspect="equal")
    quiet(axes)


def _route(figure: Any, axes: Any, plan: Plan) -> None:
    from matplotlib.collections import LineCollection

    poses, stamps = plan.trajectory.poses, plan.trajectory.stamps
    moved = np.concatenate([[True], np.hypot(*np.diff(poses[:, :2], axis=0).T) > 1e-6])
    every = max(int(moved.sum()) // MOST_POINTS, 1)
    line, when = poses[moved][::every, :2], stamps[moved][::every] / 60.0
    pieces = np.stack([line[:-1], line[1:]], axis=1)
    extent = max(arena_side(plan), 1e-9)
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
    axes.scatter(spins[:, 0], spins[:, 1], s=size, color=INK, alpha=0.5, linewidths=0, zorder=3)
    _holes(axes, plan)
    axes.plot(*poses[0, :2], "o", ms=8, mfc="white", mec=ALARM, mew=2.0, zorder=6, ls="", label="start")
    bar = figure.colorbar(route, ax=axes, location="right", fraction=0.025, shrink=0.8, aspect=45, pad=0.015)
    bar.set_label("time [min]", color=INK, fontsize=8)
    bar.ax.tick_params(labelsize=8, colors=INK)
    bar.outline.set_visible(False)
    axes.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False, fontsize=8, labelcolor=INK,
        borderaxespad=0.3, borderpad=0.0, handletextpad=0.3,
    )  # fmt: skip


def _holes(axes: Any, plan: Plan) -> None:
    """Shade each cell by the share of its headings that the log misses."""
    from matplotlib.colors import to_rgb

    grid = plan.coverage
    missing = (grid.reachable & ~grid.covered).sum(axis=2) / np.maximum(grid.reachable.sum(axis=2), 1)
    if not missing.any():
        return
    shade = np.empty((*missing.T.shape, 4))
    shade[..., :3], shade[..., 3] = to_rgb(ALARM), 0.4 * missing.T
    x, y, _ = grid.edges
    axes.imshow(shade, origin="lower", extent=(x[0], x[-1], y[0], y[-1]), interpolation="nearest", zorder=1)
    cells = f"headings missing, in {int((missing > 0).sum()):,} cells"
    axes.scatter([], [], marker="s", s=40, color=ALARM, alpha=0.3, linewidths=0, label=cells)


def arena_side(plan: Plan) -> float:
    """Return the longer side [m] of the planned grid."""
    return float(max(plan.reach.shape) * plan.reach.cell)


def _coverage_curve(axes: Any, plan: Plan) -> None:
    """Draw the share of bins met against driving time."""
    stamps, share = plan.growth()
    minutes = stamps / 60.0
    axes.fill_between(minutes, 100 * share, color="#2a788e", alpha=0.15, linewidth=0)
    axes.plot(minutes, 100 * share, color="#2a788e", lw=1.8)
    reference = plan.report["t_ref_s"] / 60.0
    axes.axvline(reference, color=SOFT, lw=1.0, ls=(0, (4, 3)))
    axes.annotate(
        "reference time", (reference, 3), rotation=90, ha="right", va="bottom", fontsize=8, color=SOFT
    )
    axes.set(xlim=(0, max(float(minutes[-1]), reference) * 1.02), ylim=(0, 101.5))
    axes.set_xlabel("time [min]", color=INK)
    axes.set_ylabel("bins covered [%]", color=INK)
    axes.grid(color=SOLID, lw=0.6)
    quiet(axes)


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


def growth_picture(races: Mapping[str, tuple[Floats, Floats]], path: Path) -> None:
    """Draw coverage against driving time, a line for each way of driving.

    Parameters
    ----------
    races : label -> (minutes (n,), share of the reachable bins (n,) met by then)
    """
    figure = new_figure(7.0, 4.0)
    axes = figure.subplots()
    colours = ("#2a788e", "#7ad151", "#c9892b", ALARM)
    for (label, (minutes, share)), colour in zip(races.items(), colours, strict=False):
        name = f"{label.replace('_', ' ')}: {100 * share[-1]:.0f} %"
        axes.plot(minutes, 100 * share, color=colour, lw=1.9, label=name)
    axes.set(xlim=(0, None), ylim=(0, 103))
    axes.set_xlabel("driven [min]", color=INK)
    axes.set_ylabel("reachable (x, y, φ) bins visited [%]", color=INK)
    axes.grid(color=SOLID, lw=0.6)
    axes.legend(loc="center right", frameon=False, fontsize=9, labelcolor=INK)
    quiet(axes)
    save_figure(figure, path)
