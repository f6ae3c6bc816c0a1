"""Compiled kernels of the flood of a whole floor: all that a car can get to, or the first bin."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planners.kernel import inner_kernel, kernel
from planners.search.kernel_world import CREDITS, Branches, Moves, World, attempt, end_of, is_safe, trace
from planners.types import Bools, Floats, Ints


class Queue(NamedTuple):
    """The states that a flood of the whole floor has come to, in order."""

    at: Floats
    """(n, 2)"""
    hs: Branches
    parents: Branches
    branches: Branches


@kernel
def queue_for(n: int) -> Queue:
    """Return room for so many states."""
    return Queue(np.empty((n, 2)), np.empty(n, np.int32), np.empty(n, np.int32), np.empty(n, np.int32))


@kernel
def larger(queue: Queue) -> Queue:
    """Return a queue with twice the room."""
    n = len(queue.hs)
    more = queue_for(2 * n)
    more.at[:n], more.hs[:n] = queue.at, queue.hs
    more.parents[:n], more.branches[:n] = queue.parents, queue.branches
    return more


@inner_kernel
def _spread_on(
    head: int,
    tail: int,
    queue: Queue,
    allowed: Bools,
    met: Bools,
    to_first: bool,
    world: World,
    moves: Moves,
    lattice: float,
    credits: Ints,
) -> int:
    """Queue the states that state `head` leads to; return the end of the queue.

    to_first : branches that come to a bin are noted as -1 - branch, and the bins are left
    """
    ny, n_phi = world.need.shape[1], world.need.shape[2]
    x, y, h = queue.at[head, 0], queue.at[head, 1], queue.hs[head]
    for j in range(moves.then.shape[1]):
        free, n_won = attempt(x, y, h, 0, j, world, moves, credits)
        if not free:
            continue
        x2, y2, h2, _ = end_of(x, y, h, 0, j, moves)
        i, k = int((x2 - world.x0) / lattice), int((y2 - world.y0) / lattice)
        if not allowed[i, k, h2]:
            continue
        for c in range(n_won):
            ci, ck, b = credits[c] // (n_phi * ny), (credits[c] // n_phi) % ny, credits[c] % n_phi
            world.missing[ci, ck] -= world.need[ci, ck, b]
            world.need[ci, ck, b] = False
        is_end = to_first and n_won > 0
        if is_end or not met[i, k, h2]:
            met[i, k, h2] = True
            queue.at[tail, 0], queue.at[tail, 1], queue.hs[tail] = x2, y2, h2
            queue.parents[tail], queue.branches[tail] = head, -1 - j if is_end else j
            tail += 1
    return tail


@kernel
def spread(
    state: Floats, allowed: Bools, met: Bools, depth: int, world: World, moves: Moves, lattice: float
) -> Branches:
    """Flood all that can be reached within `allowed`, or find the way to the first bin from where `depth` branches go on.

    The lattice cells come to are marked in `met`; both (n, n, n_headings). The bins in which some primitive stays long
    enough are taken off what the world wants.

    Returns
    -------
    (n,) the branches to the first bin; none if depth is 0, or no bin was found
    """
    met[:] = False
    queue = queue_for(1 << 16)
    credits = np.empty(CREDITS, np.int64)
    queue.at[0, 0], queue.at[0, 1], queue.hs[0], queue.parents[0] = state[0], state[1], int(state[2]), -1
    head, tail = 0, 1
    met[int((state[0] - world.x0) / lattice), int((state[1] - world.y0) / lattice), queue.hs[0]] = True
    while head < tail:
        if tail + moves.then.shape[1] > len(queue.hs):
            queue = larger(queue)
        new = tail
        tail = _spread_on(head, tail, queue, allowed, met, depth > 0, world, moves, lattice, credits)
        head += 1
        for end in range(new, tail):
            if queue.branches[end] < 0:
                queue.branches[end] = -1 - queue.branches[end]
                x, y, h = queue.at[end, 0], queue.at[end, 1], queue.hs[end]
                if is_safe(x, y, h, 0, depth, world, moves, credits):
                    out = np.empty(end, np.int32)
                    return out[: trace(end, queue.parents, queue.branches, out)].copy()
    return np.empty(0, np.int32)
