"""Earlier runs and sensorgraphs for a new plan; they are rejected, or a warning is given, if they are of another place."""

from __future__ import annotations

import numpy as np

from logs.run import Run, pair
from planners.arena import Arena
from planners.clearance import Barriers
from planners.errors import PlanError
from planners.groups import members
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.loading import arena_in
from sensorgraph.robust import MAJORITY
from sensorgraph.types import Floats
from sensorgraph.world.identified_arena import walls_of

WALL_STEP, SAME_WALL_DISTANCE = 0.05, 0.10
"""[m] Spacing of points on a wall, and maximum distance to a wall of the other arena that counts as the same."""


def driven_poses(run: Run, arena: Arena, *, name: str = "the run") -> Floats:
    """Return the poses (n, 3) [m, m, rad] of a run's scans.

    Raises
    ------
    PlanError : The run has no poses of base_link, or was driven in another arena.
    """
    if run.pose_frame != "base_link":
        raise PlanError(
            f"{name}: its poses are those of {run.pose_frame}, expected base_link; resume from another run"
        )
    pairing = pair(run)
    if not pairing.paired.any():
        raise PlanError(f"{name}: {pairing}; nothing to resume from")
    own = _own_arena(run)
    if own is not None and (share := shared_walls(own.walls, arena)) < MAJORITY:
        raise PlanError(
            f"{name} was driven in another arena, of {_extent(own)}: {100 * share:.0f} % of its walls are in this arena, "
            f"of {_extent(arena)}; give the arena of that run, or a run in this arena"
        )
    poses = pairing.poses[pairing.paired]
    share = float(arena.contains(poses[:, :2]).mean())
    if share < MAJORITY:
        raise PlanError(
            f"{name}: {100 * share:.0f} % of its poses lie in the free space of this arena, of {_extent(arena)}; "
            "give the arena of that run, in the frame of its poses"
        )
    return poses


def other_place_warnings(graph: Sensorgraph, arena: Arena) -> list[str]:
    """Return a warning if the walls identified by a sensorgraph are not in an arena; otherwise nothing."""
    try:
        own = walls_of(graph)
    except SensorgraphError:
        return []
    if (share := shared_walls(own, arena)) >= MAJORITY:
        return []
    return [
        f"{100 * share:.0f} % of the sensorgraph's walls are in this arena; check that it is of the same place"
    ]


def _own_arena(run: Run) -> Arena | None:
    try:
        return arena_in(run)
    except SensorgraphError:  # an unreadable arena is no evidence for another place
        return None


def shared_walls(walls: Floats, other: Arena) -> float:
    """Return the share of the length of walls (n, 2, 2) [m] that is also in another arena."""
    if not len(walls):
        return 1.0
    starts, ends = walls[:, 0], walls[:, 1]
    counts = np.maximum(np.hypot(*(ends - starts).T) / WALL_STEP, 1).astype(np.int64)
    owner, number = members(counts)
    share = ((number + 0.5) / counts[owner])[:, None]
    points = starts[owner] + share * (ends - starts)[owner]  # (n, 2) points at even steps along the walls
    return float((Barriers(other).distances(points) < SAME_WALL_DISTANCE).mean())


def _extent(arena: Arena) -> str:
    x0, y0, x1, y1 = arena.bounds
    return f"x {x0:g} to {x1:g}, y {y0:g} to {y1:g} m"
