"""Wheels and mount of one or two runs along their time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sensorgraph.diagnosis.motion.calibration.comparison import block_estimates
from sensorgraph.diagnosis.motion.calibration.estimate import PARAMETERS, DrivingCalibration
from sensorgraph.diagnosis.motion.calibration.settings import CALIBRATION
from sensorgraph.diagnosis.motion.calibration.words import QUANTITIES
from sensorgraph.show.figures.style import ALARM, TEAL, new_figure, save_figure


def calibration_picture(runs: Mapping[str, DrivingCalibration], path: Path) -> None:
    """Draw each parameter of each run: the whole run's with two standard errors, and those of its parts."""
    figure = new_figure(9.0, 6.2)
    axes = figure.subplots(2, 3).ravel()
    start, ticks, labels = 0.0, [], []
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
        ticks.append(start / 60.0)
        labels.append(name)
        start += found.duration_s
    for panel, parameter in zip(axes, PARAMETERS, strict=True):
        panel.set_title(f"{QUANTITIES[parameter].title} [{QUANTITIES[parameter].unit}]", fontsize=10)
        panel.set_xlabel("driven [min]")
        for begin in ticks[1:]:
            panel.axvline(begin, color="0.8", lw=0.8, zorder=0)
    if len(runs) > 1:
        axes[0].legend(fontsize=8, frameon=False)
    save_figure(figure, path)
