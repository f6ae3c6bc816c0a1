"""Draw residuals of the bare simulator over bearing, range, incidence, time, turn rate and speed.

An error of the laser over bearing or range has a figure of its own, and so have the gap before and after the amendment, with the
noise floor, and wheel and mount parameters over time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import Enum
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.motion.calibration.comparison import QUANTITIES
from sensorgraph.diagnosis.motion.calibration.estimate import PARAMETERS, DrivingCalibration
from sensorgraph.diagnosis.motion.calibration.laser_motion import BLOCKS
from sensorgraph.diagnosis.report.comparison import ComparedScans, SimulatedScans
from sensorgraph.diagnosis.result import ChannelResult, Gap, Profile
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
from sensorgraph.types import Floats

BAND_STDERRS = 2.0
"""Half-width of the bands in standard errors."""
PALE = "#eceef2"
MIN_NATS_SCALE = 0.02
"""[nats] per reading, minimum span of the axis."""


class Measure(Enum):
    """Quantity that is averaged in each bin; the value is the label of the axis."""

    MEAN = "mean residual [cm]"
    SCATTER = "scatter over noise"
    UNEXPECTED = "not as expected [%]"


def residuals_picture(finding: Finding, compared: ComparedScans, path: Path) -> None:
    """Draw the mean residual and, below it, the scatter or the share of unexpected rays, over each covariate."""
    covariates = compared.covariates
    measures = (Measure.MEAN, _second_measure(finding.channels.get("scan")))
    figure = new_figure(11.0, 3.9, layout=None)
    grid = figure.subplots(2, len(covariates), sharey="row")
    figure.subplots_adjust(left=0.06, right=0.985, top=0.90, bottom=0.115, wspace=0.10, hspace=0.18)
    for charts, measure in zip(grid, measures, strict=True):
        ranges = [
            _draw_profiles(axes, compared, measure, values, edges)
            for axes, (values, edges) in zip(charts, covariates.values(), strict=True)
        ]
        for axes in charts[1:]:
            axes.tick_params(left=False)
        low, high = min(r[0] for r in ranges), max(r[1] for r in ranges)
        if high >= low:
            charts[0].set_ylim(_axis_limits(low, high, measure, compared.sigma))
        charts[0].set_ylabel(measure.value, fontsize=8.5, color=INK)
    for axes in grid[0]:
        axes.tick_params(labelbottom=False)
    for axes, name in zip(grid[1], covariates, strict=True):
        axes.set_xlabel(name, fontsize=8.5, color=INK)
    if compared.is_amended:
        grid[0][0].legend(
            loc="lower left", bbox_to_anchor=(0, 1.0), ncols=2, frameon=False, fontsize=8.5, labelcolor=INK,
            borderaxespad=0.2,
        )  # fmt: skip
    save_figure(figure, path)


def _draw_profiles(
    axes: Any, compared: ComparedScans, measure: Measure, covariate: Floats, edges: Floats
) -> tuple[float, float]:
    """Draw one panel: the profile of each model with its error band; return the range of the profiles."""
    models = [("before", compared.before, ALARM)]
    if compared.is_amended:
        models.append(("after", compared.after, TEAL))
    low, high = np.inf, -np.inf
    centres = (edges[1:] + edges[:-1]) / 2
    index = np.searchsorted(edges, covariate, side="right") - 1
    index = np.where((index >= 0) & (index < len(centres)) & np.isfinite(covariate), index, -1)
    for label, model, colour in models:
        width = 2.4 if label == "before" and compared.is_amended else 1.2
        mean, stderr = compared.profile(_values(model, measure, compared.sigma), index, len(centres))
        known = np.isfinite(mean)
        if not known.any():
            continue
        x, y, band = centres[known], mean[known], BAND_STDERRS * stderr[known]
        axes.fill_between(x, y - band, y + band, color=colour, alpha=0.18, lw=0)
        axes.plot(x, y, color=colour, lw=width, marker="o", ms=1.5 * width, label=label)
        low, high = min(low, float(y.min())), max(high, float(y.max()))
    axes.axhline(1.0 if measure is Measure.SCATTER else 0.0, color=SOFT, lw=0.7, zorder=0)
    axes.grid(color=PALE, lw=0.6)
    reduce_frame(axes)
    axes.tick_params(labelsize=7)
    axes.set_xlim(edges[0], edges[-1])
    return low, high


def _axis_limits(low: float, high: float, measure: Measure, sigma: float) -> tuple[float, float]:
    """Return axis limits for profiles between `low` and `high`, at least half the noise apart."""
    least = 100 * sigma * 0.5 if measure is Measure.MEAN else 0.5
    middle, half = (low + high) / 2, max(0.62 * (high - low), least)
    bottom = -0.06 * half if measure is Measure.UNEXPECTED else middle - half
    return bottom, middle + half


def _second_measure(result: ChannelResult | None) -> Measure:
    """Return the measure of the lower row: scatter if it is the strongest deviation except a bias."""
    families = [] if result is None else [d.family for d in result.deviations if d.family != "bias"]
    return Measure.SCATTER if families and families[0] == "spread" else Measure.UNEXPECTED


def _values(model: SimulatedScans, measure: Measure, sigma: float) -> Floats:
    """Return the averaged quantity (n_scans, n_rays); nan for rays that do not count."""
    if measure is Measure.MEAN:
        return 100 * model.clipped(sigma)
    if measure is Measure.SCATTER:
        return np.asarray(np.abs(model.clipped(sigma)) / model.sigma / np.sqrt(2 / np.pi))
    return np.where(model.clear, 100.0 * model.unexpected, np.nan)


def profile_picture(profile: Profile, path: Path) -> None:
    """Draw the error with its band of two standard errors."""
    is_bearing = profile.over == "bearing"
    at = np.degrees(profile.at) if is_bearing else np.array(profile.at)
    scale, label = (
        (180 / np.pi, "bearing error [°]") if profile.of == "bearing" else (100.0, "error of readings [cm]")
    )
    error, band = scale * np.array(profile.error), scale * BAND_STDERRS * np.array(profile.stderr)
    figure = new_figure(7.0, 2.6)
    axes = figure.add_subplot()
    axes.axhline(0.0, color=SOFT, lw=0.7, zorder=0)
    axes.fill_between(at, error - band, error + band, color=ALARM, alpha=0.18, lw=0)
    axes.plot(at, error, color=ALARM, lw=1.4, marker="o", ms=3)
    axes.set_xlabel("bearing [°]" if is_bearing else "range [m]", fontsize=8.5, color=INK)
    axes.set_ylabel(label, fontsize=8.5, color=INK)
    axes.tick_params(labelsize=7)
    reduce_frame(axes)
    save_figure(figure, path)


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
            ("negative log-likelihood per reading [nats]", [f.nats_per_ray - least for f in fits]),
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


def calibration_picture(runs: Mapping[str, DrivingCalibration], path: Path) -> None:
    """Draw each parameter of each run: estimate with two standard errors, parts of the run, and specified value."""
    figure = new_figure(9.0, 6.2)
    axes = figure.subplots(2, 3).ravel()
    start, ticks = 0.0, list[float]()
    for (name, found), colour in zip(runs.items(), (TEAL, ALARM), strict=False):
        ends = np.linspace(0, found.rows.n, min(BLOCKS, found.rows.n) + 1).astype(np.intp)
        parts = [found.part(slice(*some)) for some in pairwise(ends)]
        middles = [
            np.mean(np.append(found.rows.from_s, found.duration_s)[list(some)]) for some in pairwise(ends)
        ]
        minutes = (start + np.array(middles)) / 60.0
        span = np.array([start, start + found.duration_s]) / 60.0
        for k, (panel, parameter) in enumerate(zip(axes, PARAMETERS, strict=True)):
            factor, zero = QUANTITIES[parameter].factor, 1.0 if parameter.endswith("_scale") else 0.0
            middle, sd = factor * (found.values[k] - zero), factor * found.stderr[k]
            panel.fill_between(span, middle - 2 * sd, middle + 2 * sd, color=colour, alpha=0.25, lw=0)
            panel.plot(span, [middle, middle], color=colour, lw=1.5, label=name)
            panel.errorbar(
                minutes,
                [factor * (part.values[k] - zero) for part in parts],
                [factor * part.stderr[k] for part in parts],
                fmt=".",
                color=colour,
                lw=0.8,
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
