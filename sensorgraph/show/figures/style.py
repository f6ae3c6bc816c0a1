"""Common elements of the pictures: colours, an empty figure, the floor of an arena, a colour bar, the file.

matplotlib is imported when the first figure is made.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from logs.files import atomic_file
from planners.arena import Arena
from sensorgraph.types import Floats

INK, SOFT = "#23262f", "#8b90a0"
"""Lines and text; secondary lines and text."""
FLOOR, SOLID = "#ffffff", "#d9dce4"
"""Free space; solid or unobserved space."""
TEAL, AMBER, ALARM = "#2a788e", "#c9892b", "#d1345b"
"""Good, or the main series; the second series; bad, or highlighted."""

TINY, SMALL, TEXT, SUBTITLE, TITLE, HEADLINE = 7, 8, 9, 10, 10.5, 11.5
"""[pt] Font sizes: statistics within a chart, ticks and legends, labels, and three levels of titles."""
MAX_POINTS = 60_000
"""Maximum number of points of a track, a cloud or a map; more are thinned evenly."""
FINE, LINE = 0.6, 1.9
"""[pt] Widths of grid lines and of a main curve."""
TITLE_ROOM, LEGEND_ROOM, CHART_ROOM = 0.6, 1.2, 0.7
"""[in] Height in addition to a map: for a title, for a title and a legend, for the axes of a chart."""


def map_height(extent: float, bounds: Sequence[float], least: float, most: float) -> float:
    """Return the height [in] of a map that is `extent` [in] wide, limited to `least` ... `most`; bounds in [m]."""
    x0, y0, x1, y1 = bounds
    return float(np.clip(extent * (y1 - y0) / max(x1 - x0, 1e-9), least, most))


def new_figure(width: float, height: float, *, layout: Any = "constrained") -> Any:
    """Return an empty figure of `width` x `height` [in] that is drawn to a file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=150, layout=layout, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Any, path: Path) -> None:
    """Write a figure as PNG; after an error there is no partial file."""
    with atomic_file(path) as part:
        figure.savefig(part, format="png", metadata={"Software": None})


def draw_floor(axes: Any, arena: Arena, *, solid: int = -1) -> None:
    """Draw free space, solid space and walls; `solid` is the zorder of solid space."""
    x0, y0, x1, y1 = arena.bounds
    pad = 0.02 * max(x1 - x0, y1 - y0)
    axes.set_facecolor(FLOOR)
    fill_solid(axes, solid_outline(arena, pad), zorder=solid)
    draw_walls(axes, arena.walls, 1.3)
    axes.set_xlabel("x [m]", color=INK)
    axes.set_ylabel("y [m]", color=INK)
    axes.set(xlim=(x0 - pad, x1 + pad), ylim=(y0 - pad, y1 + pad), aspect="equal")
    reduce_frame(axes)


def draw_walls(axes: Any, walls: Floats, width: float) -> None:
    """Draw walls (n, 2, 2) [m] as one line with gaps, because a building has thousands of them."""
    with_gaps = np.full((len(walls), 3, 2), np.nan)
    with_gaps[:, :2] = walls
    x, y = with_gaps.reshape(-1, 2).T
    axes.plot(x, y, color=INK, linewidth=width, solid_capstyle="butt", zorder=4)


def fill_solid(axes: Any, outline: Any, *, zorder: int) -> None:
    """Fill an outline of solid space."""
    from matplotlib.patches import PathPatch

    axes.add_artist(PathPatch(outline, facecolor=SOLID, edgecolor="none", zorder=zorder))


def solid_outline(arena: Arena, pad: float = 0.0) -> Any:
    """Return the space that is not free within the bounds of the arena plus `pad` [m], as one path of matplotlib."""
    from matplotlib.path import Path as Outline

    corners, ring = arena.solid_rings(pad)
    codes = np.full(len(corners), Outline.LINETO, dtype=Outline.code_type)
    codes[np.diff(ring, prepend=-1) != 0] = Outline.MOVETO
    codes[np.diff(ring, append=-1) != 0] = Outline.CLOSEPOLY
    return Outline(corners, codes)


def reduce_frame(axes: Any) -> None:
    """Reduce the frame of the axes to two thin lines, left and below."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(SOFT)
    axes.tick_params(colors=INK, labelsize=SMALL, length=3)
    axes.set_axisbelow(True)


def colour_bar(figure: Any, mapped: Any, axes: Any, label: str, **placing: Any) -> None:
    """Add a colour bar for the mappable `mapped` next to one or several axes."""
    bar = figure.colorbar(mapped, ax=axes, **placing)
    bar.set_label(label, color=INK, fontsize=SMALL)
    bar.ax.tick_params(labelsize=SMALL, colors=INK)
    bar.outline.set_visible(False)
