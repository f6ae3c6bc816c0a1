"""The hidden gauge: all walls a little nearer against a bias of all ranges that depends on the incidence.

Moving every face by delta along its normal changes ranges by delta / (n·u), which constants and incidence terms
absorb: returns cannot tell. Occlusion edges can: with a wrong delta an edge's abscissa wanders with the viewing
direction and smears. Where there are no edges (an empty square) nothing can, and that is what is said.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sensorgraph.models.calibration.normal_equations import Matches, range_change
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.visibility import Noise, Rays, expect, faces_of, improve, lines_of

PASSES = 3  # of EM on visibility alone
REST = 0.0008  # [m] step at which the search ends
FARTHEST = 0.03  # [m] that it may go
CLEAR = 30.0  # [nats] that the best must stand above both sides; bins alone make a few


@dataclass(frozen=True, kw_only=True)
class Gauge:
    """Where the occlusion edges put the walls."""

    shift: float
    """[m] of all faces along their normals."""
    width: float
    """[m] standard error of that, by the curvature of the likelihood and the step of the search; inf: no edge tells."""

    @property
    def is_observed(self) -> bool:
        """Tell whether the edges of this room settle it."""
        return bool(np.isfinite(self.width))


def settle(rays: Rays, matches: Matches, faces: FaceSet, noise: Noise, *, reach: float) -> Gauge:
    """Search the common shift that makes the edges sharpest, first within ± `reach` [m].

    Parameters
    ----------
    rays : with corrected ranges, those of `matches`
    """
    return search(lambda shift: _nats(rays, matches, faces, noise, shift), reach=reach)


def search(nats: Callable[[float], float], *, reach: float) -> Gauge:
    """Find the peak of a log likelihood [nats] of a shift [m]: five places, then about the best, ever closer.

    Sharp edges make the peak a cusp and one of its sides steeper, so a parabola is true only near the top.
    """
    step = reach / 2
    seen = {i * step: nats(i * step) for i in range(-2, 3)}
    best = max(seen, key=lambda shift: seen[shift])
    while abs(best) < FARTHEST:
        for beside in (best - step, best + step):
            if not any(abs(beside - shift) < step / 4 for shift in seen):
                seen[beside] = nats(beside)
        top = max(seen, key=lambda shift: seen[shift])
        if top == best:
            if step <= REST:
                break
            step /= 2
        best = top
    clear = min(seen[best] - nats_at for nats_at in (seen[min(seen)], seen[max(seen)]))
    if abs(best) >= FARTHEST or clear < CLEAR:
        return Gauge(shift=0.0, width=np.inf)
    near = sorted(seen, key=lambda shift: abs(shift - best))[:3]
    curve, slope, _ = np.polyfit(np.array(near) - best, [seen[shift] for shift in near], 2)
    top = best - slope / (2 * curve)
    return Gauge(shift=float(top), width=float(np.hypot(1 / np.sqrt(-2 * curve), step / np.sqrt(12))))


def _nats(rays: Rays, matches: Matches, faces: FaceSet, noise: Noise, shift: float) -> float:
    """Return the log likelihood with all faces shifted, and the returns with them."""
    moved = replace(rays, ranges=np.maximum(rays.ranges + range_change(matches, shift), 1e-3))
    here = faces_of(lines_of(faces))
    here = here._replace(offsets=here.offsets + shift)
    for _ in range(PASSES):
        seen = expect(moved, here, noise)
        here, _ = improve(here, seen, noise, refit=False)
    return expect(moved, here, noise).nats
