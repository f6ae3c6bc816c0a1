"""The hidden gauge: all walls a little nearer against a bias of all ranges that depends on the incidence.

Moving every face by delta along its normal changes ranges by delta / (n·u), which constants and incidence terms
absorb: returns cannot tell. Occlusion edges can: with a wrong delta an edge's abscissa wanders with the viewing
direction and smears. Where there are no edges (an empty square) nothing can, and that is what is said.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sensorgraph.models.calibration.matching import Matches, range_change
from sensorgraph.models.calibration.settings import CALIBRATION
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.visibility import Rays, ReturnNoise, binned_faces, e_step, m_step, visible_lines

GAUGE = CALIBRATION.gauge


@dataclass(frozen=True, kw_only=True)
class Gauge:
    """Where the occlusion edges put the walls."""

    shift: float
    """[m] of all faces along their normals."""
    stderr: float
    """[m] standard error of that, by the curvature of the likelihood and the step of the search; inf: no edge tells."""

    @property
    def is_observed(self) -> bool:
        """Tell whether the edges of this room settle it."""
        return bool(np.isfinite(self.stderr))


def estimate_gauge(
    rays: Rays, matches: Matches, faces: FaceSet, noise: ReturnNoise, *, reach: float
) -> Gauge:
    """Find the common shift of all faces that makes occlusion edges sharpest; search first within ± `reach` [m].

    Parameters
    ----------
    rays : with corrected ranges, those of `matches`
    """
    return find_peak(lambda shift: _log_likelihood(rays, matches, faces, noise, shift), reach=reach)


def find_peak(log_likelihood: Callable[[float], float], *, reach: float) -> Gauge:
    """Find the peak of a log likelihood [nats] of a shift [m]: five places, then about the best, ever closer.

    Sharp edges make the peak a cusp and one of its sides steeper, so a parabola is true only near the top.
    """
    step = reach / 2
    values = {i * step: log_likelihood(i * step) for i in range(-2, 3)}
    best = max(values, key=lambda shift: values[shift])
    while abs(best) < GAUGE.max_shift:
        for beside in (best - step, best + step):
            if not any(abs(beside - shift) < step / 4 for shift in values):
                values[beside] = log_likelihood(beside)
        top = max(values, key=lambda shift: values[shift])
        if top == best:
            if step <= GAUGE.min_step:
                break
            step /= 2
        best = top
    clear = min(values[best] - value for value in (values[min(values)], values[max(values)]))
    if abs(best) >= GAUGE.max_shift or clear < GAUGE.min_contrast:
        return Gauge(shift=0.0, stderr=np.inf)
    near = sorted(values, key=lambda shift: abs(shift - best))[:3]
    curve, slope, _ = np.polyfit(np.array(near) - best, [values[shift] for shift in near], 2)
    top = best - slope / (2 * curve)
    return Gauge(shift=float(top), stderr=float(np.hypot(1 / np.sqrt(-2 * curve), step / np.sqrt(12))))


def _log_likelihood(rays: Rays, matches: Matches, faces: FaceSet, noise: ReturnNoise, shift: float) -> float:
    """Return the log likelihood with all faces shifted, and the returns with them."""
    moved = replace(
        rays, ranges=np.maximum(rays.ranges + range_change(matches, shift), CALIBRATION.matches.min_range)
    )
    here = binned_faces(visible_lines(faces))
    here = here._replace(offsets=here.offsets + shift)
    for _ in range(GAUGE.passes):
        expectation = e_step(moved, here, noise)
        here, _ = m_step(here, expectation, noise, refit=False)
    return e_step(moved, here, noise).log_likelihood
