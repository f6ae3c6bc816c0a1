"""Draw the coverage of each heading as a small map, all on one sheet."""

from __future__ import annotations

from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planners import Plan
from planners.arena import Arena
from planners.coverage import HEADINGS
from planners.holes import unmet
from sensorgraph.show.figures.plan import REASONS, legend_above, title_flush_left
from sensorgraph.show.figures.style import (
    ALARM,
    FLOOR,
    INK,
    SMALL,
    TEAL,
    draw_walls,
    fill_solid,
    new_figure,
    save_figure,
    solid_outline,
)
from sensorgraph.types import Floats

SHEET_WIDTH, SHEET_ASPECT = 10.0, 1.4
"""[in] Width of the sheet, and its approximate ratio of width to height."""


class BinState(IntEnum):
    """State of an (x, y, phi) bin."""

    NOT_REACHABLE = 0
    COVERED_IN_CORE = 1
    COVERED = 2
    COVERED_EARLIER = 3
    MISSED = 4
    NO_FORWARD_DRIVE = 5


LABEL_AND_COLOUR = {
    BinState.COVERED_IN_CORE: ("visited in the inner half", TEAL),
    BinState.COVERED: ("visited", "#8fc7cf"),
    BinState.COVERED_EARLIER: ("visited by an earlier run", "#b9a77c"),
    BinState.MISSED: ("missed", ALARM),
    BinState.NO_FORWARD_DRIVE: (
        "no forward drive there and back",
        REASONS["no_forward_drive_there_and_back"],
    ),
}
"""State -> label and colour, for each state that is drawn."""


def headings_picture(plan: Plan, arena: Arena, path: Path) -> None:
    """Draw for each heading the state of its cells; of many headings, draw evenly spaced ones."""
    from matplotlib.transforms import Affine2D

    grid = plan.coverage
    shown = np.unique(np.linspace(0, grid.headings, min(grid.headings, HEADINGS), endpoint=False).astype(int))
    size = np.array([arena.bounds[2] - arena.bounds[0], arena.bounds[3] - arena.bounds[1]])
    label = 0.15 * size.max()
    step = size + [0.08 * size.max(), label]
    columns = _columns(len(shown), step)
    sheet = step * [columns, -(-len(shown) // columns)]
    figure = new_figure(SHEET_WIDTH, float(SHEET_WIDTH * sheet[1] / sheet[0]) + 0.75)
    axes = figure.subplots()
    states = _bin_states(plan)
    walls, solid = list[Floats](), solid_outline(arena)
    for number, heading in enumerate(shown.tolist()):
        shift = step * [number % columns, -(number // columns)] - np.array(arena.bounds[:2])
        _map(axes, plan, states[:, :, heading], shift)
        fill_solid(axes, solid.transformed(Affine2D().translate(*shift)), zorder=2)
        _name(axes, plan, heading, shift + np.array(arena.bounds)[[0, 3]], label)
        walls.append(arena.walls + shift)
    draw_walls(axes, np.concatenate(walls), 0.7)
    pad = 0.02 * size.max()
    axes.set(xlim=(-pad, sheet[0] - step[0] + size[0] + pad), ylim=(step[1] - sheet[1] - pad, step[1]))
    axes.set_aspect("equal")
    axes.set_axis_off()
    for state, (name, colour) in LABEL_AND_COLOUR.items():
        if count := int((states == state).sum()):
            axes.scatter([], [], marker="s", s=40, color=colour, linewidths=0, label=f"{name}: {count:,}")
    legend_above(axes, len(BinState))
    some = "" if len(shown) == grid.headings else f"; {len(shown)} of {grid.headings} headings are drawn"
    title_flush_left(
        figure,
        f"Coverage by heading: {100 * grid.fraction:.2f} % of {int(grid.reachable.sum()):,} bins{some}",
    )
    save_figure(figure, path)


def _columns(n: int, step: Floats) -> int:
    """Return the number of maps in a row."""
    wanted = np.sqrt(n * SHEET_ASPECT * step[1] / step[0])
    whole = [k for k in range(1, n + 1) if n % k == 0]  # prefer a sheet without empty places
    nearest = min(whole, key=lambda k: abs(np.log(k / wanted)))
    return nearest if 0.6 < nearest / wanted < 1.7 else int(np.clip(round(wanted), 1, n))


def _bin_states(plan: Plan) -> NDArray[np.int64]:
    """Return the BinState of each bin (nx, ny, n_phi)."""
    grid = plan.coverage
    now = np.zeros_like(grid.covered)
    bins, inside = grid.bins(plan.curve.log(plan.report["rate"]))
    now[tuple(bins[inside].T)] = True
    covered = np.where(grid.core > 0, BinState.COVERED_IN_CORE, BinState.COVERED)
    other = np.where(grid.reachable, BinState.MISSED, BinState.NOT_REACHABLE)
    states = np.where(grid.covered, covered, other)
    states[grid.covered & ~now] = BinState.COVERED_EARLIER
    no_drive = unmet(grid, plan.reach, plan.lost)["no_forward_drive_there_and_back"]
    states[no_drive] = BinState.NO_FORWARD_DRIVE
    return np.asarray(states, dtype=np.int64)


def _map(axes: Any, plan: Plan, states: NDArray[np.int64], shift: Floats) -> None:
    """Draw one map, its lower left corner at `shift` [m]."""
    from matplotlib.colors import to_rgb

    paint = np.zeros((len(BinState), 4))
    paint[BinState.NOT_REACHABLE, :3] = to_rgb(FLOOR)
    for state, (_, colour) in LABEL_AND_COLOUR.items():
        paint[state] = (*to_rgb(colour), 1.0)
    x, y, _ = plan.coverage.edges
    extent = (x[0] + shift[0], x[-1] + shift[0], y[0] + shift[1], y[-1] + shift[1])
    axes.imshow(paint[states.T], origin="lower", extent=extent, interpolation="nearest", zorder=1)


def _name(axes: Any, plan: Plan, heading: int, corner: Floats, label: float) -> None:
    """Write the heading and its coverage above a map, with an arrow in its direction."""
    grid = plan.coverage
    phi = heading * 2 * np.pi / grid.headings
    middle = corner + label * np.array([0.32, 0.42])
    along = 0.24 * label * np.array([np.cos(phi), np.sin(phi)])
    axes.annotate(
        "", middle + along, middle - along, arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 1.0, "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip
    reachable = int(grid.reachable[:, :, heading].sum())
    share = 100 * grid.covered[:, :, heading].sum() / max(reachable, 1)
    label_text = (
        f"{np.degrees(phi):.4g}°   {np.floor(10 * share) / 10:g} %"
        if reachable
        else f"{np.degrees(phi):.4g}°   not reachable"
    )
    axes.text(*(corner + label * np.array([0.72, 0.42])), label_text, va="center", fontsize=SMALL, color=INK)
