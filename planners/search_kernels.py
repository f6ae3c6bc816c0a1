"""Compiled kernels of the search: try a primitive, harvest with a beam, flood to the next bin, advance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planners.arena import Bools, Floats
from planners.kernel import inlined_kernel, inner_kernel, kernel
from planners.order import Ints
from planners.search_outlook import FARTHEST, Lattice, Units, wave

CREDITS = 3
"""Most bins that one primitive may be credited with."""
WITHIN = 0.003
"""[m] to the border of a cell from a place where the robot stops, which it then logs."""
MOST_TRIES = 3000
"""Primitives tried for a way to go on, or to stop."""
OVERTIME = 0.25
"""Value of a unit of time that one drive ends before another."""
LONGEST_FLOOD = 2048
"""Primitives in a row, at most."""
Branches = NDArray[np.int32]


class World(NamedTuple):
    """Where the robot drives, and what it wants there."""

    distance: Floats
    """(mx, my) [m] of each node to the nearest barrier."""
    need: Bools
    """(nx, ny, n_phi) bins still wanted."""
    missing: Ints
    """(nx, ny) how many of a cell."""
    inner: Bools
    """(nx, ny) cells in which only the inner half counts, and of it the middle half of the heading bin."""
    value: Floats
    """(nx, ny)"""
    links: Ints
    """(nx, ny) bits of neighbours (`rooms.SIDES`) that can be reached over the common border."""
    x0: float
    """[m]"""
    y0: float
    """[m]"""
    step: float
    """[m] between nodes."""
    cell: float
    """[m]"""
    least: float
    """[m] distance to keep."""
    dwell: float
    """[s] to stay in a bin."""
    inner_dwell: float
    """[s] to stay in the inner half of one."""
    trapped: Bools
    """(lx, ly, n_headings) lattice cells from which no way on was found; (1, 1, 1) where that is not remembered."""


class Moves(NamedTuple):
    """What the robot may do from a heading step and a mode; the fields of `search_table.Table`."""

    ways: Floats
    bins: NDArray[np.int16]
    core: Bools
    turn: Ints
    then: Ints
    cost: Ints
    period: Floats
    patient: Bools
    stops: Bools
    rests: NDArray[np.int16]
    longest: float
    """[m] from a primitive's middle sample to its other ones, and a node's diagonal."""


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
def between(distance: Floats, i: int, k: int, a: float, b: float) -> float:
    """Interpolate a raster from node (i, k) on, by the shares a and b of the way to the next nodes."""
    near = (1 - b) * distance[i, k] + b * distance[i, k + 1]
    far = (1 - b) * distance[i + 1, k] + b * distance[i + 1, k + 1]
    return float((1 - a) * near + a * far)


@inlined_kernel
def attempt(
    x: float, y: float, h: int, m: int, j: int, world: World, moves: Moves, credits: Ints
) -> tuple[bool, int]:
    """Drive branch j; fill `credits` with the flat bins it wins; return whether it is free, and how many."""
    distance, need, missing, inner = world.distance, world.need, world.missing, world.inner
    ways, bins, core = moves.ways, moves.bins, moves.core
    n_samples = bins.shape[3]
    x0, y0, step, least = world.x0, world.y0, world.step, world.least
    per_step, per_cell = 1.0 / step, 1.0 / world.cell
    mx, my = distance.shape
    ny, n_phi = need.shape[1], need.shape[2]
    n_won = 0
    run_id, run_start = -1, 0
    run_inner = False
    if moves.stops[m, j]:
        fu, fv = (x - x0) * per_cell, (y - y0) * per_cell
        ci, ck, rim = int(fu), int(fv), WITHIN * per_cell
        if need[ci, ck, moves.rests[h]] and rim < fu - ci < 1 - rim and rim < fv - ck < 1 - rim:
            credits[0] = (ci * ny + ck) * n_phi + moves.rests[h]
            n_won = 1
    period = moves.period[m, j]
    middle = n_samples // 2
    i = int((x - x0 + ways[h, m, j, middle, 0]) * per_step)
    k = int((y - y0 + ways[h, m, j, middle, 1]) * per_step)
    if i < 0 or k < 0 or i >= mx or k >= my:
        return False, 0
    is_open = distance[i, k] >= least + moves.longest  # no wall is near enough to matter
    ci, ck = int((x - x0) * per_cell), int((y - y0) * per_cell)
    ei = int((x - x0 + ways[h, m, j, n_samples, 0]) * per_cell)
    ek = int((y - y0 + ways[h, m, j, n_samples, 1]) * per_cell)
    is_vain = is_open and missing[ci, ck] + missing[ei, ek] + missing[ci, ek] + missing[ei, ck] == 0
    if is_open and is_vain:
        return True, n_won
    for s in range(n_samples + 1):
        px = x - x0 + ways[h, m, j, s, 0]
        py = y - y0 + ways[h, m, j, s, 1]
        if not is_open:
            u = px * per_step - 0.5
            v = py * per_step - 0.5
            if u < 0.0 or v < 0.0:
                return False, 0
            i, k = int(u), int(v)
            if i >= mx - 1 or k >= my - 1:
                return False, 0
            near = distance[i, k]
            if near < least + 1.5 * step:
                if near < least - 1.5 * step:
                    return False, 0
                if between(distance, i, k, u - i, v - k) < least:
                    return False, 0
        if is_vain:
            continue
        this = -1
        if s < n_samples:
            fu, fv = px * per_cell, py * per_cell
            ci, ck = int(fu), int(fv)
            if missing[ci, ck] > 0 and need[ci, ck, bins[h, m, j, s]]:
                this = (ci * ny + ck) * n_phi + bins[h, m, j, s]
                if inner[ci, ck] and (
                    abs(fu - ci - 0.5) > 0.25 or abs(fv - ck - 0.5) > 0.25 or not core[h, m, j, s]
                ):
                    this = -1
        if this != run_id:
            if run_id >= 0:
                first = 0.0 if run_start == 0 else run_start + 0.5
                last = float(n_samples) if s == n_samples and this == -1 else s - 0.5
                wanted = world.inner_dwell if run_inner else world.dwell
                if (last - first) * period >= wanted and n_won < CREDITS:
                    credits[n_won] = run_id
                    n_won += 1
            run_id, run_start = this, s
            if this >= 0:
                run_inner = inner[ci, ck]
    return True, n_won


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


@inlined_kernel
def end_of(x: float, y: float, h: int, m: int, j: int, moves: Moves) -> tuple[float, float, int, int]:
    """Return the state after branch j."""
    way = moves.ways[h, m, j, moves.bins.shape[3]]
    return x + way[0], y + way[1], (h + moves.turn[m, j]) % len(moves.ways), moves.then[m, j]


@kernel
def escape(
    x: float, y: float, h: int, m: int, depth: int, world: World, moves: Moves, credits: Ints, out: Branches
) -> int:
    """Find branches that can be driven on, the slowing ones first; write them to `out`, return their count or -1.

    depth : so many branches; negative: at most so many, until the robot stands still (mode 0)
    """
    until_rest = depth < 0
    most = abs(depth)
    if most == 0 or (until_rest and m == 0):
        return 0
    n_branches = moves.then.shape[1]
    xs, ys = np.empty(most + 1), np.empty(most + 1)
    hs, ms, js = np.empty(most + 1, np.int64), np.empty(most + 1, np.int64), np.zeros(most + 1, np.int64)
    xs[0], ys[0], hs[0], ms[0] = x, y, h, m
    at, tries = 0, 0
    while at >= 0 and tries < MOST_TRIES:
        j = js[at]
        if j >= n_branches or at == most:
            at -= 1
            continue
        js[at] += 1
        if moves.then[ms[at], j] < 0 or moves.patient[ms[at], j]:
            continue
        tries += 1
        free, _ = attempt(xs[at], ys[at], hs[at], ms[at], j, world, moves, credits)
        if free:
            out[at] = j
            xs[at + 1], ys[at + 1], hs[at + 1], ms[at + 1] = end_of(xs[at], ys[at], hs[at], ms[at], j, moves)
            at += 1
            if (until_rest and ms[at] == 0) or (not until_rest and at == most):
                return at
            js[at] = 0
    return -1


@kernel
def is_safe(
    x: float, y: float, h: int, m: int, depth: int, world: World, moves: Moves, credits: Ints
) -> bool:
    """Tell whether the robot can go on from here, or stop (see `escape`)."""
    out = np.empty(abs(depth), np.int32)
    return escape(x, y, h, m, depth, world, moves, credits, out) >= 0


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
def find_slot(table: Ints, stamp: int, marks: Ints, key: int) -> int:
    """Return the slot of `key` in an open hash table, or -1 - slot if it is new; other stamps mark what is free."""
    mask = len(table) - 1
    z = key * np.int64(-7046029254386353131)
    slot = int((z ^ (z >> 29)) & mask)
    while marks[slot] == stamp:
        if table[slot] == key:
            return slot
        slot = (slot + 1) & mask
    marks[slot] = stamp
    table[slot] = key
    return -slot - 1


@inner_kernel
def lattice_key(x: float, y: float, h: int, m: int, world: World, moves: Moves, fine: float) -> int:
    """Return the lattice cell of a state."""
    i, k = int((x - world.x0) / fine), int((y - world.y0) / fine)
    return int(((i * 65536 + k) * moves.ways.shape[0] + h) * moves.ways.shape[1] + m)


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
def trace(node: int, parents: Branches, branches: Branches, out: Branches) -> int:
    """Write the branches that lead to a node; return how many."""
    n, up = 0, node
    while parents[up] >= 0:
        n += 1
        up = parents[up]
    for k in range(n - 1, -1, -1):
        out[k] = branches[node]
        node = parents[node]
    return n


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


@inner_kernel
def drive(state: Floats, j: int, world: World, moves: Moves, credits: Ints) -> int:
    """Drive branch j, take what it wins off what is wanted, and return how many bins that were."""
    n_won, ny, n_phi = 0, world.need.shape[1], world.need.shape[2]
    x, y, h, m = state[0], state[1], int(state[2]), int(state[3])
    _, n_credits = attempt(x, y, h, m, j, world, moves, credits)
    for c in range(n_credits):
        ci, ck, cb = credits[c] // (n_phi * ny), (credits[c] // n_phi) % ny, credits[c] % n_phi
        if world.need[ci, ck, cb]:
            world.need[ci, ck, cb] = False
            world.missing[ci, ck] -= 1
            n_won += 1
    state[0], state[1], state[2], state[3] = end_of(x, y, h, m, j, moves)
    return n_won


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
