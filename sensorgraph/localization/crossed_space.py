"""Which points are in space that the rays of a scan crossed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from logs.transforms import invert
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.localization.settings import CLOSURES
from sensorgraph.types import Bools, Floats

MAX_GAP = float(np.radians(3.0))
"""[rad] Maximum bearing difference between neighbouring returns of a dense laser; in wider gaps the space is unobserved."""
NOISE_MARGIN = 0.1
"""[m] Distance from the end of a ray within which a point fits it: noise, and errors of a motion within a second."""
MIN_VISIBLE = 8
"""Number of visible points from which two views can contradict each other."""


def crossed(
    points: Floats, pose: Floats, scans: ScanPoints, own: slice, margin: float
) -> tuple[Bools, Bools]:
    """Return which points (n, 2) are visible from a scan, and which of these its rays crossed."""
    if own.start == own.stop:
        none = np.zeros(len(points), dtype=np.bool_)
        return none, none
    start = scans.starts[own].mean(axis=0)
    rays = scans.points[own] - start
    bearing, length = np.arctan2(rays[:, 1], rays[:, 0]), np.hypot(*rays.T)
    order = np.argsort(bearing)
    bearing, length = bearing[order], length[order]
    local = moved_points(points, invert(pose)) - start
    at, far = np.arctan2(local[:, 1], local[:, 0]), np.hypot(*local.T)
    right = np.searchsorted(bearing, at)
    inside = (right > 0) & (right < len(bearing))
    right = np.clip(right, 1, len(bearing) - 1)
    gaps = np.diff(bearing)
    widest = max(MAX_GAP, 2.0 * float(np.median(gaps))) if len(gaps) else MAX_GAP
    is_near = bearing[right] - bearing[right - 1] < widest
    in_view = inside & is_near & (far < np.maximum(length[right], length[right - 1]) + margin)
    through = in_view & (far < np.minimum(length[right], length[right - 1]) - margin)
    return in_view, through


def moved_points(points: Floats, pose: Floats) -> Floats:
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    moved: Floats = points @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]
    return moved


def contradicts(
    scans: ScanPoints, k: int, pose: Floats, points: Floats, frames: Sequence[int], poses: Floats
) -> bool:
    """Tell whether scan k, taken at `pose`, contradicts what was seen before.

    It does if its rays cross known surfaces, or if its returns lie in space that earlier rays crossed. A view of unknown
    space contradicts nothing.

    Parameters
    ----------
    points : (n, 2) [m] Points of the known surfaces.
    frames, poses : Earlier scans, and their poses (n_frames, 3).
    """
    own = moved_points(scans.points[scans.of(k)], pose)
    views = [crossed(points, pose, scans, scans.of(k), CLOSURES.margin)]
    views += [
        crossed(own, there, scans, scans.of(frame), CLOSURES.margin)
        for frame, there in zip(frames, poses, strict=True)
    ]
    visible = sum(int(seen.sum()) for seen, _ in views)
    gone = sum(int(through.sum()) for _, through in views)
    return visible >= MIN_VISIBLE and gone > CLOSURES.see_through * visible
