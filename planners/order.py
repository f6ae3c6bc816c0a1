"""The order in which cells are visited: boustrophedon lanes, joined by 2-opt and Or-opt with reversal, by time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from planners.settings import TOURS
from planners.types import Floats, Ints

ROWS_AT_A_TIME = 256
"""Ends searched from at a time."""
HALF_NEIGHBOURHOOD = ((1, 0), (0, 1), (1, 1), (1, -1))


@dataclass(frozen=True, kw_only=True, eq=False)
class CellGraph:
    """The places to visit and which straight moves between neighbours are clear."""

    index: Ints
    """(n, 2) cell (i, j) of each place."""
    places: Floats
    """(n, 2) [m] where the robot stands in it."""
    pairs: Ints
    """(m, 2) places in neighbouring cells with a clear straight move between them."""


def neighbours(index: Ints) -> Ints:
    """Return pairs (m, 2) of cells that touch, corners included."""
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
    """Return (len(ends), len(ends)) [s] by clear moves between neighbours, or around by the straight line's double.

    A way takes its length over `speed`, and `stop` once. Among many ends only the near ones are worth a search.
    """
    n = len(cells.index)
    lengths = np.hypot(*(cells.places[cells.pairs[:, 1]] - cells.places[cells.pairs[:, 0]]).T)
    graph = sparse.csr_matrix((np.maximum(lengths, 1e-6), tuple(cells.pairs.T)), shape=(n, n))
    limit = np.inf if len(ends) <= TOURS.many_ends else TOURS.near
    far = np.empty((len(ends), len(ends)))
    for rows in range(0, len(ends), ROWS_AT_A_TIME):
        some = np.s_[rows : rows + ROWS_AT_A_TIME]
        far[some] = csgraph.dijkstra(graph, directed=False, indices=ends[some], limit=limit)[:, ends]
        lost = np.isinf(far[some])
        straight = np.hypot(
            *(cells.places[ends[some]][:, None] - cells.places[ends][None]).transpose(2, 0, 1)
        )
        far[some][lost] = 2 * straight[lost] + 5.0
    return np.asarray(np.where(far > 0, far / speed + stop, 0.0))


def tour(
    cost: Floats, first: int | None, rng: np.random.Generator, kicks: int = TOURS.kicks
) -> list[tuple[int, bool]]:
    """Order runs; run k has its ends at rows 2k and 2k + 1 of `cost` (2n, 2n) [s].

    Parameters
    ----------
    first : row of `cost` that stands for the start (a run of its own, whose other row equals it); None: anywhere

    Returns
    -------
    runs with whether each is driven from its second end to its first
    """
    n = len(cost) // 2
    if n == 1:
        return [(0, False)]
    order = _Tour.greedy(cost, first)
    if len(cost) > TOURS.many_ends:
        order.improve_by_windows()
        return [(int(a) // 2, bool(a % 2)) for a, _ in order.nodes]
    order.improve()
    best, least = order.nodes.copy(), order.total()
    for _ in range(kicks if n > 8 else 0):
        order.kick(rng)
        order.improve()
        total = order.total()
        if total < least - 1e-9:
            best, least = order.nodes.copy(), total
        else:
            order.nodes = best.copy()
    return [(int(a) // 2, bool(a % 2)) for a, _ in best]


class _Tour:
    """A sequence of runs as nodes (n, 2): entry and exit of each; the first is fixed where a start is given."""

    def __init__(self, cost: Floats, nodes: Ints, fixed: int, pinned: bool = False) -> None:
        self.cost, self.nodes, self.fixed, self.pinned = cost, nodes, fixed, pinned
        self.moves = 0

    @classmethod
    def greedy(cls, cost: Floats, first: int | None) -> _Tour:
        """Go on to the nearest end of a run not yet driven."""
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
        """Return the cost [s] of all joins."""
        return float(self.cost[self.nodes[:-1, 1], self.nodes[1:, 0]].sum())

    def improve(self) -> None:
        """Apply the best reversal or relocation until none helps."""
        while self.moves < TOURS.max_moves and (self._reverse() or self._relocate()):
            self.moves += 1

    def improve_by_windows(self) -> None:
        """Improve stretches that overlap by half, their ends held."""
        for start in range(0, max(len(self.nodes) - TOURS.window // 2, 1), TOURS.window // 2):
            stretch = np.s_[start : start + TOURS.window]
            last = start + TOURS.window >= len(self.nodes)
            part = _Tour(self.cost, self.nodes[stretch].copy(), 1 if start else self.fixed, not last)
            part.improve()
            self.nodes[stretch] = part.nodes

    def kick(self, rng: np.random.Generator) -> None:
        """Swap two neighbouring stretches of random length."""
        n = len(self.nodes)
        a = int(rng.integers(self.fixed, n - 2))
        b, c = np.sort(rng.integers(a + 1, min(a + 50, n) + 1, 2)).tolist()
        self.nodes = np.concatenate([self.nodes[:a], self.nodes[b:c], self.nodes[a:b], self.nodes[c:]])

    def _reverse(self) -> bool:
        """Reverse the stretch k..m (each run in it too) that saves most."""
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
        """Move a stretch of one to three runs elsewhere, either way round, where it saves most."""
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
                spent = cost[np.ix_(head, leave[:-1])] + cost[np.ix_(tail, entry[1:])] - joins[None]
                end = cost[head, leave[-1]] + np.where((last == n - 1) | self.pinned, np.inf, 0.0)
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
