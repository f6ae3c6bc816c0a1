"""Order of visits: boustrophedon lanes, joined into a tour by nearest neighbour, 2-opt and Or-opt with reversal.

A tour is a sequence of runs (lanes), each driven from its entry to its exit. It minimises the time of its
joins:

    total = Σ cost[exit of run k, entry of run k + 1].

2-opt (G. A. Croes, Operations Research 6, 1958) reverses a stretch of runs. Or-opt (I. Or, thesis, Northwestern
University, 1976) moves one to three runs elsewhere, in either direction. Random perturbations of the best tour
lead out of local optima. The constants were set with `python -m benchmarks.coverage_planners --planner
stop_and_spin` and `--large 50 36`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from planners.types import Floats, Ints
from planners.vehicle import Limits

KICKS = 60
"""Number of perturbations of a finished order by one to three random swaps; each is kept if it shortens the tour."""
MANY_ENDS = 1000
"""Number of lane ends above which paths are searched only nearby and orders are improved by windows."""
NEAR = 8.0
"""[m] Search radius of a path when there are many lane ends."""
WINDOW = 160
"""Number of lanes improved together when there are many lane ends."""

FORBIDDEN = 1e9
"""[s] time of a join that no tour contains, such as to the end of an item that has a direction."""
ROWS_AT_A_TIME = 256
"""Number of lane ends per call of Dijkstra's algorithm."""
HALF_NEIGHBOURHOOD = ((1, 0), (0, 1), (1, 1), (1, -1))
"""Steps to one of each two neighbours on opposite sides of a cell."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CellGraph:
    """Places to visit, and the clear straight moves between neighbouring cells."""

    index: Ints
    """(n, 2) cell (i, j) of each place."""
    places: Floats
    """(n, 2) [m] place of the robot in each cell."""
    pairs: Ints
    """(m, 2) indices of places in neighbouring cells with a clear straight move between them."""


def neighbours(index: Ints) -> Ints:
    """Return the pairs (m, 2) of cells that touch, including at corners."""
    low = index.min(axis=0)
    shape = tuple(index.max(axis=0) - low + 3)
    number = np.full(shape, -1, dtype=np.int64)
    at = index - low + 1
    number[tuple(at.T)] = np.arange(len(index))
    found = []
    for step in HALF_NEIGHBOURHOOD:
        other = number[tuple((at + step).T)]
        here = np.flatnonzero(other >= 0)
        found.append(np.column_stack([here, other[here]]))
    return np.concatenate(found)


def runs(cells: CellGraph, axis: int) -> list[Ints]:
    """Cut each row (axis 0) or column (axis 1) of cells into chains of clear straight moves."""
    step = cells.index[cells.pairs[:, 1]] - cells.index[cells.pairs[:, 0]]
    along = (step[:, axis] == 1) & (step[:, 1 - axis] == 0)
    following = np.full(len(cells.index), -1, dtype=np.int64)
    following[cells.pairs[along, 0]] = cells.pairs[along, 1]
    heads = np.setdiff1d(np.arange(len(cells.index)), following[following >= 0])
    chains = []
    for head in heads.tolist():
        chain = [head]
        while following[chain[-1]] >= 0:
            chain.append(int(following[chain[-1]]))
        chains.append(np.array(chain))
    return chains


def travel_times(cells: CellGraph, ends: Ints, speed: float, stop: float) -> Floats:
    """Return the travel times (len(ends), len(ends)) [s] over clear moves between neighbours.

    A path takes its length over `speed` plus `stop`. A pair without a path counts as twice its distance plus
    5 m. Among many ends, only paths of up to `NEAR` are searched.
    """
    n = len(cells.index)
    lengths = np.hypot(*(cells.places[cells.pairs[:, 1]] - cells.places[cells.pairs[:, 0]]).T)
    graph = sparse.csr_matrix((np.maximum(lengths, 1e-6), tuple(cells.pairs.T)), shape=(n, n))
    limit = np.inf if len(ends) <= MANY_ENDS else NEAR
    far = np.empty((len(ends), len(ends)))
    for rows in range(0, len(ends), ROWS_AT_A_TIME):
        some = np.s_[rows : rows + ROWS_AT_A_TIME]
        far[some] = csgraph.dijkstra(graph, directed=False, indices=ends[some], limit=limit)[:, ends]
        unconnected = np.isinf(far[some])
        straight = np.hypot(
            *(cells.places[ends[some]][:, None] - cells.places[ends][None]).transpose(2, 0, 1)
        )
        far[some][unconnected] = 2 * straight[unconnected] + 5.0
    return np.asarray(np.where(far > 0, far / speed + stop, 0.0))


def tour(cost: Floats, first: int | None, rng: np.random.Generator) -> list[tuple[int, bool]]:
    """Order runs by the time of their joins; run k has its ends at rows 2k and 2k + 1 of `cost` (2n, 2n) [s].

    Parameters
    ----------
    first : Row of `cost` that represents the start, as a run whose two rows are equal; None: start anywhere.

    Returns
    -------
    The runs, each with whether it is driven from its second end to its first.
    """
    n = len(cost) // 2
    if n == 1:
        return [(0, False)]
    order = _Tour.greedy(cost, first)
    if len(cost) > MANY_ENDS:
        order.improve_by_windows()
        return [(int(a) // 2, bool(a % 2)) for a, _ in order.nodes]
    order.improve()
    best, least = order.nodes.copy(), order.total()
    for trial in range(KICKS if n > 3 else 0):
        for _ in range(1 + trial % 3):
            order.kick(rng)
        order.improve()
        total = order.total()
        if total < least - 1e-9:
            best, least = order.nodes.copy(), total
        else:
            order.nodes = best.copy()
    return [(int(a) // 2, bool(a % 2)) for a, _ in best]


def visiting_order(floor: CellGraph, places: Floats, here: Floats | None, limits: Limits, seed: int) -> Ints:
    """Order places (n, 2) [m] by the travel times over the floor, from `here` (3,) if given."""
    points = places if here is None else np.concatenate([places, here[None, :2]])
    near = np.array([((floor.places - point) ** 2).sum(axis=1).argmin() for point in points])
    cost = travel_times(floor, np.repeat(near, 2), limits.v, limits.v / limits.a)
    found = tour(cost, None if here is None else 2 * len(places), np.random.default_rng(seed))
    return np.array([k for k, _ in found if k < len(places)], dtype=np.int64)


def sequence(cost: Floats, first: Floats | None) -> Ints:
    """Order items (n,) by the time (n, n) [s] from the end of one to the start of another.

    Parameters
    ----------
    first : (n,) [s] Time from the start to each item; None: any item may be first.
    """
    n = len(cost)
    ends = np.full((2 * n + 2, 2 * n + 2), FORBIDDEN)
    ends[1 : 2 * n : 2, 0 : 2 * n : 2] = cost
    ends[2 * n + 1, 0 : 2 * n : 2] = 0.0 if first is None else first
    found = tour(ends, 2 * n, np.random.default_rng(0))
    return np.array([k for k, _ in found if k < n], dtype=np.int64)


class _Tour:
    """Runs as nodes (n, 2), entry and exit of each; the first run is fixed if a start is given."""

    def __init__(self, cost: Floats, nodes: Ints, fixed: int, pinned: bool = False) -> None:
        self.cost, self.nodes, self.fixed, self.pinned = cost, nodes, fixed, pinned

    @classmethod
    def greedy(cls, cost: Floats, first: int | None) -> _Tour:
        """Start a tour that continues at the nearest end of a run not yet driven."""
        n = len(cost) // 2
        open_ = np.ones(2 * n, dtype=np.bool_)
        here = 0 if first is None else first
        nodes = []
        for _ in range(n):
            nodes.append((here, here ^ 1))
            open_[[here, here ^ 1]] = False
            if open_.any():
                here = int(np.where(open_, cost[here ^ 1], np.inf).argmin())
        return cls(cost, np.array(nodes, dtype=np.int64), 0 if first is None else 1)

    def total(self) -> float:
        """Return the total time [s] of all joins."""
        return float(self.cost[self.nodes[:-1, 1], self.nodes[1:, 0]].sum())

    def improve(self) -> None:
        """Apply the best reversal or relocation until none shortens the tour."""
        while self._reverse() or self._relocate():
            pass

    def improve_by_windows(self) -> None:
        """Improve windows that overlap by half; their first and last runs are fixed."""
        for start in range(0, max(len(self.nodes) - WINDOW // 2, 1), WINDOW // 2):
            stretch = np.s_[start : start + WINDOW]
            last = start + WINDOW >= len(self.nodes)
            part = _Tour(self.cost, self.nodes[stretch].copy(), 1 if start else self.fixed, not last)
            part.improve()
            self.nodes[stretch] = part.nodes

    def kick(self, rng: np.random.Generator) -> None:
        """Swap two neighbouring stretches of random length (perturbation)."""
        n = len(self.nodes)
        a = int(rng.integers(self.fixed, n - 2))
        b, c = np.sort(rng.integers(a + 1, min(a + 50, n) + 1, 2)).tolist()
        self.nodes = np.concatenate([self.nodes[:a], self.nodes[b:c], self.nodes[a:b], self.nodes[c:]])

    def _reverse(self) -> bool:
        """Reverse the stretch k ... m, and the direction of each run in it, that saves most (2-opt)."""
        cost, f = self.cost, self.fixed
        entry, leave = self.nodes.T
        n = len(entry)
        before = np.zeros(n)
        before[1:] = cost[leave[:-1], entry[1:]]
        after = np.append(before[1:], 0.0)
        new_before = np.zeros((n, n))
        new_before[1:] = cost[np.ix_(leave[:-1], leave)]  # exit of k-1 to exit of m
        new_after = np.zeros((n, n))
        new_after[:, :-1] = cost[np.ix_(entry, entry[1:])]  # entry of k to entry of m+1
        gain = before[:, None] + after[None, :] - new_before - new_after
        gain[np.tril_indices(n, -1)] = 0.0
        gain[:f] = 0.0
        if self.pinned:
            gain[:, -1] = 0.0
        k, m = np.unravel_index(int(gain.argmax()), gain.shape)
        if gain[k, m] < 1e-9:
            return False
        self.nodes[k : m + 1] = self.nodes[k : m + 1][::-1, ::-1]
        return True

    def _relocate(self) -> bool:
        """Move one to three runs elsewhere, in either direction, where that saves most (Or-opt)."""
        best: tuple[float, int, int, int, bool] = (1e-9, 0, 0, 0, False)
        entry, leave = self.nodes.T
        n, cost = len(entry), self.cost
        joins = cost[leave[:-1], entry[1:]]
        for size in (1, 2, 3):
            k = np.arange(self.fixed, n - size + 1 - self.pinned)
            if len(k) < 2:
                continue
            last = k + size - 1
            ahead = np.where(k > 0, cost[leave[k - 1], entry[k]], 0.0)
            behind = np.where(last < n - 1, cost[leave[last], entry[np.minimum(last + 1, n - 1)]], 0.0)
            closed = cost[leave[k - 1], entry[np.minimum(last + 1, n - 1)]]
            closed = np.where((k > 0) & (last < n - 1), closed, 0.0)
            saved = ahead + behind - closed  # (len(k),)
            gap = np.arange(n - 1)  # between gap and gap + 1
            inside = (gap[None] >= k[:, None] - 1) & (gap[None] <= last[:, None])
            for flipped in (False, True):
                head, tail = (leave[last], entry[k]) if flipped else (entry[k], leave[last])
                spent = cost[np.ix_(leave[:-1], head)].T + cost[np.ix_(tail, entry[1:])] - joins[None]
                end = cost[leave[-1], head] + np.where((last == n - 1) | self.pinned, np.inf, 0.0)
                gain = saved[:, None] - np.column_stack([np.where(inside, np.inf, spent), end])
                at = np.unravel_index(int(gain.argmax()), gain.shape)
                if gain[at] > best[0]:
                    best = (float(gain[at]), int(k[at[0]]), size, int(at[1]), flipped)
        _, start, size, gap_, flipped = best
        if size == 0:
            return False
        block = self.nodes[start : start + size]
        rest = np.delete(self.nodes, np.s_[start : start + size], axis=0)
        at_ = gap_ + 1 - (size if gap_ >= start else 0)
        block = block[::-1, ::-1] if flipped else block
        self.nodes = np.concatenate([rest[:at_], block, rest[at_:]])
        return True
