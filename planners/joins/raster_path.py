"""Shortest path over the nodes of the distance raster (Dijkstra's algorithm).

With the distance d of a node to the nearest wall, a step from node a to a neighbouring node b costs

    |a - b| (c(a) + c(b)) / 2.

    Cost per metre: c = 1 + 1 / (1 + max(d - clearance, 0) / step).

Nodes next to walls cost twice their length. The path connects places that are far apart through doors that
OMPL's samples miss. A straight line between the middles of large cells may not pass a door; a path over nodes
does.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from planners.order import HALF_NEIGHBOURHOOD
from planners.reach import Reach
from planners.types import Floats, Ints


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
