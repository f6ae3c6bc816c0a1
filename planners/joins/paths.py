"""Joins of robots that turn in place: straight where that is clear, else by OMPL (`ompl_paths`).

If OMPL finds no path, `raster_path` is the shortest one over the nodes of the distance raster (Dijkstra's
algorithm). With the distance d of a node to the nearest wall, a step from node a to a neighbouring node b costs

    |a - b| (c(a) + c(b)) / 2.

    Cost per metre: c = 1 + 1 / (1 + max(d - clearance, 0) / step).

Nodes next to walls cost twice their length. The path leads through doors that OMPL's samples miss.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from planners.clearance import Barriers
from planners.joins.ompl_process import CLEARANCE_SLACK, call_ompl
from planners.order import neighbours
from planners.reach import Reach
from planners.task import JoinCounts, Task
from planners.types import ROUND_OFF, Floats


def join(task: Task, starts: Floats, ends: Floats) -> tuple[list[Floats | None], JoinCounts]:
    """Find a path for each move (n, 2) -> (n, 2) [m] of a task, as `connect`."""
    return connect(starts, ends, reach=task.reach, barriers=task.barriers, seed=task.seed)


def continued(
    path: Floats | None, begin: Floats, here: Floats, end: Floats, task: Task
) -> tuple[Floats | None, JoinCounts]:
    """Return the path (k, 2) [m] that was planned from `begin` (2,), or another one to `end` (2,) from `here` (2,).

    The robot is elsewhere if the place before was not reached.
    """
    if np.allclose(begin, here, atol=ROUND_OFF):
        return path, JoinCounts()
    (again,), joins = join(task, here[None], end[None])
    return again, joins


def connect(
    starts: Floats, ends: Floats, *, reach: Reach, barriers: Barriers, seed: int
) -> tuple[list[Floats | None], JoinCounts]:
    """Find a path for each move (n, 2) -> (n, 2) [m]: straight if clear, else by OMPL, else over raster nodes.

    Returns
    -------
    paths : (k, 2) [m] Corners with both ends, k = 2 for a straight path; None where no path was found.

    Raises
    ------
    PlanError : OMPL is not installed, or its process failed.
    """
    direct = barriers.are_clear(starts, ends, reach.clearance)
    paths: list[Floats | None] = [np.stack(ends_) for ends_ in zip(starts, ends, strict=True)]
    blocked = np.flatnonzero(~direct)
    if len(blocked):
        found = _query(starts[blocked], ends[blocked], reach, seed)
        for k, corners in zip(blocked.tolist(), found, strict=True):
            paths[k] = _certified_path(corners, barriers, reach.clearance)
            if paths[k] is None and (nodes := raster_path(starts[k], ends[k], reach)) is not None:
                paths[k] = _certified_path(nodes, barriers, reach.clearance)
    planned = [path for k in blocked.tolist() if (path := paths[k]) is not None]
    return paths, JoinCounts(
        direct=int(direct.sum()),
        planned=len(planned),
        failed=len(blocked) - len(planned),
        planned_m=float(sum(np.hypot(*np.diff(path, axis=0).T).sum() for path in planned)),
    )


def _certified_path(path: Floats, barriers: Barriers, clearance: float) -> Floats | None:
    """Remove needless corners; None if the exact clearance, less the slack if needed, does not hold along the path."""
    if len(path) < 2:
        return None
    for least in (clearance, clearance - CLEARANCE_SLACK):
        kept = [0]
        while kept[-1] < len(path) - 1:
            later = np.arange(len(path) - 1, kept[-1], -1)
            here = np.repeat(path[kept[-1]][None], len(later), axis=0)
            clear = barriers.are_clear(here, path[later], least)
            if not clear.any():
                break
            kept.append(int(later[clear.argmax()]))
        else:
            return path[kept]
    return None


def _query(starts: Floats, ends: Floats, reach: Reach, seed: int) -> list[Floats]:
    """Solve queries (n, 2) -> (n, 2) [m] by OMPL; an empty path means that none was found."""
    data = call_ompl("planners.joins.ompl_paths", seed=seed, starts=starts, ends=ends, **floor_arrays(reach))
    return list(np.split(data["points"], np.cumsum(data["lengths"])[:-1]))


def floor_arrays(reach: Reach) -> dict[str, Any]:
    """Return the arrays that describe the floor to an OMPL process, and the name of its planner."""
    return {
        "distance": reach.distance,
        "origin": reach.origin,
        "step": reach.step,
        "clearance": reach.clearance,
        "planner": reach.join_planner,
    }


def raster_path(start: Floats, end: Floats, reach: Reach) -> Floats | None:
    """Return places (k, 2) [m] from `start` to `end`, both included, over reachable nodes; None if there is no path.

    The costs keep the path away from walls where that makes it only a little longer.
    """
    number = np.cumsum(reach.mask.ravel()).reshape(reach.mask.shape) - 1
    first, last = (reach.nearest(place) for place in (start, end))
    if first is None or last is None:
        return None
    graph = _node_graph(reach)
    source, goal = int(number[tuple(first)]), int(number[tuple(last)])
    far, before = csgraph.dijkstra(
        graph, directed=False, indices=np.array([source]), return_predecessors=True
    )
    if not np.isfinite(far[0, goal]):
        return None
    route = [goal]
    while route[-1] != source:
        route.append(int(before[0, route[-1]]))
    nodes = np.flatnonzero(reach.mask.ravel())[route[::-1]]
    places = reach.nodes(np.unravel_index(nodes, reach.mask.shape))
    return np.concatenate([start[None], places, end[None]])


def _node_graph(reach: Reach) -> sparse.csr_array:
    """Return the costs [m] from each reachable node to its eight neighbours."""
    depth = (reach.distance[reach.mask] - reach.clearance) / reach.step
    cost_per_metre = 1 + 1 / (1 + np.maximum(depth, 0.0))
    nodes = np.argwhere(reach.mask)
    one, other = neighbours(nodes).T
    lengths = np.hypot(*(nodes[other] - nodes[one]).T) * reach.step
    costs = 0.5 * lengths * (cost_per_metre[one] + cost_per_metre[other])
    return sparse.csr_array(sparse.coo_array((costs, (one, other)), shape=(len(nodes), len(nodes))))
