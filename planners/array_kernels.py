"""Array operations of compiled kernels: a binary heap that yields indices by cost, bisection, and ranges of a mask.

`np.argsort`, `np.searchsorted` and slices take up to seconds to compile, because numba compiles their error messages too. These
kernels take a tenth of that. A heap also runs faster when only the first entries of the order are needed.
Heap property: costs[heap[i]] ≤ costs[heap[2 i + 1]] and ≤ costs[heap[2 i + 2]] (bottom-up heapsort, I. Wegener,
Theoretical Computer Science 118, 1993).
"""

from __future__ import annotations

from planners.kernel import inner_kernel
from planners.types import Bools, Floats, Ints


@inner_kernel
def make_heap(heap: Ints, size: int, costs: Floats) -> None:
    """Fill `heap[:size]` with the indices of `costs[:size]`; `pop_least` then returns them in ascending order."""
    for o in range(size):
        heap[o] = o
    for top in range(size // 2 - 1, -1, -1):
        _sift_down(heap, top, size, costs)


@inner_kernel
def pop_least(heap: Ints, size: int, costs: Floats) -> int:
    """Remove the index of the lowest cost from a heap of `size` entries and return it; ties: lowest index first."""
    least, moved, size = heap[0], heap[size - 1], size - 1
    hole, child = 0, 1
    while child + 1 < size:  # sink the hole to a leaf: its new entry comes from a leaf and rarely rises far
        a, b = heap[child], heap[child + 1]
        child += (costs[b] < costs[a]) | ((costs[b] == costs[a]) & (b < a))
        heap[hole] = heap[child]
        hole, child = child, 2 * child + 1
    if child < size:
        heap[hole] = heap[child]
        hole = child
    cost = costs[moved]
    while hole > 0:
        above = (hole - 1) >> 1
        a = heap[above]
        if costs[a] < cost or (costs[a] == cost and a < moved):
            break
        heap[hole] = a
        hole = above
    heap[hole] = moved
    return int(least)


@inner_kernel
def _sift_down(heap: Ints, top: int, size: int, costs: Floats) -> None:
    """Move the entry at `top` down until it comes before both of its children."""
    moved, hole = heap[top], top
    cost = costs[moved]
    while 2 * hole + 1 < size:
        child = 2 * hole + 1
        a = heap[child]
        if child + 1 < size:
            b = heap[child + 1]
            if costs[b] < costs[a] or (costs[b] == costs[a] and b < a):
                child, a = child + 1, b
        if cost < costs[a] or (cost == costs[a] and moved < a):
            break
        heap[hole] = a
        hole = child
    heap[hole] = moved


@inner_kernel
def last_up_to(values: Floats, most: float) -> int:
    """Return the index of the last of some ascending values that is at most `most`; 0 if none is (bisection)."""
    at, beyond = 0, len(values)
    while beyond - at > 1:
        middle = (at + beyond) // 2
        if values[middle] <= most:
            at = middle
        else:
            beyond = middle
    return at


@inner_kernel
def is_any(mask: Bools, first: int, last: int) -> bool:
    """Return whether any of mask[first] ... mask[last] is set."""
    found = False
    for k in range(first, last + 1):
        found |= mask[k]
    return found


@inner_kernel
def set_all(mask: Bools, first: int, last: int) -> None:
    """Set mask[first] ... mask[last]."""
    for k in range(first, last + 1):
        mask[k] = True
