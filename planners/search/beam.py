"""Compiled kernels of the receding-horizon search: `beam_search` looks ahead, `advance` decides and drives.

Where the beam wins too little, `nearest_goal` finds the way to the nearest missing bin.
"""

from __future__ import annotations

import numpy as np

from planners.kernel import inner_kernel, kernel
from planners.search.kernel_goals import cell_distance, cell_distances, is_safe_cached, smallest_first
from planners.search.kernel_world import (
    MAX_BINS_PER_PRIMITIVE,
    PrimitiveArrays,
    SearchWorld,
    apply_primitive,
    end_state,
    find_slot,
    lattice_key,
    trace_back,
    try_primitive,
)
from planners.search.nearest_goal import find_nearest_goal
from planners.search.settings import KERNELS
from planners.search.workspace import BeamSettings, HeuristicBuffers, Workspace, beam_room
from planners.types import Floats, Int32s, Ints

MAX_PATH_PRIMITIVES = KERNELS.max_path_primitives
N_DRIVEN, N_LEFT, N_GOAL_SEARCHES, STATUS = range(4)
"""Entries of `counters`: primitives written to the sequence, bins left, searches for the nearest bin, status."""
RUNNING, DONE, UNREACHABLE, GAVE_UP = range(4)
"""Values of the status; `search.SearchStatus` explains them."""


@inner_kernel
def _expand(
    node: int,
    layer: int,
    n_nodes: int,
    room: int,
    settings: BeamSettings,
    world: SearchWorld,
    primitives: PrimitiveArrays,
    far: Ints,
    workspace: Workspace,
    covered: Ints,
) -> int:
    """Add the children of a node to the pools of their layers, at most `room` a layer; return the count of nodes."""
    at, bins, fill = workspace.places, workspace.covered, workspace.pool_sizes
    x, y, h, m = at[node, 0], at[node, 1], workspace.headings[node], workspace.modes[node]
    ny, n_phi = world.need.shape[1], world.need.shape[2]
    for j in range(primitives.next_mode.shape[1]):
        if primitives.next_mode[m, j] < 0 or primitives.is_fine[m, j]:
            continue
        later = layer + primitives.cost[m, j]
        if fill[later] >= room or n_nodes >= len(at):
            continue
        free, n_covered = try_primitive(x, y, h, m, j, world, primitives, covered)
        if not free:
            continue
        gain, count = 0.0, 0
        for c in range(n_covered):
            if _is_covered(node, covered[c], workspace.parents, workspace.n_covered, bins):
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
        workspace.scores[n_nodes] = workspace.scores[node] + gain * (1.0 - settings.discount * layer)
        if later >= settings.horizon:
            away = min(cell_distance(at[n_nodes, 0], at[n_nodes, 1], world, far), 1000)
            workspace.scores[n_nodes] -= settings.goal_pull * away + settings.overtime * (
                later - settings.horizon
            )
        workspace.pool[later, fill[later]] = n_nodes
        fill[later] += 1
        n_nodes += 1
    return n_nodes


