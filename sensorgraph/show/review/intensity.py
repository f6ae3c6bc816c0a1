"""The map of intensities of a review: returns in the map, coloured by how strongly the surface reflects."""

from __future__ import annotations

import numpy as np
import rerun as rr

from sensorgraph.show.figures.style import MAX_POINTS
from sensorgraph.show.review.contents import Review
from sensorgraph.show.review.maps import colours
from sensorgraph.types import Floats

SCALE = (0.01, 0.99)
"""Quantiles of the intensities at the ends of the colour scale, so that a few reflectors do not darken the rest."""
LABEL = "intensity: violet weak, yellow strong"


def log_intensities(recording: rr.RecordingStream, review: Review) -> None:
    """Log the returns of evenly spaced scans as points, coloured by intensity."""
    points, values = intensity_points(review)
    if not len(points):
        return
    low, high = np.quantile(values, SCALE)
    colour = colours((values - low) / max(high - low, 1e-12))
    recording.log("plan/intensity", rr.Points2D(points, colors=colour, radii=-1.2), static=True)


def intensity_points(review: Review) -> tuple[Floats, Floats]:
    """Return end points (n, 2) [m, map] of returns with an intensity, and these intensities (n,)."""
    if review.intensities is None:
        return np.zeros((0, 2)), np.zeros(0)
    known = np.isfinite(review.measured) & np.isfinite(review.intensities)
    every = slice(None, None, max(1, -(-int(known.sum()) // MAX_POINTS)))
    points = review.points(np.where(known, review.measured, np.nan), every)
    return np.concatenate(points), review.intensities[every][known[every]]
