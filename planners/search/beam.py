"""Compiled kernels of the search ahead: harvest with a beam, flood to the next bin where that wins little, advance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planners.kernel import inner_kernel, kernel
from planners.search.heuristic import FARTHEST, Lattice, Units, wave
from planners.search.kernel_world import (
    CREDITS,
    Branches,
    Moves,
    World,
    attempt,
    drive,
    end_of,
    find_slot,
    is_safe,
    lattice_key,
    trace,
)
from planners.types import Floats, Ints

OVERTIME = 0.25
"""Value of a unit of time that one drive ends before another."""
LONGEST_FLOOD = 2048
"""Primitives in a row, at most."""


class Hunt(NamedTuple):
    """How hard to think; see `search.Settings`."""

    horizon: int
    executed: int
    width: int
    safe_depth: int
    least: int
    flood_layers: int
    flood_width: int
    flood_states: int
    discount: float
    pull: float
    eagerness: float
    lattice: float
    narrow: int
    """States that a flood with an outlook keeps of each unit, before one without; 0: no outlook."""


class Outlook(NamedTuple):
    """The lattice of the guide, and what is written there."""

    grid: Lattice
    value: Units
    """(side * side * n_classes * n_gears,)"""
    queue: Branches
    following: Branches
    heads: Branches
    corner: Ints
    """(2,) lattice point of the window's (0, 0)."""


class Desk(NamedTuple):
    """Room to write in, used again and again."""

    at: Floats
    """(most, 2)"""
    scores: Floats
    """(most,)"""
    hs: Branches
    ms: Branches
    totals: Branches
    parents: Branches
    branches: Branches
    won: Branches
    wins: Ints
    """(most, CREDITS)"""
    pool: Branches
    """(layers, room) nodes that wait for each unit of time."""
    fill: Ints
    """(layers,)"""
    keys: Ints
    marks: Ints
    """Hash table, and the stamp of each entry."""
    stamp: Ints
    """(1,) the last stamp."""


def desk(hunt: Hunt, moves: Moves) -> Desk:
    """Return room for what a hunt writes."""
    n_branches, slowest = moves.then.shape[1], int(moves.cost.max())
    layers = hunt.horizon + slowest + 1
    room = max(hunt.width * n_branches * (2 if n_branches > 3 else 1), hunt.flood_width * 8)
    most = max(hunt.flood_states, layers * hunt.width * n_branches * (2 if n_branches > 3 else 1))
    slots = 1 << int(np.ceil(np.log2(2 * most)))
    whole = np.empty((6, most), dtype=np.int32)
    return Desk(
        at=np.empty((most, 2)),
        scores=np.empty(most),
        hs=whole[0],
        ms=whole[1],
        totals=whole[2],
        parents=whole[3],
        branches=whole[4],
        won=whole[5],
        wins=np.empty((most, CREDITS), dtype=np.int64),
        pool=np.empty((layers, room), dtype=np.int32),
        fill=np.zeros(layers, dtype=np.int64),
        keys=np.empty(slots, dtype=np.int64),
        marks=np.zeros(slots, dtype=np.int64),
        stamp=np.zeros(1, dtype=np.int64),
    )


@inner_kernel
def potential(world: World, far: Ints, queue: Ints) -> None:
    """Fill `far (nx, ny)` with the count of cell borders to the nearest cell where something is missing."""
    missing, links = world.missing, world.links
    nx, ny = missing.shape
    head, tail = 0, 0
    for i in range(nx):
        for k in range(ny):
            far[i, k] = 0 if missing[i, k] > 0 else 1 << 20
            if missing[i, k] > 0:
                queue[tail] = i * ny + k
                tail += 1
    while head < tail:
        i, k = queue[head] // ny, queue[head] % ny
        head += 1
        for d in range(8):
            if links[i, k] & (1 << d):
                ni = i + (1, -1, 0, 0, 1, 1, -1, -1)[d]
                nk = k + (0, 0, 1, -1, 1, -1, 1, -1)[d]
                if far[ni, nk] > far[i, k] + 1:
                    far[ni, nk] = far[i, k] + 1
                    queue[tail] = ni * ny + nk
                    tail += 1


