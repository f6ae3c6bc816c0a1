"""Draw the influence of factors on a behaviour: the drives, and Sobol indices with their 95 % intervals."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sensorgraph.identification.influence import QUANTITIES, Influence, is_determined
from sensorgraph.show.figures.style import (
    INK,
    SMALL,
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

SHOWN_TRACKS = 32


def influence_picture(found: Influence, path: Path) -> None:
    """Draw some of the drives in the graph's walls, and a bar chart for each quantity that varies."""
    width = 4.2
    figure = new_figure(width + 7.0, map_height(width, found.walls.bounds, 4.2, 8.0) + TITLE_ROOM)
    left, right = figure.subfigures(1, 2, width_ratios=[width, 7.0])
    floor = left.subplots()
    draw_floor(floor, found.walls)
    for i in range(0, found.tracks.shape[1], max(1, found.tracks.shape[1] // SHOWN_TRACKS)):
        floor.plot(*found.tracks[:, i, :2].T, color=TEAL, lw=0.7, alpha=0.4, zorder=3)
    floor.plot(*found.track[:, :2].T, color=INK, lw=1.4, zorder=4)
    floor.plot(*found.start[:2], "o", ms=7, mfc="white", mec=INK, mew=1.5, zorder=6)
    floor.set_title("nominal drive (dark), varied drives", loc="left", fontsize=TITLE, color=INK)
    shown = [j for j in range(len(QUANTITIES)) if is_determined(found, j)]
    if shown:
        names, s = list(found.factors), found.shares
        place = np.arange(len(names))
        charts = np.atleast_1d(right.subplots(1, len(shown), sharey=True))
        for chart, j in zip(charts, shown, strict=True):
            label, _ = list(QUANTITIES.values())[j]
            for shift, share, span, colour, name in (
                (-0.18, s.first, s.first_interval, TEAL, "first order"), (0.18, s.total, s.total_interval, SOLID, "total")
            ):  # fmt: skip
                bars = np.clip(share[:, j], 0.0, 1.2)
                chart.barh(place + shift, bars, 0.34, color=colour, label=name, zorder=2)
                low, high = np.clip(span[:, j].T, 0.0, 1.2)
                chart.hlines(place + shift, low, high, color=INK, lw=1.0, zorder=3)
            chart.set(xlim=(0.0, 1.2), yticks=place, yticklabels=names, xticks=[0, 0.5, 1])
            chart.set_title(label.replace(", ", ",\n"), fontsize=SMALL, color=INK, loc="left")
            chart.tick_params(labelsize=SMALL)
            reduce_frame(chart)
        charts[0].invert_yaxis()  # shared by all
        charts[-1].legend(frameon=False, fontsize=SMALL, labelcolor=INK, loc="lower right")
        right.supxlabel("Sobol index (share of the variance), with 95 % interval", fontsize=SMALL, color=INK)
    save_figure(figure, path)
