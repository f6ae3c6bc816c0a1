"""Compiled kernels of a wavefront over a whole floor: all states that a car can reach, or the path to the first bin.

The reached set R contains the lattice cell of the start state. For each state s in R it contains the cell of
f(s, j), for every clear branch j with its end in `allowed`. Each cell keeps the first state that enters it
(breadth-first search), so every state in R is one that the car can be in.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planners.kernel import inner_kernel, kernel
from planners.search.kernel_world import (
    PrimitiveArrays,
    Scratch,
    SearchWorld,
    end_state,
    find_escape,
    trace_back,
    try_primitive,
)
from planners.types import Bools, Floats, Int32s, Ints


class WavefrontQueue(NamedTuple):
    """The states that the wavefront has reached, in order of arrival."""

    at: Floats
    """(n, 2) [m] places; `hs` (n,) heading steps, `parents` (n,), `branches` (n,)."""
    hs: Int32s
    parents: Int32s
    branches: Int32s


@kernel
def new_queue(n: int) -> WavefrontQueue:
    """Return memory for n states."""
    return WavefrontQueue(
        np.empty((n, 2)), np.empty(n, np.int32), np.empty(n, np.int32), np.empty(n, np.int32)
    )


@kernel
def doubled(queue: WavefrontQueue) -> WavefrontQueue:
    """Return the queue with twice its capacity."""
    n = len(queue.hs)
    more = new_queue(2 * n)
    for k in range(n):
        more.at[k, 0], more.at[k, 1], more.hs[k] = queue.at[k, 0], queue.at[k, 1], queue.hs[k]
        more.parents[k], more.branches[k] = queue.parents[k], queue.branches[k]
    return more


@inner_kernel
def _expand_wavefront(
    head: int,
    tail: int,
    queue: WavefrontQueue,
    allowed: Bools,
    reached: Bools,
    to_first: bool,
    world: SearchWorld,
    primitives: PrimitiveArrays,
    lattice: float,
    covered: Ints,
) -> int:
    """Queue the successors of state `head`; return the new end of the queue.

    Parameters
    ----------
    to_first : Whether to look for the first bin: branches that cover a bin are then stored as -1 - branch.
    """
    ny, n_phi = world.need.shape[1], world.need.shape[2]
    x, y, h = queue.at[head, 0], queue.at[head, 1], queue.hs[head]
    for j in range(primitives.next_mode.shape[1]):
        free, n_covered = try_primitive(x, y, h, 0, j, world, primitives, covered)
        if not free:
            continue
        x2, y2, h2, _ = end_state(x, y, h, 0, j, primitives)
        i, k = int((x2 - world.x0) / lattice), int((y2 - world.y0) / lattice)
        if not allowed[i, k, h2]:
            continue
        for c in range(n_covered):
            ci, ck, b = covered[c] // (n_phi * ny), (covered[c] // n_phi) % ny, covered[c] % n_phi
            world.missing[ci, ck] -= world.need[ci, ck, b]
            world.need[ci, ck, b] = False
        is_end = to_first and n_covered > 0
        if is_end or not reached[i, k, h2]:
            reached[i, k, h2] = True
            queue.at[tail, 0], queue.at[tail, 1], queue.hs[tail] = x2, y2, h2
            queue.parents[tail], queue.branches[tail] = head, -1 - j if is_end else j
            tail += 1
    return tail


@kernel
def wavefront(
    state: Floats,
    allowed: Bools,
    reached: Bools,
    depth: int,
    world: SearchWorld,
    primitives: PrimitiveArrays,
    lattice: float,
    scratch: Scratch,
) -> Int32s:
    """Visit all states reachable within `allowed`, or stop at the first bin; breadth first over the primitives.

    Bins in which a primitive stays long enough are removed from those that the world needs.

    Parameters
    ----------
    state : (4,) Start state.
    allowed : (n, n, n_headings) Lattice cells that may be entered.
    reached : (n, n, n_headings) Filled with the lattice cells that are entered.
    depth : 0: visit all states. Otherwise: stop at the first bin from which this many branches can follow.
    lattice : [m] Side of a lattice cell.

    Returns
    -------
    The branches (n,) to the first bin; empty if depth is 0, or if no bin is found.
    """
    reached[:] = False
    queue = new_queue(1 << 16)
    queue.at[0, 0], queue.at[0, 1], queue.hs[0], queue.parents[0] = state[0], state[1], int(state[2]), -1
    head, tail = 0, 1
    reached[int((state[0] - world.x0) / lattice), int((state[1] - world.y0) / lattice), queue.hs[0]] = True
    while head < tail:
        if tail + primitives.next_mode.shape[1] > len(queue.hs):
            queue = doubled(queue)
        new = tail
        tail = _expand_wavefront(
            head, tail, queue, allowed, reached, depth > 0, world, primitives, lattice, scratch.covered
        )
        head += 1
        for end in range(new, tail):
            if queue.branches[end] < 0:
                queue.branches[end] = -1 - queue.branches[end]
                x, y, h = queue.at[end, 0], queue.at[end, 1], queue.hs[end]
                if find_escape(x, y, int(h), 0, depth, world, primitives, scratch) >= 0:
                    out = np.empty(end, np.int32)
                    return out[: trace_back(end, queue.parents, queue.branches, out)].copy()
    return np.empty(0, np.int32)
