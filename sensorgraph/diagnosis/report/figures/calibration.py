"""Draw wheel and mount parameters of one or two runs over time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sensorgraph.diagnosis.motion.calibration.comparison import block_estimates
from sensorgraph.diagnosis.motion.calibration.estimate import PARAMETERS, DrivingCalibration
from sensorgraph.diagnosis.motion.calibration.settings import CALIBRATION
from sensorgraph.diagnosis.motion.calibration.words import QUANTITIES
from sensorgraph.show.figures.style import (
    ALARM,
    FINE,
    INK,
    SMALL,
    SOFT,
    SOLID,
    SUBTITLE,
    TEAL,
    TEXT,
    new_figure,
    reduce_frame,
    save_figure,
)


def calibration_picture(runs: Mapping[str, DrivingCalibration], path: Path) -> None:
    """Draw each parameter of each run: estimate with two standard errors, parts of the run, and specified value."""
    figure = new_figure(9.0, 6.2)
    axes = figure.subplots(2, 3).ravel()
    start, ticks = 0.0, list[float]()
    for (name, found), colour in zip(runs.items(), (TEAL, ALARM), strict=False):
        values, errors, middles = block_estimates(found, CALIBRATION.blocks)
        minutes = (start + middles) / 60.0
        span = np.array([start, start + found.duration_s]) / 60.0
        for k, (panel, parameter) in enumerate(zip(axes, PARAMETERS, strict=True)):
            factor, zero = QUANTITIES[parameter].factor, 1.0 if parameter.endswith("_scale") else 0.0
            middle, sd = factor * (found.values[k] - zero), factor * found.stderr[k]
            panel.fill_between(span, middle - 2 * sd, middle + 2 * sd, color=colour, alpha=0.25, lw=0)
            panel.plot(span, [middle, middle], color=colour, lw=1.5, label=name)
            panel.errorbar(
                minutes, factor * (values[:, k] - zero), factor * errors[:, k], fmt=".", color=colour, lw=0.8
            )
            stated, label = factor * (found.stated[k] - zero), "" if start else "specified value"
            panel.plot(span, [stated, stated], color=INK, lw=FINE, ls=(0, (5, 3)), label=label)
        ticks.append(start / 60.0)
        start += found.duration_s
    for panel, parameter in zip(axes, PARAMETERS, strict=True):
        title = f"{QUANTITIES[parameter].title} [{QUANTITIES[parameter].unit}]"
        panel.set_title(title, fontsize=SUBTITLE, color=INK, loc="left")
        panel.set_xlabel("driven [min]", fontsize=TEXT, color=INK)
        reduce_frame(panel)
        panel.grid(axis="y", color=SOLID, lw=FINE)
        for begin in ticks[1:]:
            panel.axvline(begin, color=SOFT, lw=FINE, zorder=0)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower left", ncols=3, fontsize=SMALL, frameon=False, labelcolor=INK
    )
    save_figure(figure, path)
