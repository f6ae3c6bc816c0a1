"""Compiled kernels of the receding-horizon search: `beam_search` looks ahead, `drive` executes the first part.

State: place (x, y) [m], heading step h, mode m (speed level or gear). Branch j of mode m leads to the state
f(s, j) of `kernel_world.end_state` after cost[m, j] units of time. It is allowed if its samples keep the
clearance.

Score. A node n' is the end of branch j from a node n at time t(n), so t(n') = t(n) + cost[m, j]. Its score is:

    score(n') = score(n) + (1 - DISCOUNT t(n) / horizon) Σ value[c] (1 + completion_weight (1 - missing[c] / n_phi)).

The sum is over the bins that the branch covers and that the path to n has not covered; c is the cell of each
bin. A node at or beyond the horizon, t(n') ≥ horizon, has a penalty:

    GOAL_PULL min(far[c], 1000) + OVERTIME (t(n') - horizon).

Here far[c] is the number of cell borders to the nearest cell with a missing bin, and `horizon` the units of
time of a full turn. With a longer horizon the search postpones near bins.

Beam. For each t = 0 ... horizon - 1, the `beam_width` nodes of highest score with different lattice keys are
expanded, among the best 3 beam_width nodes and ties. Of the nodes at or beyond the horizon, the result is the one
of highest score whose end is safe: the robot can go on or stop.
"""

from __future__ import annotations

from planners.array_kernels import make_heap, pop_least
from planners.kernel import inlined_kernel, inner_kernel, outer_kernel
from planners.search.kernel_goals import cell_distance, is_safe
from planners.search.kernel_world import (
    apply_primitive,
    end_state,
    find_slot,
    lattice_key,
    trace_back,
    try_primitive,
    wide,
)
from planners.search.workspace import SearchTables, beam_capacity_kernel
from planners.types import Floats, Int32s, Ints

DISCOUNT = 0.19
"""Share of a bin's value that is lost over the whole horizon."""
GOAL_PULL = 0.5
"""Value of ending one cell nearer to the nearest missing bin."""
OVERTIME = 0.25
"""Value of ending one unit of time earlier, among sequences that exceed the horizon."""


@inlined_kernel
def _expand(node: int, layer: int, n_nodes: int, capacity: int, tables: SearchTables) -> int:
    """Add the children of a node to the pools of their layers, up to `capacity` each; return the number of nodes."""
    settings, world, primitives, workspace = tables
    at, bins, fill = workspace.places, workspace.covered, workspace.pool_sizes
    covered = workspace.scratch.covered
    x, y, h, m = at[node, 0], at[node, 1], wide(workspace.headings[node]), wide(workspace.modes[node])
    ny, n_phi, horizon = world.need.shape[1], world.need.shape[2], len(primitives.offsets)
    can_repeat = primitives.omega == 0.0 or horizon > n_phi  # else each bin has one primitive per turn
    for j in range(primitives.next_mode.shape[1]):
        if primitives.next_mode[m, j] < 0 or primitives.is_fine[m, j]:
            continue
        later = layer + primitives.cost[m, j]
        if fill[later] >= capacity or n_nodes >= len(at):
            continue
        free, n_covered = try_primitive(x, y, h, m, j, world, primitives, covered)
        if not free:
            continue
        gain, count = 0.0, 0
        for c in range(n_covered):
            if can_repeat and _is_covered(node, covered[c], workspace.parents, workspace.n_covered, bins):
                continue
            ci, ck = covered[c] // (n_phi * ny), (covered[c] // n_phi) % ny
            gain += world.value[ci, ck] * (
                1.0 + settings.completion_weight * (1.0 - world.missing[ci, ck] / n_phi)
            )
            bins[n_nodes, count] = covered[c]
            count += 1
        at[n_nodes, 0], at[n_nodes, 1], workspace.headings[n_nodes], workspace.modes[n_nodes] = end_state(
            x, y, h, m, j, primitives
        )
        workspace.parents[n_nodes], workspace.branches[n_nodes], workspace.n_covered[n_nodes] = node, j, count
        workspace.total_covered[n_nodes] = workspace.total_covered[node] + count
        workspace.scores[n_nodes] = workspace.scores[node] + gain * (1.0 - DISCOUNT / horizon * layer)
        if later >= horizon:
            away = min(cell_distance(at[n_nodes, 0], at[n_nodes, 1], world, workspace.far), 1000)
            workspace.scores[n_nodes] -= GOAL_PULL * away + OVERTIME * (later - horizon)
        workspace.pool[later, fill[later]] = n_nodes
        fill[later] += 1
        n_nodes += 1
    return n_nodes


