"""Bins that a drive does not visit, and the reasons: left out, or unreachable."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import ndimage

from planners.coverage import Coverage
from planners.reach import Reach
from planners.types import Bools, Ints

PROPOSE_ABOVE = 1.2
"""Minimum ratio of another part's area to the part of the start, above which the other part is proposed."""

REASON_TEXTS: Mapping[str, str] = {
    "no_way_found": "no path found",
    "not_driven": "not driven to",
    "no_forward_drive_there_and_back": "no forward drive there and back",
    "behind_narrow_gaps": "behind gaps that are too narrow",
}
"""Legend texts of the reasons in plan.json and holes.csv."""


def unmet(grid: Coverage, free: Reach, lost: Bools) -> dict[str, Bools]:
    """Return the bins (nx, ny, n_phi) that are not visited, by reason.

    The first two reasons count against the plan. Bins that a car cannot reach and return from were not part
    of its task.

    Parameters
    ----------
    lost : (nx, ny, n_phi) Bins to which no path was found.
    """
    missing = grid.reachable & ~grid.covered
    return {
        "no_way_found": np.asarray(missing & lost),
        "not_driven": np.asarray(missing & ~lost),
        "no_forward_drive_there_and_back": np.asarray(free.cells()[:, :, None] & ~grid.reachable),
    }


def cut_off(free: Reach) -> Bools:
    """Return the nodes (mx, my) where the robot fits but which it cannot reach, because every gap is too narrow."""
    return np.asarray((free.distance >= free.clearance) & ~free.mask)


def small_reach_warning(free: Reach) -> str:
    """Return a warning with the reachable share of the floor, the reason, and a better start."""
    parts, _ = ndimage.label(cut_off(free))
    sizes: Ints = np.bincount(parts.ravel())[1:]
    text = (
        f"only {100 * free.share:.1f} % of where the robot fits is reachable; the rest lies behind walls, no-go zones or gaps "
        f"narrower than {2 * free.clearance:.2f} m"
    )
    if sizes.max(initial=0) <= PROPOSE_ABOVE * free.mask.sum():
        return text
    largest = np.where(parts == sizes.argmax() + 1, free.distance, 0.0)
    x, y = free.nodes(np.nonzero(largest == largest.max()))[0]
    return f"{text}; from {x:.2f},{y:.2f} it would be {100 * sizes.max() / free.fits:.1f} %: start there"


def count_unmet(grid: Coverage, free: Reach, lost: Bools) -> dict[str, Any]:
    """Return the number of bins that are not visited, by reason, and the area [m²] behind narrow gaps."""
    bins = {why: int(where.sum()) for why, where in unmet(grid, free, lost).items()}
    return bins | {"behind_narrow_gaps_m2": round(int(cut_off(free).sum()) * free.step**2, 3)}


def holes_csv(grid: Coverage, free: Reach, lost: Bools) -> str:
    """Return one CSV line for the centre of each bin that is not visited: x, y [m], phi [rad], reason."""
    lines = ["x,y,phi,reason"]
    for why, where in unmet(grid, free, lost).items():
        lines += [f"{x:.6f},{y:.6f},{phi:.6f},{why}" for x, y, phi in grid.centres(where).tolist()]
    return "\n".join(lines) + "\n"
