"""Shortest paths over a grid of the free space, with some way off the walls."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from shapely.geometry import LineString
from shapely.prepared import prep

from benchmarks.blind_world.rooms import Floats

GRID_STEP = 0.08
"""[m]"""
PATH_STEP = 0.04
"""[m] between points of a path."""


def densified(points: Floats) -> Floats:
    """Return a path (n, 2) [m] with a point every PATH_STEP."""
    way = np.r_[0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))]
    if way[-1] < 1e-6:
        return points[:1]
    at = np.linspace(0, way[-1], max(2, int(way[-1] / PATH_STEP) + 1))
    return np.column_stack([np.interp(at, way, points[:, 0]), np.interp(at, way, points[:, 1])])


class Planner:
    """The grid of a free space; paths keep `clearance` [m] off its walls."""

    def __init__(self, free: Any, clearance: float) -> None:
        self.free, self.clearance = free, clearance
        self.passable = prep(free.buffer(-(clearance - 0.02)))
        x0, y0, x1, y1 = free.bounds
        X, Y = np.meshgrid(np.arange(x0, x1, GRID_STEP), np.arange(y0, y1, GRID_STEP), indexing="ij")
        points = shapely.points(X.ravel(), Y.ravel())
        safe = shapely.contains(free.buffer(-clearance), points)
        self.nodes: Floats = np.column_stack([X.ravel(), Y.ravel()])[safe]  # (n_nodes, 2)
        self.room_at: Floats = shapely.distance(free.boundary, points)[safe]
        """(n_nodes,) [m] to the nearest wall."""
        index = -np.ones(safe.size, int)
        index[safe] = np.arange(safe.sum())
        self._graph = self._edges(index.reshape(X.shape))
        _, label = connected_components(self._graph, directed=False)
        self.reachable = np.flatnonzero(label == np.bincount(label).argmax()) if label.size else label

    def _edges(self, index: Any) -> Any:
        rows, columns, costs = [], [], []
        for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1)):
            low = 1 if dy < 0 else 0
            one = index[: index.shape[0] - dx, low : (index.shape[1] - (1 if dy > 0 else 0))]
            other = index[dx:, (0 if dy < 0 else dy) : (index.shape[1] - 1 if dy < 0 else None)]
            both = (one >= 0) & (other >= 0)
            a, b = one[both], other[both]
            rows.append(a)
            columns.append(b)
            near = np.minimum(self.room_at[a], self.room_at[b])
            costs.append(GRID_STEP * np.hypot(dx, dy) * (1 + 0.12 / near))
        n = len(self.nodes)
        links = (np.concatenate(rows), np.concatenate(columns))
        return coo_matrix((np.concatenate(costs), links), (n, n)).tocsr()

    def near(self, point: Floats) -> int:
        """Return the reachable node nearest to a point (2,) [m]."""
        return int(self.reachable[np.argmin(((self.nodes[self.reachable] - point) ** 2).sum(axis=1))])

    def path(self, start: Floats, goal: Floats) -> Floats:
        """Return a path (n, 2) [m] from start to near the goal, straightened where nothing is in the way."""
        first, last = self.near(start), self.near(goal)
        _, trees = dijkstra(self._graph, directed=False, indices=[last], return_predecessors=True)
        before, nodes = trees[0], [first]
        while nodes[-1] != last and before[nodes[-1]] >= 0:
            nodes.append(before[nodes[-1]])
        points = self.nodes[nodes]
        if np.hypot(*(points[0] - start)) > 0.02:
            points = np.vstack([start, points])
        out, i = [points[0]], 0
        while i < len(points) - 1:
            j = min(len(points) - 1, i + 60)
            while j > i + 1 and not self.passable.covers(LineString([points[i], points[j]])):
                j -= max(1, (j - i) // 6)
            i = max(j, i + 1)
            out.append(points[i])
        return densified(np.array(out))
