"""Gauge of the walls: a common shift of all faces, which incidence-dependent biases of the ranges can compensate.

A shift delta of every face along its normal changes ranges by delta / (n·u). Constants and incidence terms absorb
that, so ranges cannot determine delta. Occlusion edges can: with a wrong delta, the abscissa of an edge varies with
the viewing direction and the edge blurs. Without edges (an empty square) delta is reported as not observable.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sensorgraph.models.calibration.matching import MIN_RANGE, Matches, range_change
from sensorgraph.models.faces.fit import PASSES
from sensorgraph.models.faces.maximisation import m_step
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.visibility import Rays, ReturnNoise, binned_faces, e_step, visible_lines

MIN_STEP, MAX_SHIFT = 0.0008, 0.03
"""[m] Step at which the search ends, and largest shift; a maximum there counts as not observable."""
MIN_CONTRAST = 30.0
"""[nats] Minimum drop of the log likelihood towards both ends of the search; binning alone causes a few."""


@dataclass(frozen=True, kw_only=True)
class Gauge:
    """Common shift of the faces, as determined by occlusion edges."""

    shift: float
    """[m] shift of all faces along their normals."""
    stderr: float
    """[m] standard error, from the curvature of the likelihood and the search step; inf: not observable."""

    @property
    def is_observed(self) -> bool:
        """Return whether occlusion edges determine the shift."""
        return bool(np.isfinite(self.stderr))


def estimate_gauge(
    rays: Rays, matches: Matches, faces: FaceSet, noise: ReturnNoise, *, reach: float
) -> Gauge:
    """Find the common shift of all faces that maximises the likelihood of the occlusion edges.

    Parameters
    ----------
    rays : Rays with the corrected ranges of `matches`.
    reach : [m] Half width of the first search interval.
    """
    return find_peak(lambda shift: _log_likelihood(rays, matches, faces, noise, shift), reach=reach)


def find_peak(log_likelihood: Callable[[float], float], *, reach: float) -> Gauge:
    """Find the maximum of a log likelihood [nats] of a shift [m] by search with a decreasing step.

    Sharp edges make the maximum a cusp with unequal sides, so a parabola is fitted to the three best values only.
    """
    step = reach / 2
    values = {i * step: log_likelihood(i * step) for i in range(-2, 3)}
    best = max(values, key=lambda shift: values[shift])
    while abs(best) < MAX_SHIFT:
        for neighbour in (best - step, best + step):
            if not any(abs(neighbour - shift) < step / 4 for shift in values):
                values[neighbour] = log_likelihood(neighbour)
        top = max(values, key=lambda shift: values[shift])
        if top == best:
            if step <= MIN_STEP:
                break
            step /= 2
        best = top
    clear = min(values[best] - value for value in (values[min(values)], values[max(values)]))
    if abs(best) >= MAX_SHIFT or clear < MIN_CONTRAST:
        return Gauge(shift=0.0, stderr=np.inf)
    near = sorted(values, key=lambda shift: abs(shift - best))[:3]
    curve, slope, _ = np.polyfit(np.array(near) - best, [values[shift] for shift in near], 2)
    top = best - slope / (2 * curve)
    return Gauge(shift=float(top), stderr=float(np.hypot(1 / np.sqrt(-2 * curve), step / np.sqrt(12))))


def _log_likelihood(rays: Rays, matches: Matches, faces: FaceSet, noise: ReturnNoise, shift: float) -> float:
    """Return the log likelihood of the rays with faces and returns shifted along the normals."""
    moved = replace(rays, ranges=np.maximum(rays.ranges + range_change(matches, shift), MIN_RANGE))
    here = binned_faces(visible_lines(faces))
    here = here._replace(offsets=here.offsets + shift)
    for _ in range(PASSES):
        expectation = e_step(moved, here, noise)
        here, _ = m_step(here, expectation, noise, refit=False)
    return e_step(moved, here, noise).log_likelihood
