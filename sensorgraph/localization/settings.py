"""Every tuned number of the localisation, with unit and meaning; the defaults are those of `benchmarks/locate.py`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class PointSettings:
    """Which returns become points."""

    max_range: float = 30.0
    """[m] farther returns are left out: a wrong heading moves them too far, and they are sparse."""
    spacing: float = 0.015
    """[m] from a point to the next of its scan, below which the latter is left out."""
    reach: float = 0.12
    """[m] along the scan from a point to the neighbours that give its normal."""
    gap: float = 0.25
    """[m] between neighbouring returns that lie on two surfaces."""


SCANS = PointSettings()


@dataclass(frozen=True, kw_only=True)
class LineMatchSettings:
    """Robust match of points against lines."""

    first_radius: float = 0.35
    """[m] around a point within which the line is fitted, at first; also the side of a bucket of the map."""
    last_radius: float = 0.20
    """[m] the same in the last iterations."""
    sigma: float = 0.03
    """[m] standard deviation of a return around a perfect line: noise, and that surfaces are no lines."""
    iterations: int = 12
    """Gauss-Newton steps at most."""
    tolerance: float = 1e-4
    """[m, rad] a smaller step is the last one."""
    roundness: float = 0.15
    """Ratio of the variances across and along a line, above which it is a spot, which also holds along."""
    min_points: float = 2.5
    """Weight of neighbours below which there is no line."""
    same_side: float = 0.3
    """Cosine between the normals of two points below which these lie on different surfaces."""
    min_noise: float = 0.003
    """[m] the residuals are never believed to be smaller: the information of a match stays finite."""
    inlier: float = 2.0
    """Standard deviations within which a point is an inlier."""


MATCH = LineMatchSettings()
