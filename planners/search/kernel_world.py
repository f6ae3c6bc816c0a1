"""Compiled kernels of all searches: where the robot drives, which primitives it can drive there, and what they win."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planners.kernel import inlined_kernel, inner_kernel, kernel
from planners.types import Bools, Floats, Ints

CREDITS = 3
"""Most bins that one primitive may be credited with."""
WITHIN = 0.003
"""[m] to the border of a cell from a place where the robot stops, which it then logs."""
MOST_TRIES = 3000
"""Primitives tried for a way to go on, or to stop."""
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
