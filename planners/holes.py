"""What a drive does not meet, and why: bins that were left out, and places that no drive leads to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import ndimage

from planners.coverage import Coverage
from planners.reach import Reach
from planners.settings import STARTS
from planners.types import Bools, Ints

REASON_TEXTS: Mapping[str, str] = {
    "no_way_found": "no way found there",
    "not_driven": "not driven to",
    "no_forward_drive_there_and_back": "no forward drive there and back",
    "behind_narrow_gaps": "behind gaps too narrow",
}
"""The reasons that plan.json and holes.csv give, in words."""


def unmet(grid: Coverage, free: Reach, lost: Bools) -> dict[str, Bools]:
    """Return the bins (nx, ny, n_phi) that are not met, by reason.

    The first two count against the plan; what a car cannot drive to and come back from was never asked of it.

    Parameters
    ----------
    lost : (nx, ny, n_phi) bins to which no path was found
    """
    missing = grid.reachable & ~grid.covered
    return {
        "no_way_found": np.asarray(missing & lost),
        "not_driven": np.asarray(missing & ~lost),
        "no_forward_drive_there_and_back": np.asarray(free.cells()[:, :, None] & ~grid.reachable),
    }


def cut_off(free: Reach) -> Bools:
    """Return the nodes (mx, my) where the robot fits, and to which no gap is wide enough."""
    return np.asarray((free.distance >= free.clearance) & ~free.mask)


def small_reach_warning(free: Reach) -> str:
    """Return a warning: the share of where the robot fits that it can reach, why no more, and where to start for more."""
    parts, _ = ndimage.label(cut_off(free))
    sizes: Ints = np.bincount(parts.ravel())[1:]
    said = (
        f"only {100 * free.share:.1f} % of where the robot fits is reachable; the rest lies behind gaps narrower "
        f"than {2 * free.clearance:.2f} m"
    )
    if sizes.max(initial=0) <= STARTS.propose_above * free.mask.sum():
        return said
    largest = np.where(parts == sizes.argmax() + 1, free.distance, 0.0)
    x, y = free.nodes(np.nonzero(largest == largest.max()))[0]
    return f"{said}; from {x:.2f},{y:.2f} it would be {100 * sizes.max() / free.fits:.1f} %: start there"


def count_unmet(grid: Coverage, free: Reach, lost: Bools) -> dict[str, Any]:
    """Return how much is not met, by reason: bins, and for places behind gaps square metres."""
    bins = {why: int(where.sum()) for why, where in unmet(grid, free, lost).items()}
    return bins | {"behind_narrow_gaps_m2": round(int(cut_off(free).sum()) * free.step**2, 3)}


def holes_csv(grid: Coverage, free: Reach, lost: Bools) -> str:
    """Return a line for the centre of each bin that is not met: x, y [m], phi [rad], reason."""
    lines = ["x,y,phi,reason"]
    for why, where in unmet(grid, free, lost).items():
        lines += [f"{x:.6f},{y:.6f},{phi:.6f},{why}" for x, y, phi in grid.centres(where).tolist()]
    return "\n".join(lines) + "\n"
