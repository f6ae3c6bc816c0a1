"""Coverage heading by heading: a small map for each, on one sheet."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planners.arena import Arena
from sensorgraph.show.figures import ALARM, FLOOR, INK, fill_solid, new_figure, save_figure
from sensorgraph.show.figures_plan import REASONS, TEAL, head, key
from sensorgraph.types import Floats

if TYPE_CHECKING:
    from planners import Plan

MOST = 16
"""Headings that are drawn."""
SHAPE = 1.4
"""Width over height that the sheet comes near to."""
WIDTH = 10.0
"""[in]"""
KINDS = (
    ("", FLOOR),
    ("met in the inner half", TEAL),
    ("met", "#8fc7cf"),
    ("met by an earlier run", "#b9a77c"),
    ("missed", ALARM),
    ("no forward drive there and back", REASONS["no_forward_drive_there_and_back"]),
)
"""What can be said of a bin, and its colour."""


def headings_picture(plan: Plan, arena: Arena, path: Path) -> None:
    """Draw for each heading (for some, evenly chosen, where there are many) which cells the log meets, and how."""
    from matplotlib.collections import LineCollection

    grid = plan.coverage
    shown = np.unique(np.linspace(0, grid.headings, min(grid.headings, MOST), endpoint=False).astype(int))
    size = np.array([arena.bounds[2] - arena.bounds[0], arena.bounds[3] - arena.bounds[1]])
    label = 0.15 * size.max()
    step = size + [0.08 * size.max(), label]
    columns = _columns(len(shown), step)
    sheet = step * [columns, -(-len(shown) // columns)]
    figure = new_figure(WIDTH, float(WIDTH * sheet[1] / sheet[0]) + 0.75)
    axes = figure.subplots()
    kinds = _kinds(plan)
    walls: list[Floats] = []
    for number, heading in enumerate(shown.tolist()):
        shift = step * [number % columns, -(number // columns)] - np.array(arena.bounds[:2])
        _map(axes, arena, plan, kinds[:, :, heading], shift)
        _name(axes, plan, heading, shift + np.array(arena.bounds)[[0, 3]], label)
        walls += list(arena.walls + shift)
    axes.add_collection(LineCollection(walls, colors=INK, linewidths=0.7, zorder=4))
    pad = 0.02 * size.max()
    axes.set(xlim=(-pad, sheet[0] - step[0] + size[0] + pad), ylim=(step[1] - sheet[1] - pad, step[1]))
    axes.set_aspect("equal")
    axes.set_axis_off()
    for kind in range(1, len(KINDS)):
        if count := int((kinds == kind).sum()):
            name, colour = KINDS[kind]
            axes.scatter([], [], marker="s", s=40, color=colour, linewidths=0, label=f"{name}: {count:,}")
    key(axes, len(KINDS))
    some = "" if len(shown) == grid.headings else f"; {len(shown)} of {grid.headings} headings are drawn"
    head(
        figure, f"Heading by heading: {100 * grid.fraction:.2f} % of {int(grid.reachable.sum()):,} bins{some}"
    )
    save_figure(figure, path)


def _columns(n: int, step: Floats) -> int:
    """Return how many maps to put side by side."""
    wanted = np.sqrt(n * SHAPE * step[1] / step[0])
    whole = [k for k in range(1, n + 1) if n % k == 0]  # a sheet without a gap, if that is not far off
    nearest = min(whole, key=lambda k: abs(np.log(k / wanted)))
    return nearest if 0.6 < nearest / wanted < 1.7 else int(np.clip(round(wanted), 1, n))


def _kinds(plan: Plan) -> NDArray[np.int64]:
    """Return (nx, ny, n_phi) what is to be said of each bin, as an index of KINDS."""
    from planners.holes import unmet

    grid = plan.coverage
    now = np.zeros_like(grid.covered)
    bins, inside = grid.bins(plan.curve.log(plan.report["rate"]))
    now[tuple(bins[inside].T)] = True
    kinds = np.where(grid.covered, np.where(grid.core > 0, 1, 2), np.where(grid.reachable, 4, 0))
    kinds[grid.covered & ~now] = 3
    kinds[unmet(grid, plan.reach, plan.lost)["no_forward_drive_there_and_back"]] = 5
    return np.asarray(kinds, dtype=np.int64)


def _map(axes: Any, arena: Arena, plan: Plan, kinds: NDArray[np.int64], shift: Floats) -> None:
    """Draw one map, its lower left corner at `shift` [m]."""
    from matplotlib.colors import to_rgb

    paint = np.array([(*to_rgb(colour), 1.0) for _, colour in KINDS])
    paint[0, 3] = 0.0
    x, y, _ = plan.coverage.edges
    extent = (x[0] + shift[0], x[-1] + shift[0], y[0] + shift[1], y[-1] + shift[1])
    axes.imshow(paint[kinds.T], origin="lower", extent=extent, interpolation="nearest", zorder=1)
    fill_solid(axes, arena, shift, zorder=2)


def _name(axes: Any, plan: Plan, heading: int, corner: Floats, label: float) -> None:
    """Write the heading and its coverage above a map, with an arrow that points there."""
    grid = plan.coverage
    phi = heading * 2 * np.pi / grid.headings
    middle = corner + label * np.array([0.32, 0.42])
    along = 0.24 * label * np.array([np.cos(phi), np.sin(phi)])
    axes.annotate(
        "", middle + along, middle - along, arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 1.0, "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip
    reachable = int(grid.reachable[:, :, heading].sum())
    share = 100 * grid.covered[:, :, heading].sum() / max(reachable, 1)
    told = (
        f"{np.degrees(phi):.4g}°   {np.floor(10 * share) / 10:g} %"
        if reachable
        else f"{np.degrees(phi):.4g}°   nothing counts"
    )
    axes.text(*(corner + label * np.array([0.72, 0.42])), told, va="center", fontsize=8, color=INK)