@kernel
def goes_on(
    x: float, y: float, h: int, m: int, hunt: Hunt, world: World, moves: Moves, credits: Ints
) -> bool:
    """Tell whether an end is safe; where it is not, remember it: in a pocket that takes thousands of tries."""
    if world.trapped.size == 1:
        return is_safe(x, y, h, m, hunt.safe_depth, world, moves, credits)
    i, k = int((x - world.x0) / hunt.lattice), int((y - world.y0) / hunt.lattice)
    if world.trapped[i, k, h]:
        return False
    world.trapped[i, k, h] = not is_safe(x, y, h, m, hunt.safe_depth, world, moves, credits)
    return not world.trapped[i, k, h]


@inner_kernel
def cells_away(x: float, y: float, world: World, far: Ints) -> int:
    """Return how many cell borders lie before something missing."""
    return int(far[int((x - world.x0) / world.cell), int((y - world.y0) / world.cell)])


@inner_kernel
def look(state: Floats, world: World, ahead: Outlook) -> None:
    """Tell how far what is missing is from the poses round a state."""
    i0, k0 = wave(
        state[0] - world.x0,
        state[1] - world.y0,
        world.need,
        world.missing,
        ahead.grid,
        ahead.value,
        int(state[2]) // ahead.grid.group,
        int(state[3]),
        ahead.queue,
        ahead.following,
        ahead.heads,
    )
    ahead.corner[0], ahead.corner[1] = i0, k0


@inner_kernel
def units_away(x: float, y: float, h: int, m: int, world: World, ahead: Outlook) -> int:
    """Return how many units of time lie before something missing; FARTHEST where that was not seen."""
    i = int((x - world.x0) / ahead.grid.fine) - ahead.corner[0]
    k = int((y - world.y0) / ahead.grid.fine) - ahead.corner[1]
    if i < 0 or k < 0 or i >= ahead.grid.side or k >= ahead.grid.side:
        return FARTHEST
    pose = (i * ahead.grid.side + k) * len(ahead.grid.bins) + h // ahead.grid.group
    away = int(ahead.value[pose * ahead.grid.n_gears + m])
    return away if away >= 0 else FARTHEST


@kernel
def best_of(costs: Floats, most: int) -> Ints:
    """Return the places of the least of some costs (n,), about so `most`, in order."""
    if len(costs) <= most:
        return np.argsort(costs, kind="mergesort")
    few = np.flatnonzero(costs <= np.partition(costs, most)[most])
    return few[np.argsort(costs[few], kind="mergesort")]


@inner_kernel
def _grow(
    node: int,
    layer: int,
    n_nodes: int,
    room: int,
    hunt: Hunt,
    world: World,
    moves: Moves,
    far: Ints,
    desk: Desk,
    credits: Ints,
) -> int:
    """Add the children of a node of the beam to those that wait, at most `room` of a layer; return the count of nodes."""
    at, wins, fill = desk.at, desk.wins, desk.fill
    x, y, h, m = at[node, 0], at[node, 1], desk.hs[node], desk.ms[node]
    ny, n_phi = world.need.shape[1], world.need.shape[2]
    for j in range(moves.then.shape[1]):
        if moves.then[m, j] < 0 or moves.patient[m, j]:
            continue
        later = layer + moves.cost[m, j]
        if fill[later] >= room or n_nodes >= len(at):
            continue
        free, n_won = attempt(x, y, h, m, j, world, moves, credits)
        if not free:
            continue
        gain, count = 0.0, 0
        for c in range(n_won):
            if _has_won(node, credits[c], desk.parents, desk.won, wins):
                continue
            ci, ck = credits[c] // (n_phi * ny), (credits[c] // n_phi) % ny
            gain += world.value[ci, ck] * (1.0 + hunt.eagerness * (1.0 - world.missing[ci, ck] / n_phi))
            wins[n_nodes, count] = credits[c]
            count += 1
        at[n_nodes, 0], at[n_nodes, 1], desk.hs[n_nodes], desk.ms[n_nodes] = end_of(x, y, h, m, j, moves)
        desk.parents[n_nodes], desk.branches[n_nodes], desk.won[n_nodes] = node, j, count
        desk.totals[n_nodes] = desk.totals[node] + count
        desk.scores[n_nodes] = desk.scores[node] + gain * (1.0 - hunt.discount * layer)
        if later >= hunt.horizon:
            away = min(cells_away(at[n_nodes, 0], at[n_nodes, 1], world, far), 1000)
            desk.scores[n_nodes] -= hunt.pull * away + OVERTIME * (later - hunt.horizon)
        desk.pool[later, fill[later]] = n_nodes
        fill[later] += 1
        n_nodes += 1
    return n_nodes