@kernel
def beam_search(
    state: Floats,
    settings: BeamSettings,
    world: SearchWorld,
    primitives: PrimitiveArrays,
    far: Ints,
    workspace: Workspace,
    out: Int32s,
) -> tuple[int, int]:
    """Search `settings.horizon` units of time ahead with a beam.

    Children wait in a pool for each unit of time. Of each pool the `settings.width` best that differ are expanded.
    Of the sequences that reach the horizon, the best with a safe end is written to `out`.

    Returns
    -------
    count of branches written, and of bins that they cover; 0, 0 where no end is safe
    """
    horizon = settings.horizon
    layers = horizon + primitives.cost.max()
    room = beam_room(settings.width, primitives.next_mode.shape[1])
    at, scores, hs, ms = workspace.places, workspace.scores, workspace.headings, workspace.modes
    pool, fill = workspace.pool, workspace.pool_sizes
    fill[:] = 0
    covered = np.empty(MAX_BINS_PER_PRIMITIVE, np.int64)
    at[0, 0], at[0, 1], hs[0], ms[0] = state[0], state[1], int(state[2]), int(state[3])
    scores[0], workspace.parents[0], workspace.n_covered[0], workspace.total_covered[0] = 0.0, -1, 0, 0
    pool[0, 0], fill[0] = 0, 1
    n_nodes = 1
    for layer in range(horizon):
        workspace.stamp[0] += 1
        order = smallest_first(-scores[pool[layer, : fill[layer]]], 3 * settings.width)
        kept = 0
        for o in order:
            node = pool[layer, o]
            key = lattice_key(
                at[node, 0], at[node, 1], hs[node], ms[node], world, primitives, settings.lattice
            )
            if find_slot(workspace.hash_keys, workspace.stamp[0], workspace.hash_stamps, key) >= 0:
                continue  # a better one is there
            kept += 1
            if kept > settings.width:
                break
            n_nodes = _expand(
                node, layer, n_nodes, room, settings, world, primitives, far, workspace, covered
            )
    leaves = np.empty(fill[horizon:].sum(), np.int32)
    n_leaves = 0
    for layer in range(horizon, layers + 1):
        leaves[n_leaves : n_leaves + fill[layer]] = pool[layer, : fill[layer]]
        n_leaves += fill[layer]
    for o in np.argsort(-scores[leaves], kind="mergesort"):
        node = leaves[o]
        if is_safe_cached(at[node, 0], at[node, 1], hs[node], ms[node], settings, world, primitives, covered):
            return trace_back(node, workspace.parents, workspace.branches, out), workspace.total_covered[node]
    return 0, 0


@inner_kernel
def _is_covered(node: int, bin_: int, parents: Int32s, counts: Int32s, bins: Ints) -> bool:
    """Tell whether a bin was covered on the way to a node."""
    while node > 0:
        for d in range(counts[node]):
            if bins[node, d] == bin_:
                return True
        node = parents[node]
    return False


@kernel
def advance(
    state: Floats,
    decisions: int,
    settings: BeamSettings,
    world: SearchWorld,
    primitives: PrimitiveArrays,
    heuristic: HeuristicBuffers,
    workspace: Workspace,
    sequence: Int32s,
    counters: Ints,
) -> None:
    """Make up to `decisions` decisions, drive them, and write the branches driven to `sequence`.

    counters : (4,) see N_DRIVEN; updated
    """
    far, queue = np.empty(world.missing.shape, np.int64), np.empty(world.missing.size, np.int64)
    out, way = np.empty(MAX_PATH_PRIMITIVES, np.int32), np.empty(MAX_PATH_PRIMITIVES, np.int32)
    covered = np.empty(MAX_BINS_PER_PRIMITIVE, np.int64)
    for _ in range(decisions):
        if counters[N_LEFT] == 0:
            counters[STATUS] = DONE
            return
        cell_distances(world, far, queue)
        n, n_new = beam_search(state, settings, world, primitives, far, workspace, out)
        units = settings.executed
        if n_new < min(settings.min_bins, counters[N_LEFT]):
            counters[N_GOAL_SEARCHES] += 1
            found = find_nearest_goal(state, settings, world, primitives, far, heuristic, workspace, way)
            if found > 0:
                n, units = found, MAX_PATH_PRIMITIVES
                out[:n] = way[:n]
            elif n_new == 0:
                counters[STATUS] = UNREACHABLE if found == 0 else GAVE_UP
                return
        driven = 0
        for k in range(n):
            if counters[N_LEFT] == 0:
                if settings.safe_depth >= 0 or state[3] == 0:
                    break
            elif driven >= units:
                break
            driven += primitives.cost[int(state[3]), out[k]]
            counters[N_LEFT] -= apply_primitive(state, out[k], world, primitives, covered)
            sequence[counters[N_DRIVEN]] = out[k]
            counters[N_DRIVEN] += 1
