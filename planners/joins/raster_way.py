"""The shortest way over the nodes of the raster, where places far apart are joined through doors that OMPL's samples miss.

Between the middles of large cells no straight way may lead through a door; from node to node one does.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from planners.reach import Reach
from planners.types import Floats, Ints

NEIGHBOURS = ((1, 0), (0, 1), (1, 1), (1, -1))


def raster_way(start: Floats, end: Floats, reach: Reach) -> Floats | None:
    """Return places (k, 2) [m] from one to the other, both included, over reachable nodes; None: there is no such way.

    Nodes near walls cost up to twice their length, so that the way keeps to the middle where that is little longer.
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
    """Return what it costs to go from each reachable node to its eight neighbours [m]."""
    room = (reach.distance - reach.clearance) / reach.step
    dear = 1 + 1 / (1 + np.maximum(room, 0.0))
    nx, ny = reach.mask.shape
    rows, columns, costs = [], [], []
    for i, j in NEIGHBOURS:
        here = (slice(0, nx - i), slice(max(-j, 0), ny - max(j, 0)))
        there = (slice(i, nx), slice(max(j, 0), ny + min(j, 0)))
        both = reach.mask[here] & reach.mask[there]
        rows.append(number[here][both])
        columns.append(number[there][both])
        costs.append(0.5 * np.hypot(i, j) * reach.step * (dear[here] + dear[there])[both])
    n = int(reach.mask.sum())
    entries = (np.concatenate(costs), (np.concatenate(rows), np.concatenate(columns)))
    return sparse.csr_array(sparse.coo_array(entries, shape=(n, n)))


def _nearest_node(place: Floats, reach: Reach) -> Ints | None:
    """Return the index (2,) of the reachable node nearest to a place, of those around it; None: there is none."""
    at = np.floor((place - reach.origin) / reach.step).astype(np.intp)
    low = np.maximum(at - 2, 0)
    around = np.argwhere(reach.mask[low[0] : at[0] + 3, low[1] : at[1] + 3]) + low
    if not len(around):
        return None
    away = np.hypot(*(reach.nodes(tuple(around.T)) - place).T)
    return np.asarray(around[away.argmin()])
