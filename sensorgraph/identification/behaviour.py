"""Measure the behaviour of a drive in numbers, so that drives can be compared.

    Lyapunov exponent: d_j(t) ~ C_j exp(lambda t), the slope of the mean log distance of neighbours over t.
    Correlation dimension: C(r) ~ r^D, the slope of the log correlation sum over log r.

Quantities: Nehmzow, Scientific Methods in Mobile Robotics (Springer 2006), chapters 4 to 6. Lyapunov exponent:
Rosenstein, Collins and De Luca, A practical method for calculating largest Lyapunov exponents from small data sets,
Physica D 65 (1993). Correlation dimension: Grassberger and Procaccia, Physica D 9 (1983).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from logs.run import Run, pair
from planners.arena import Arena
from planners.coverage import CELL
from robotmodic_ident.analysis import correlation_dimension, lyapunov_of_series
from robotmodic_ident.errors import IdentError
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import Floats

SAMPLE_STEP = 0.5  # [s] between samples of the embedded track
EMBEDDING: dict[str, Any] = {
    "dimension": 4,
    "lag": round(2.0 / SAMPLE_STEP),
    "theiler": round(20.0 / SAMPLE_STEP),
}
"""Four delays of 2 s; neighbours within 20 s belong to the same visit."""
DIVERGENCE_HORIZON = 8.0  # [s] over which the distance of neighbours is followed
N_REFERENCES = 1000  # points whose neighbours are counted for the dimension
MIN_PAIRS = 100  # of neighbours, for an exponent


@dataclass(frozen=True, kw_only=True)
class Behaviour:
    """Quantities of one drive."""

    duration_s: float
    path_m: float
    """Length of the path of base_link, forward and backward, from means over 0.5 s, which suppress pose noise."""
    speed_m_s: float
    """Mean speed: path over duration."""
    turn_rate_rad_s: float
    """Mean of |heading change| per second, from means over 0.5 s."""
    clearance_mean_m: float
    """Mean over scans of the nearest return."""
    clearance_min_m: float
    """Nearest return of all scans."""
    covered_m2: float
    """Area of the 0.25 m cells that base_link visited."""
    coverage: float | None
    """`covered_m2` over the free area of the arena; None without an arena."""
    lyapunov_1_s: float | None
    """Largest Lyapunov exponent of the track (x, y), the divergence rate of neighbouring tracks; None if too short."""
    dimension: float | None
    """Correlation dimension of the embedded track; None if the track is too short."""
    dimension_low: float | None
    dimension_high: float | None
    """95 % interval of the dimension."""


LABELS: Mapping[str, tuple[str, float, str]] = {
    "duration_s": ("duration", 1, "s"),
    "path_m": ("path", 1, "m"),
    "speed_m_s": ("mean speed", 1, "m/s"),
    "turn_rate_rad_s": ("mean turn rate", 1, "rad/s"),
    "clearance_mean_m": ("nearest return, mean", 1, "m"),
    "clearance_min_m": ("nearest return, minimum", 1, "m"),
    "covered_m2": ("floor visited", 1, "m²"),
    "coverage": ("share of the floor", 100, "%"),
    "lyapunov_1_s": ("Lyapunov exponent", 1, "1/s"),
    "dimension": ("correlation dimension", 1, ""),
    "dimension_low": ("– lower limit (95 %)", 1, ""),
    "dimension_high": ("– upper limit (95 %)", 1, ""),
}


def behaviour(run: Run, arena: Arena | None = None) -> Behaviour:
    """Measure a run from its reference poses and its scans."""
    pairing = pair(run)
    if int(pairing.paired.sum()) < 2:
        raise SensorgraphError(f"{pairing}; expected two or more poses")
    stamps, poses = run.stamps[pairing.paired], pairing.poses[pairing.paired]
    duration = float(stamps[-1] - stamps[0])
    calm = _means(stamps, np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])]))
    path = float(np.hypot(*np.diff(calm[:, :2], axis=0).T).sum())
    turned = float(np.abs(np.diff(calm[:, 2])).sum())
    nearest = np.where(np.isfinite(run.ranges), run.ranges, np.inf).min(axis=1)
    nearest = nearest[np.isfinite(nearest)]
    cells = np.unique(np.floor(poses[:, :2] / CELL).astype(np.int64), axis=0)
    covered = len(cells) * CELL**2
    dimension, low, high = track_dimension(stamps, poses[:, :2])
    return Behaviour(
        duration_s=duration, path_m=path, speed_m_s=path / max(duration, 1e-9),
        turn_rate_rad_s=turned / max(duration, 1e-9),
        clearance_mean_m=float(nearest.mean()) if len(nearest) else np.inf,
        clearance_min_m=float(nearest.min()) if len(nearest) else np.inf, covered_m2=covered,
        coverage=None if arena is None else covered / float(arena.free.area),
        lyapunov_1_s=lyapunov(stamps, poses[:, :2]), dimension=dimension, dimension_low=low,
        dimension_high=high,
    )  # fmt: skip


def _means(stamps: Floats, poses: Floats) -> Floats:
    """Return the mean of poses (n, 3) in each SAMPLE_STEP that has poses."""
    _, place = np.unique(np.floor((stamps - stamps[0]) / SAMPLE_STEP).astype(np.int64), return_inverse=True)
    count = np.bincount(place)
    return np.stack([np.bincount(place, weights=column) / count for column in poses.T], axis=1)


def lyapunov(stamps: Floats, track: Floats) -> float | None:
    """Estimate the largest Lyapunov exponent [1/s] of a track (n, 2) [m] at stamps (n,) [s]; None if it is too short.

    The track is embedded by delays. For each point, the distance to its nearest neighbour of another visit is followed
    over `DIVERGENCE_HORIZON`. The exponent is the slope of the mean log distance over time (Rosenstein 1993).
    """
    try:
        found = lyapunov_of_series(
            _evenly(stamps, track)[1],
            **EMBEDDING,
            fit=(0, round(DIVERGENCE_HORIZON / SAMPLE_STEP)),
            period=SAMPLE_STEP,
        )
    except IdentError:
        return None
    return found.exponent if found.n_pairs >= MIN_PAIRS else None


def track_dimension(stamps: Floats, track: Floats) -> tuple[float | None, float | None, float | None]:
    """Return the correlation dimension of a track (n, 2) [m] at stamps (n,) [s], and its 95 % interval.

    The track is embedded as for the exponent. Pairs of the same visit do not count.
    """
    _, xy = _evenly(stamps, track)
    try:
        found = correlation_dimension(
            xy, **EMBEDDING, n_reference=N_REFERENCES, rng=np.random.default_rng(0)
        )  # fmt: skip
    except IdentError:  # too short, or almost at rest
        return None, None, None
    return found.value, *found.interval


def _evenly(stamps: Floats, track: Floats) -> tuple[Floats, Floats]:
    """Return evenly spaced stamps (m,) and the track (m, 2) interpolated at them."""
    t = np.arange(stamps[0], stamps[-1], SAMPLE_STEP)
    return t, np.stack([np.interp(t, stamps, column) for column in track.T], axis=1)


def table(drives: Mapping[str, Behaviour]) -> list[str]:
    """Return a Markdown table with one column per drive."""
    lines = ["| | " + " | ".join(drives) + " |", "|---|" + "---:|" * len(drives)]
    for field in fields(Behaviour):
        label, scale, unit = LABELS[field.name]
        values = [getattr(drive, field.name) for drive in drives.values()]
        cells = [
            "–"
            if v is None
            else f"{scale * v:,.3g} {unit}".rstrip()
            if abs(scale * v) < 1000
            else f"{scale * v:,.0f} {unit}"
            for v in values
        ]
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    return lines