@kernel
def harvest(
    state: Floats, hunt: Hunt, world: World, moves: Moves, far: Ints, desk: Desk, out: Branches
) -> tuple[int, int]:
    """Search `hunt.horizon` units ahead with a beam; write branches to `out`; return their count and the bins won.

    Children wait in a pool for each unit of time; of each pool the `hunt.width` best that differ go on.
    """
    horizon = hunt.horizon
    layers = horizon + moves.cost.max()
    room = hunt.width * moves.then.shape[1] * (2 if moves.then.shape[1] > 3 else 1)
    at, scores, hs, ms = desk.at, desk.scores, desk.hs, desk.ms
    pool, fill = desk.pool, desk.fill
    fill[:] = 0
    credits = np.empty(CREDITS, np.int64)
    at[0, 0], at[0, 1], hs[0], ms[0] = state[0], state[1], int(state[2]), int(state[3])
    scores[0], desk.parents[0], desk.won[0], desk.totals[0] = 0.0, -1, 0, 0
    pool[0, 0], fill[0] = 0, 1
    n_nodes = 1
    for layer in range(horizon):
        desk.stamp[0] += 1
        order = best_of(-scores[pool[layer, : fill[layer]]], 3 * hunt.width)
        kept = 0
        for o in order:
            node = pool[layer, o]
            key = lattice_key(at[node, 0], at[node, 1], hs[node], ms[node], world, moves, hunt.lattice)
            if find_slot(desk.keys, desk.stamp[0], desk.marks, key) >= 0:
                continue  # a better one is there
            kept += 1
            if kept > hunt.width:
                break
            n_nodes = _grow(node, layer, n_nodes, room, hunt, world, moves, far, desk, credits)
    leaves = np.empty(fill[horizon:].sum(), np.int32)
    n_leaves = 0
    for layer in range(horizon, layers + 1):
        leaves[n_leaves : n_leaves + fill[layer]] = pool[layer, : fill[layer]]
        n_leaves += fill[layer]
    for o in np.argsort(-scores[leaves], kind="mergesort"):
        node = leaves[o]
        if goes_on(at[node, 0], at[node, 1], hs[node], ms[node], hunt, world, moves, credits):
            return trace(node, desk.parents, desk.branches, out), desk.totals[node]
    return 0, 0


@inner_kernel
def _has_won(node: int, credit: int, parents: Branches, won: Branches, wins: Ints) -> bool:
    """Tell whether a bin was won on the way to a node."""
    while node > 0:
        for d in range(won[node]):
            if wins[node, d] == credit:
                return True
        node = parents[node]
    return False


@inner_kernel
def _flow(
    node: int,
    layer: int,
    n_nodes: int,
    room: int,
    hunt: Hunt,
    world: World,
    moves: Moves,
    desk: Desk,
    credits: Ints,
) -> tuple[int, bool]:
    """Add what a state of the flood leads to; return the count of states, -1 if too many, and whether some were left out."""
    at, fill, ring = desk.at, desk.fill, moves.cost.max() + 1
    x, y, h, m = at[node, 0], at[node, 1], desk.hs[node], desk.ms[node]
    was_full = False
    for j in range(moves.then.shape[1]):
        if moves.then[m, j] < 0:
            continue
        free, n_won = attempt(x, y, h, m, j, world, moves, credits)
        if not free:
            continue
        x2, y2, h2, m2 = end_of(x, y, h, m, j, moves)
        key = 2 * lattice_key(x2, y2, h2, m2, world, moves, hunt.lattice) + (n_won > 0)
        if find_slot(desk.keys, desk.stamp[0], desk.marks, key) >= 0:
            continue
        later = (layer + moves.cost[m, j]) % ring
        if n_nodes >= hunt.flood_states:
            return -1, was_full
        if fill[later] >= room:
            was_full = True
            continue
        at[n_nodes, 0], at[n_nodes, 1], desk.hs[n_nodes], desk.ms[n_nodes] = x2, y2, h2, m2
        desk.parents[n_nodes], desk.branches[n_nodes], desk.won[n_nodes] = node, j, n_won
        desk.pool[later, fill[later]] = n_nodes
        fill[later] += 1
        n_nodes += 1
    return n_nodes, was_full


