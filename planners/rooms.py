"""Rooms: parts of the floor that are wide inside and connected by narrow passages; a plan completes one at a time.

The division resembles a watershed. Connected places wider than `PASSAGE` are seeds; each cell joins the
seed nearest over open borders; small rooms are merged, large ones halved. The constants were set with
`python -m benchmarks.coverage_planners --arena --random 10 --first 1`.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from planners.reach import Reach
from planners.types import Bools, Ints

PASSAGE = 0.25
"""[m] beyond the clearance; a passage narrower than this separates two rooms."""
MIN_CELLS, MAX_CELLS = 60, 900
"""Number of cells of a room; smaller rooms are merged with a neighbour, larger ones halved."""

NEIGHBOUR_STEPS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))
"""Steps to the neighbours of a cell; bit d of `open_borders` is the neighbour at NEIGHBOUR_STEPS[d]."""


def open_borders(reach: Reach) -> Ints:
    """Return (nx, ny) bits, one for each neighbour that can be reached over the common border."""
    (nx, ny), p, mask = reach.shape, reach.per_cell, reach.mask
    found = np.zeros((nx, ny), dtype=np.int64)
    over_x = (mask[p - 1 : -1 : p] & mask[p::p]).reshape(nx - 1, ny, p).any(axis=2)
    over_y = (mask[:, p - 1 : -1 : p] & mask[:, p::p]).reshape(nx, p, ny - 1).any(axis=1)
    found[:-1][over_x] |= 1
    found[1:][over_x] |= 2
    found[:, :-1][over_y] |= 4
    found[:, 1:][over_y] |= 8
    return found


def cell_graph(reach: Reach) -> sparse.csr_matrix:
    """Return the graph (nx ny, nx ny) of cells whose common border can be crossed, with weights 1."""
    nx, ny = reach.shape
    number = np.arange(nx * ny).reshape(nx, ny)
    open_ = open_borders(reach)
    east, north = np.nonzero(open_ & 1), np.nonzero(open_ & 4)
    rows = np.concatenate([number[east], number[north]])
    columns = np.concatenate([number[east[0] + 1, east[1]], number[north[0], north[1] + 1]])
    return sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(nx * ny, nx * ny))


def rooms(reach: Reach, wanted: Bools) -> list[Bools]:
    """Divide the cells `wanted` (nx, ny) into rooms, each a mask (nx, ny)."""
    labels = _nearest_seed(_seeds(reach), reach)
    labels[~wanted] = -1
    labels = _merged(labels, reach)
    found: list[Bools] = []
    graph = cell_graph(reach)
    for label in np.unique(labels[labels >= 0]).tolist():
        found += _halved(np.asarray(labels == label), graph)
    return found


def _seeds(reach: Reach) -> Ints:
    """Return the number of the connected wide place in each cell; -1: none."""
    wide = reach.mask & (
        reach.distance >= reach.clearance + min(PASSAGE, reach.distance.max() - reach.clearance)
    )
    parts, _ = ndimage.label(wide)
    return np.asarray(reach.blocks(parts).max(axis=-1) - 1, dtype=np.int64)


def _nearest_seed(seeds: Ints, reach: Reach) -> Ints:
    """Return for each reachable cell the number of the seed nearest over open borders."""
    number = np.flatnonzero(seeds.ravel() >= 0)
    if not len(number):
        return np.where(reach.blocks(reach.mask).any(axis=-1), 0, -1)
    far, _, source = csgraph.dijkstra(
        cell_graph(reach), directed=False, indices=number, min_only=True, return_predecessors=True
    )
    reached = np.isfinite(far)
    out = np.full(seeds.size, -1, dtype=np.int64)
    out[reached] = seeds.ravel()[source[reached]]
    lone = (out < 0) & reach.blocks(reach.mask).any(axis=-1).ravel()
    out[lone] = seeds.max() + 1
    return out.reshape(seeds.shape)


def _merged(labels: Ints, reach: Reach) -> Ints:
    """Merge rooms that are too small into the neighbour with the longest common border."""
    open_ = open_borders(reach)
    labels = labels.copy()
    while True:
        pairs = np.concatenate(
            [
                np.column_stack([labels[:-1][open_[:-1] & 1 > 0], labels[1:][open_[:-1] & 1 > 0]]),
                np.column_stack(
                    [labels[:, :-1][open_[:, :-1] & 4 > 0], labels[:, 1:][open_[:, :-1] & 4 > 0]]
                ),
            ]
        )
        pairs = pairs[(pairs >= 0).all(axis=1) & (pairs[:, 0] != pairs[:, 1])]
        names, sizes = np.unique(labels[labels >= 0], return_counts=True)
        for k in np.argsort(sizes, kind="stable").tolist():
            own = names[k]
            if sizes[k] >= MIN_CELLS:
                return labels
            adjacent = np.concatenate([pairs[pairs[:, 0] == own, 1], pairs[pairs[:, 1] == own, 0]])
            if len(adjacent):
                labels[labels == own] = np.bincount(adjacent).argmax()
                break
        else:
            return labels


def _halved(room: Bools, graph: sparse.csr_matrix) -> list[Bools]:
    """Halve a room that is too large, recursively: the half near one end, and the connected parts of the rest.

    Parts of the rest that are too small stay with the near half.
    """
    if room.sum() <= MAX_CELLS:
        return [room]
    parts = _connected_parts(room, graph)
    if len(parts) > 1:
        return [half for part in parts for half in _halved(part, graph)]
    cells = np.flatnonzero(room.ravel())
    within = graph[cells][:, cells]
    end = csgraph.dijkstra(within, directed=False, indices=np.zeros(1, dtype=np.int64))[0].argmax()
    far = csgraph.dijkstra(within, directed=False, indices=np.array([end]))[0]
    near = np.zeros_like(room)
    near.ravel()[cells[far <= np.median(far)]] = True
    rest = _connected_parts(np.asarray(room & ~near), graph)
    large = [part for part in rest if part.sum() >= MIN_CELLS]
    if not large:
        return [room]
    near = np.asarray(room & ~np.any(large, axis=0))
    return [half for part in (near, *large) for half in _halved(part, graph)]


def _connected_parts(room: Bools, graph: sparse.csr_matrix) -> list[Bools]:
    """Return the parts of a room that no open border connects, each a mask (nx, ny)."""
    cells = np.flatnonzero(room.ravel())
    n, label = csgraph.connected_components(graph[cells][:, cells], directed=False)
    parts = np.zeros((n, room.size), dtype=np.bool_)
    parts[label, cells] = True
    return [part.reshape(room.shape) for part in parts]
