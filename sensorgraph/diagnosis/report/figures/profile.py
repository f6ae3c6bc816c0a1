"""Draw an error of the laser over bearing or range."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sensorgraph.diagnosis.report.figures.residuals import BAND_STDERRS
from sensorgraph.diagnosis.result import Profile
from sensorgraph.show.figures.style import ALARM, INK, SOFT, new_figure, reduce_frame, save_figure


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
