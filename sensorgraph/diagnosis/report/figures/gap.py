"""Draw the gap before and after the amendment, with the noise floor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sensorgraph.diagnosis.result import Gap
from sensorgraph.show.figures.style import (
    ALARM,
    INK,
    SOFT,
    SOLID,
    TEAL,
    new_figure,
    save_figure,
)

MIN_NATS_SCALE = 0.02
"""[nats] per reading, minimum span of the axis."""


def gap_picture(gaps: dict[str, Gap], second: Gap | None, path: Path) -> None:
    """Draw gap before, gap after and noise floor in three units, one row per channel.

    Parameters
    ----------
    second : of the scans of a second run
    """
    rows = [(name, gap, name) for name, gap in gaps.items()]
    rows += [] if second is None else [("scan, second run", second, "scan")]
    figure = new_figure(10.0, 0.35 + 1.15 * len(rows), layout=None)
    grid = figure.subplots(len(rows), 3, squeeze=False)
    figure.subplots_adjust(
        left=0.12,
        right=0.985,
        top=1 - 0.42 / (0.35 + 1.15 * len(rows)),
        bottom=0.02,
        wspace=0.22,
        hspace=0.55,
    )
    for charts, (title, gap, channel) in zip(grid, rows, strict=True):
        fits = (gap.before, gap.after, gap.noise_floor)
        unit = "cm" if channel == "scan" else "cm/s"
        least, floor = gap.noise_floor.nats_per_ray, max(gap.noise_floor.normalised, 1e-12)
        columns = (
            (f"{title}: RMS gap [{unit}]", [100 * f.rmse_m for f in fits]),
            ("times the noise floor", [f.normalised / floor for f in fits]),
            ("negative log-likelihood per reading", [f.nats_per_ray - least for f in fits]),
        )
        for axes, (label, values) in zip(charts, columns, strict=True):
            if not np.isfinite(values).all():
                axes.set_axis_off()
                continue
            _bars(axes, values, least=MIN_NATS_SCALE if label.startswith("negative") else 0.0)
            axes.set_title(label, fontsize=8.5, color=INK, loc="left", pad=3)
        charts[0].set_yticks([2, 1, 0], ["before", "after", "noise floor"], fontsize=8.5, color=INK)
        charts[0].tick_params(axis="y", length=0)
    save_figure(figure, path)


def _bars(axes: Any, values: Sequence[float], *, least: float) -> None:
    top = max(*values, least, 1e-12)
    axes.barh([2, 1, 0], np.maximum(values, 0.0), color=[ALARM, TEAL, SOFT], height=0.68)
    for y, value in zip([2, 1, 0], values, strict=True):
        text = f"{value:.2f}".replace("-", "−") if abs(value) >= 0.005 else "0"
        axes.text(max(value, 0) + 0.015 * top, y, text, va="center", fontsize=8, color=INK)
    axes.set(xlim=(0.0, 1.22 * top), ylim=(-0.5, 2.5))
    axes.set_yticks([])
    axes.set_xticks([])
    for side in ("top", "right", "bottom"):
        axes.spines[side].set_visible(False)
    axes.spines["left"].set_color(SOLID)
