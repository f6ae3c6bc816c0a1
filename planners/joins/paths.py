"""Joins of robots that turn in place: straight where that is clear, else by OMPL (`ompl_paths`).

If OMPL finds no path, `raster_path` is the shortest one over the nodes of the distance raster (Dijkstra's
algorithm). With the distance d of a node to the nearest wall, a step from node a to a neighbouring node b costs

    |a - b| (c(a) + c(b)) / 2.

    Cost per metre: c = 1 + 1 / (1 + max(d - clearance, 0) / step).

Nodes next to walls cost twice their length. The path connects places that are far apart through doors that
OMPL's samples miss. A straight line between the middles of large cells may not pass a door; a path over nodes
does.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from planners.clearance import Barriers
from planners.joins.ompl_process import CLEARANCE_SLACK, call_ompl
from planners.order import HALF_NEIGHBOURHOOD
from planners.reach import Reach
from planners.rooms import cell_graph
from planners.task import JoinCounts, Task
from planners.types import ROUND_OFF, Floats, Ints

MAX_GOALS = 400
"""Maximum number of goals per query; the nearest ones are used."""
LEG_LENGTH = 4.0
"""[m] Length of the legs in which a path is searched that OMPL does not find as a whole
(`python -m benchmarks.coverage_planners --large 42 30`)."""
QUERIES_PER_PROCESS = 48
"""Number of queries per process; fixed, so that results do not depend on the number of processors."""


def join(task: Task, starts: Floats, ends: Floats) -> tuple[list[Floats | None], JoinCounts]:
    """Find a path for each move (n, 2) -> (n, 2) [m] of a task, as `connect`."""
    return connect(starts, ends, reach=task.reach, barriers=task.barriers, seed=task.seed)


def continued(path: Floats | None, here: Floats, end: Floats, task: Task) -> tuple[Floats | None, JoinCounts]:
    """Return a path (k, 2) [m], or another one to its end (2,) if it does not begin `here` (2,).

    This is so if the place before was not reached.
    """
    if path is None or np.allclose(path[0], here, atol=ROUND_OFF):
        return path, JoinCounts()
    (again,), joins = join(task, here[None], end[None])
    return again, joins


def connect(
    starts: Floats, ends: Floats, *, reach: Reach, barriers: Barriers, seed: int, in_parts: bool = True
) -> tuple[list[Floats | None], JoinCounts]:
    """Find a path for each move (n, 2) -> (n, 2) [m]: straight if clear, else by OMPL.

    Parameters
    ----------
    in_parts : Whether to search in parts for paths that OMPL does not find as a whole.

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
        found = _query_in_batches(starts[blocked], ends[blocked], reach, seed)
        for k, corners in zip(blocked.tolist(), found, strict=True):
            paths[k] = _certified_path(corners, barriers, reach.clearance)
            if paths[k] is None and in_parts:
                paths[k] = _connect_in_parts(starts[k], ends[k], reach, barriers, seed)
    planned = [path for k in blocked.tolist() if (path := paths[k]) is not None]
    return paths, JoinCounts(
        direct=int(direct.sum()),
        planned=len(planned),
        failed=len(blocked) - len(planned),
        planned_m=float(sum(np.hypot(*np.diff(path, axis=0).T).sum() for path in planned)),
    )


def connect_nearest(
    start: Floats, goals: Floats, *, reach: Reach, barriers: Barriers, seed: int
) -> tuple[Floats | None, JoinCounts]:
    """Find a path from a place (2,) to one of the goals (m, 2) [m]: straight to the nearest if clear, else by OMPL.

    All goals are in one query (`ob.GoalStates`).

    Returns
    -------
    path : (k, 2) [m] Corners with both ends; None where no path was found.
    """
    nearest = np.argsort(np.hypot(*(goals - start).T), kind="stable")
    clear = barriers.are_clear(np.repeat(start[None], len(goals), axis=0), goals[nearest], reach.clearance)
    if clear.any():
        return np.stack([start, goals[nearest[clear.argmax()]]]), JoinCounts(direct=1)
    (found,) = _query(start[None], [goals[nearest[:MAX_GOALS]]], reach, seed)
    path = _certified_path(found, barriers, reach.clearance)
    if path is None:
        path = _connect_in_parts(start, goals[nearest[0]], reach, barriers, seed)
    if path is None:
        return None, JoinCounts(failed=1)
    return path, JoinCounts(planned=1, planned_m=float(np.hypot(*np.diff(path, axis=0).T).sum()))


def _connect_in_parts(
    start: Floats, end: Floats, reach: Reach, barriers: Barriers, seed: int
) -> Floats | None:
    """Find a path (k, 2) [m] that OMPL did not find as a whole: in legs over cells, else over raster nodes."""
    path = _path_over_cells(start, end, reach, barriers, seed)
    return _path_over_nodes(start, end, reach, barriers, seed) if path is None else path