@kernel
def flood(
    state: Floats,
    hunt: Hunt,
    world: World,
    moves: Moves,
    far: Ints,
    width: int,
    is_guided: bool,
    ahead: Outlook,
    desk: Desk,
    out: Branches,
) -> int:
    """Search breadth first for the nearest bin; write branches to `out`; return their count.

    Each lattice cell is visited once, and once more with a bin, and of each unit of time the `width` states nearest to
    something missing go on: nearest by what was seen `ahead`, or by cells.
    0: nothing is within reach at this resolution; -1: gave up.
    """
    at, hs, ms, gains = desk.at, desk.hs, desk.ms, desk.won
    ring, room = moves.cost.max() + 1, width * 8
    pool, fill = desk.pool, desk.fill
    fill[:] = 0
    credits = np.empty(CREDITS, np.int64)
    desk.stamp[0] += 1
    at[0, 0], at[0, 1], hs[0], ms[0] = state[0], state[1], int(state[2]), int(state[3])
    desk.parents[0], gains[0], pool[0, 0], fill[0] = -1, 0, 0, 1
    n_nodes, is_cut = 1, False
    for layer in range(hunt.flood_layers):
        here = pool[layer % ring, : fill[layer % ring]]
        if fill.sum() == 0:
            return -1 if is_cut else 0
        top, chosen = 0, -1
        for node in here:
            if gains[node] > top and goes_on(
                at[node, 0], at[node, 1], hs[node], ms[node], hunt, world, moves, credits
            ):
                top, chosen = gains[node], node
        if chosen >= 0:
            return trace(chosen, desk.parents, desk.branches, out)
        away = np.empty(len(here), np.int64)
        for o in range(len(here)):
            node = here[o]
            if is_guided:
                away[o] = units_away(at[node, 0], at[node, 1], hs[node], ms[node], world, ahead)
            else:
                away[o] = cells_away(at[node, 0], at[node, 1], world, far)
        is_cut = is_cut or len(here) > width
        for o in np.argsort(away, kind="mergesort")[:width]:
            n_nodes, was_full = _flow(here[o], layer, n_nodes, room, hunt, world, moves, desk, credits)
            is_cut = is_cut or was_full
            if n_nodes < 0:
                return -1
        fill[layer % ring] = 0
    return -1


@kernel
def transfer(
    state: Floats,
    hunt: Hunt,
    world: World,
    moves: Moves,
    far: Ints,
    ahead: Outlook,
    desk: Desk,
    out: Branches,
) -> int:
    """Find the way to the nearest bin: by a narrow flood that knows how far what is missing is, else by a wide one."""
    if hunt.narrow > 0:
        look(state, world, ahead)
        found = flood(state, hunt, world, moves, far, hunt.narrow, True, ahead, desk, out)
        if found > 0:
            return found
    return flood(state, hunt, world, moves, far, hunt.flood_width, False, ahead, desk, out)


@kernel
def advance(
    state: Floats,
    decisions: int,
    hunt: Hunt,
    world: World,
    moves: Moves,
    ahead: Outlook,
    desk: Desk,
    sequence: Branches,
    counters: Ints,
) -> None:
    """Make up to so many decisions; write the branches driven to `sequence`, and how it stands to `counters`.

    counters : length of the sequence, bins left, floods, status (0 goes on, 1 all is done, 2 nothing more is within
        reach, 3 gave up)
    """
    far, queue = np.empty(world.missing.shape, np.int64), np.empty(world.missing.size, np.int64)
    out, way = np.empty(LONGEST_FLOOD, np.int32), np.empty(LONGEST_FLOOD, np.int32)
    credits = np.empty(CREDITS, np.int64)
    for _ in range(decisions):
        if counters[1] == 0:
            counters[3] = 1
            return
        potential(world, far, queue)
        n, won = harvest(state, hunt, world, moves, far, desk, out)
        units = hunt.executed
        if won < min(hunt.least, counters[1]):
            counters[2] += 1
            found = transfer(state, hunt, world, moves, far, ahead, desk, way)
            if found > 0:
                n, units = found, LONGEST_FLOOD
                out[:n] = way[:n]
            elif won == 0:
                counters[3] = 2 if found == 0 else 3
                return
        driven = 0
        for k in range(n):
            if counters[1] == 0:
                if hunt.safe_depth >= 0 or state[3] == 0:
                    break
            elif driven >= units:
                break
            driven += moves.cost[int(state[3]), out[k]]
            counters[1] -= drive(state, out[k], world, moves, credits)
            sequence[counters[0]] = out[k]
            counters[0] += 1
