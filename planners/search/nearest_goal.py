"""Path to the nearest missing bin, by compiled kernels: breadth-first search in time over the motion primitives.

State and branches are those of `beam`. With arrival time t(f(s, j)) = t(s) + cost[m, j], the states are
expanded in order of t, from a ring of max_cost + 1 buckets (Dial's algorithm). Each lattice cell is visited
once, so t is the shortest time at the resolution of the lattice. If a bucket holds more than `width`
states, only the `width` nearest to a missing bin are expanded; the search is then incomplete. The first bucket that
holds a safe state whose last branch covers a bin ends the search.
"""

from __future__ import annotations

from planners.array_kernels import make_heap, pop_least
from planners.kernel import inner_kernel, outer_kernel
from planners.search.heuristic import HeuristicBuffers, time_to_goal, update_heuristic
from planners.search.kernel_goals import cell_distance, is_safe
from planners.search.kernel_world import (
    end_state,
    find_slot,
    lattice_key,
    trace_back,
    try_primitive,
    wide,
)
from planners.search.workspace import GOAL_CAPACITY, GOAL_HORIZON, GOAL_MAX_STATES, SearchTables
from planners.types import Floats


@inner_kernel
def _expand_nearest(
    node: int, layer: int, n_nodes: int, capacity: int, tables: SearchTables
) -> tuple[int, bool]:
    """Add the children of a state to the pools of their layers.

    Returns
    -------
    The number of states, -1 if there are too many; and whether a child was dropped because its layer is full.
    """
    _, world, primitives, workspace = tables
    at, fill, ring = workspace.places, workspace.pool_sizes, primitives.max_cost + 1
    x, y, h, m = at[node, 0], at[node, 1], wide(workspace.headings[node]), wide(workspace.modes[node])
    was_full = False
    for j in range(primitives.next_mode.shape[1]):
        if primitives.next_mode[m, j] < 0:
            continue
        free, n_covered = try_primitive(x, y, h, m, j, world, primitives, workspace.scratch.covered)
        if not free:
            continue
        x2, y2, h2, m2 = end_state(x, y, h, m, j, primitives)
        key = 2 * lattice_key(x2, y2, h2, m2, world, primitives) + (n_covered > 0)
        if (
            find_slot(
                workspace.hash_keys, len(workspace.hash_keys), workspace.stamp[0], workspace.hash_stamps, key
            )
            >= 0
        ):
            continue
        later = (layer + primitives.cost[m, j]) % ring
        if n_nodes >= GOAL_MAX_STATES:
            return -1, was_full
        if fill[later] >= capacity:
            was_full = True
            continue
        at[n_nodes, 0], at[n_nodes, 1], workspace.headings[n_nodes], workspace.modes[n_nodes] = x2, y2, h2, m2
        workspace.parents[n_nodes], workspace.branches[n_nodes], workspace.n_covered[n_nodes] = (
            node,
            j,
            n_covered,
        )
        workspace.pool[later, fill[later]] = n_nodes
        fill[later] += 1
        n_nodes += 1
    return n_nodes, was_full


@outer_kernel
def nearest_goal_search(
    state: Floats, tables: SearchTables, width: int, is_guided: bool, heuristic: HeuristicBuffers
) -> int:
    """Search breadth first for the nearest missing bin; write the branches to `workspace.sequence`.

    Each lattice state is visited once, and once more by a primitive that covers a bin. Of each unit of time,
    the `width` states nearest to a missing bin are expanded: by the cost-to-go map if `is_guided`, else by
    the number of cells.

    Returns
    -------
    The number of branches; 0: no bin can be reached at this resolution; -1: the search gave up.
    """
    _, world, primitives, workspace = tables
    at, hs, ms, gains = workspace.places, workspace.headings, workspace.modes, workspace.n_covered
    ring, capacity = primitives.max_cost + 1, width * GOAL_CAPACITY
    pool, fill, away = workspace.pool, workspace.pool_sizes, workspace.costs
    fill[:] = 0
    workspace.stamp[0] += 1
    at[0, 0], at[0, 1], hs[0], ms[0] = state[0], state[1], int(state[2]), int(state[3])
    workspace.parents[0], gains[0], pool[0, 0], fill[0] = -1, 0, 0, 1
    n_nodes, is_cut, waiting = fill[0], False, fill[0]
    for layer in range(GOAL_HORIZON):
        row = layer % ring
        here = fill[row]
        if waiting == 0:
            return -1 if is_cut else 0
        top, chosen = 0, pool[row, 0]
        for o in range(here):
            node = pool[row, o]
            if gains[node] > top and is_safe(
                at[node, 0], at[node, 1], wide(hs[node]), wide(ms[node]), tables
            ):
                top, chosen = gains[node], node
        if top > 0:
            return trace_back(wide(chosen), workspace.parents, workspace.branches, workspace.sequence)
        for o in range(here):
            node = pool[row, o]
            if is_guided:
                away[o] = time_to_goal(
                    at[node, 0], at[node, 1], wide(hs[node]), wide(ms[node]), world, heuristic
                )
            else:
                away[o] = cell_distance(at[node, 0], at[node, 1], world, workspace.far)
        is_cut = is_cut or here > width
        make_heap(workspace.heap, here, away)
        for popped in range(min(here, width)):
            node = pool[row, pop_least(workspace.heap, here - popped, away)]
            before = n_nodes
            n_nodes, was_full = _expand_nearest(node, layer, n_nodes, capacity, tables)
            is_cut = is_cut or was_full
            if n_nodes < 0:
                return -1
            waiting += n_nodes - before
        waiting -= here
        fill[row] = 0
    return -1


def find_nearest_goal(state: Floats, tables: SearchTables, heuristic: HeuristicBuffers) -> int:
    """Search for the nearest missing bin, first guided by the cost-to-go map if the settings request it, then widely.

    The branches are written to `workspace.sequence`. The result is that of `nearest_goal_search`.
    """
    settings = tables.settings
    if settings.guided_width > 0:
        update_heuristic(state, tables.world, heuristic)
        found = nearest_goal_search(state, tables, settings.guided_width, True, heuristic)
        if found > 0:
            return found
    return nearest_goal_search(state, tables, settings.goal_width, False, heuristic)