def _path_over_cells(
    start: Floats, end: Floats, reach: Reach, barriers: Barriers, seed: int
) -> Floats | None:
    """Find a path (k, 2) [m] in legs between places on the shortest path over cells.

    None if that path is shorter than a leg, or if a leg is not found.
    """
    at = [np.floor((place - reach.origin) / reach.cell).astype(np.int64) for place in (start, end)]
    first, last = (int(np.ravel_multi_index(tuple(cell), reach.shape)) for cell in at)
    far, before = csgraph.dijkstra(
        cell_graph(reach), directed=False, indices=np.array([first]), return_predecessors=True
    )
    if not LEG_LENGTH / reach.cell < far[0, last] < np.inf:
        return None
    route = [last]
    while route[-1] != first:
        route.append(int(before[0, route[-1]]))
    cells = np.unravel_index(route[::-1][:: max(round(LEG_LENGTH / reach.cell), 1)][1:], reach.shape)
    stops = np.concatenate([start[None], reach.deepest(np.column_stack(cells)), end[None]])
    return _joined_legs(stops, reach, barriers, seed)


def _path_over_nodes(
    start: Floats, end: Floats, reach: Reach, barriers: Barriers, seed: int
) -> Floats | None:
    """Find a path (k, 2) [m] along the shortest path over raster nodes, by straight pieces or OMPL in legs."""
    nodes = raster_path(start, end, reach)
    if nodes is None:
        return None
    path = _certified_path(nodes, barriers, reach.clearance)
    if path is not None:
        return path
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(nodes, axis=0).T))])
    if along[-1] <= LEG_LENGTH:
        return None
    stops = nodes[np.searchsorted(along, np.arange(0.0, along[-1], LEG_LENGTH / 2))]
    return _joined_legs(np.concatenate([stops, end[None]]), reach, barriers, seed, in_parts=False)


def _joined_legs(
    stops: Floats, reach: Reach, barriers: Barriers, seed: int, *, in_parts: bool = True
) -> Floats | None:
    """Find a path (k, 2) [m] through stops (n, 2); None if a leg is not found."""
    legs, _ = connect(stops[:-1], stops[1:], reach=reach, barriers=barriers, seed=seed, in_parts=in_parts)
    found = [leg for leg in legs if leg is not None]
    return np.concatenate([stops[:1], *(leg[1:] for leg in found)]) if len(found) == len(legs) else None


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


def _query_in_batches(starts: Floats, ends: Floats, reach: Reach, seed: int) -> list[Floats]:
    """Solve queries (n, 2) -> (n, 2) [m] in batches, in one process per processor."""
    goals = list(ends[:, None])
    batches = [slice(k, k + QUERIES_PER_PROCESS) for k in range(0, len(starts), QUERIES_PER_PROCESS)]
    seeds = [int(np.random.SeedSequence([seed, k]).generate_state(1)[0]) for k in range(len(batches))]
    if len(batches) == 1:
        return _query(starts, goals, reach, seeds[0])
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        answers = threads.map(
            lambda batch, own: _query(starts[batch], goals[batch], reach, own), batches, seeds
        )
        return [path for answer in answers for path in answer]


def _query(starts: Floats, goals: list[Floats], reach: Reach, seed: int) -> list[Floats]:
    """Solve queries (n, 2) [m], each with its goals (m, 2), in one process; an empty path means that none was found."""
    data = call_ompl(
        "planners.joins.ompl_paths",
        seed=seed,
        starts=starts,
        goals=np.concatenate(goals),
        counts=[len(own) for own in goals],
        **floor_arrays(reach),
    )
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
    first, last = (_nearest_node(place, reach) for place in (start, end))
    if first is None or last is None:
        return None
    graph = _node_graph(reach, number)
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


def _node_graph(reach: Reach, number: Ints) -> sparse.csr_array:
    """Return the costs [m] from each reachable node to its eight neighbours."""
    depth = (reach.distance - reach.clearance) / reach.step
    cost_per_metre = 1 + 1 / (1 + np.maximum(depth, 0.0))
    nx, ny = reach.mask.shape
    rows, columns, costs = [], [], []
    for i, j in HALF_NEIGHBOURHOOD:
        here = (slice(0, nx - i), slice(max(-j, 0), ny - max(j, 0)))
        there = (slice(i, nx), slice(max(j, 0), ny + min(j, 0)))
        both = reach.mask[here] & reach.mask[there]
        rows.append(number[here][both])
        columns.append(number[there][both])
        costs.append(0.5 * np.hypot(i, j) * reach.step * (cost_per_metre[here] + cost_per_metre[there])[both])
    n = int(reach.mask.sum())
    entries = (np.concatenate(costs), (np.concatenate(rows), np.concatenate(columns)))
    return sparse.csr_array(sparse.coo_array(entries, shape=(n, n)))


def _nearest_node(place: Floats, reach: Reach) -> Ints | None:
    """Return the index (2,) of the reachable node nearest to a place, among those around it, or None."""
    at = np.floor((place - reach.origin) / reach.step).astype(np.intp)
    low = np.maximum(at - 2, 0)
    around = np.argwhere(reach.mask[low[0] : at[0] + 3, low[1] : at[1] + 3]) + low
    if not len(around):
        return None
    away = np.hypot(*(reach.nodes(tuple(around.T)) - place).T)
    return np.asarray(around[away.argmin()])