@outer_kernel
def beam_search(state: Floats, tables: SearchTables) -> tuple[int, int]:
    """Search one full turn ahead with a beam; see the module docstring for score and beam.

    The branches of the best sequence with a safe end are written to `workspace.sequence`.

    Returns
    -------
    The number of branches, and the number of bins that they cover; 0, 0 if no end is safe.
    """
    settings, world, primitives, workspace = tables
    horizon, most = len(primitives.offsets), 3 * settings.beam_width
    capacity = beam_capacity_kernel(settings.beam_width, primitives.next_mode.shape[1])
    at, scores, hs, ms = workspace.places, workspace.scores, workspace.headings, workspace.modes
    pool, fill, costs = workspace.pool, workspace.pool_sizes, workspace.costs
    slots = 4
    while slots < 2 * settings.beam_width + 2:
        slots *= 2
    fill[:] = 0
    at[0, 0], at[0, 1], hs[0], ms[0] = state[0], state[1], int(state[2]), int(state[3])
    scores[0], workspace.parents[0], workspace.n_covered[0], workspace.total_covered[0] = 0.0, -1, 0, 0
    pool[0, 0], fill[0] = 0, 1
    n_nodes = fill[0]
    for layer in range(horizon):
        workspace.stamp[0] += 1
        for o in range(fill[layer]):
            costs[o] = -scores[pool[layer, o]]
        make_heap(workspace.heap, fill[layer], costs)
        kept, bound = 0, 0.0
        for popped in range(fill[layer]):
            o = pop_least(workspace.heap, fill[layer] - popped, costs)
            if popped == most:
                bound = costs[o]
            elif popped > most and costs[o] > bound:
                break
            node = pool[layer, o]
            key = lattice_key(at[node, 0], at[node, 1], wide(hs[node]), wide(ms[node]), world, primitives)
            if find_slot(workspace.hash_keys, slots, workspace.stamp[0], workspace.hash_stamps, key) >= 0:
                continue  # a better node has the same key
            kept += 1
            if kept > settings.beam_width:
                break
            n_nodes = _expand(node, layer, n_nodes, capacity, tables)
    n_leaves = 0
    for layer in range(horizon, horizon + primitives.max_cost + 1):
        for o in range(fill[layer]):
            workspace.leaves[n_leaves] = pool[layer, o]
            costs[n_leaves] = -scores[pool[layer, o]]
            n_leaves += 1
    make_heap(workspace.heap, n_leaves, costs)
    for popped in range(n_leaves):
        node = workspace.leaves[pop_least(workspace.heap, n_leaves - popped, costs)]
        if is_safe(at[node, 0], at[node, 1], wide(hs[node]), wide(ms[node]), tables):
            n = trace_back(wide(node), workspace.parents, workspace.branches, workspace.sequence)
            return n, workspace.total_covered[node]
    return 0, 0


@inner_kernel
def _is_covered(node: int, bin_: int, parents: Int32s, counts: Int32s, bins: Ints) -> bool:
    """Return whether a bin is covered on the path to a node."""
    while node > 0:
        for d in range(counts[node]):
            if bins[node, d] == bin_:
                return True
        node = parents[node]
    return False


@outer_kernel
def drive(state: Floats, n: int, units: int, left: int, tables: SearchTables) -> tuple[int, int]:
    """Execute the first of `n` branches in `workspace.sequence`, for `units` of time or until no bin is missing.

    If no bin is missing, a robot that must be able to stop drives on until it is at rest.

    Returns
    -------
    The number of executed branches, and the number of bins `left`.
    """
    _, world, primitives, workspace = tables
    spent, sequence = 0, workspace.sequence
    for k in range(n):
        if left == 0:
            if primitives.safe_depth >= 0 or state[3] == 0:
                return k, left
        elif spent >= units:
            return k, left
        spent += primitives.cost[int(state[3]), sequence[k]]
        left -= apply_primitive(state, wide(sequence[k]), world, primitives, workspace.scratch.covered)
    return n, left
