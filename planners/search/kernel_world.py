"""Compiled kernels of all searches: clearance of a primitive, its end state, and the bins that it covers.

State s: place (x, y) [m], heading step h, mode m. Branch j of mode m leads to:

    f(s, j) = (x + offset_x, y + offset_y, (h + turned_steps[m, j]) mod n_headings, next_mode[m, j]).

The offsets are those of the last sample of (h, m, j). A bin is covered if the robot stays in it for at least
`dwell`, or `inner_dwell` in its inner half.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from planners.kernel import inlined_kernel, inner_kernel, outer_kernel
from planners.search.motion_primitives import MotionPrimitives
from planners.types import Bools, Floats, Int32s, Ints

MAX_BINS_PER_PRIMITIVE = 3
"""Maximum number of bins that one primitive covers."""
STOP_MARGIN = 0.003
"""[m] minimum distance of a stop from the border of its cell to cover its bin, so that rounding cannot move it out."""
MAX_ESCAPE_TRIES = 3000
"""Maximum number of primitives tried before a state counts as unsafe."""
LATTICE = 0.03
"""[m] side of a lattice cell; positions in one cell count as the same state."""
wide: Any = np.int64
"""Numba compiles a kernel once for each type of integer; the callers of the large ones pass this one."""


class SearchWorld(NamedTuple):
    """The floor of a search and its wanted bins."""

    distance: Floats
    """(mx, my) [m] of each node to the nearest barrier."""
    need: Bools
    """(nx, ny, n_phi) bins still wanted."""
    missing: Ints
    """(nx, ny) number of wanted bins in each cell."""
    inner: Bools
    """(nx, ny) cells whose bins count only in their inner half, and only in the middle half of the heading bin."""
    value: Floats
    """(nx, ny) value of a bin in each cell."""
    open_borders: Ints
    """(nx, ny) bits, see `rooms.open_borders`."""
    x0: float
    """[m] lower left corner, x."""
    y0: float
    """[m] lower left corner, y."""
    step: float
    """[m] between nodes."""
    cell: float
    """[m] side of a cell."""
    clearance: float
    """[m] required distance from barriers."""
    dwell: float
    """[s] minimum stay in a bin."""
    inner_dwell: float
    """[s] minimum stay in the inner half of a bin."""
    trapped: Bools
    """(lx, ly, n_headings) lattice cells known to be unsafe; (1, 1, 1) if they are not cached."""


class Scratch(NamedTuple):
    """Memory that the kernels write to; they allocate none themselves, which would cost run time and compile time."""

    covered: Ints
    """(MAX_BINS_PER_PRIMITIVE,) flat indices of the bins that the last primitive covers."""
    places: Floats
    """(depth + 1, 2) [m] places on the path that `find_escape` tries."""
    states: Ints
    """(depth + 1, 3) heading step, mode, and the next branch to try."""
    escape: Int32s
    """(depth,) branches of that path."""


def new_scratch(depth: int) -> Scratch:
    """Return memory for escapes of up to `depth` branches."""
    return Scratch(
        covered=np.empty(MAX_BINS_PER_PRIMITIVE, dtype=np.int64),
        places=np.empty((depth + 1, 2)),
        states=np.empty((depth + 1, 3), dtype=np.int64),
        escape=np.empty(depth, dtype=np.int32),
    )


@inner_kernel
def interpolate(distance: Floats, i: int, k: int, a: float, b: float) -> float:
    """Interpolate a raster bilinearly between node (i, k) and the next ones, at shares a and b of the step."""
    near = (1 - b) * distance[i, k] + b * distance[i, k + 1]
    far = (1 - b) * distance[i + 1, k] + b * distance[i + 1, k + 1]
    return float((1 - a) * near + a * far)


@inlined_kernel
def wanted_bin(u: float, v: float, heading_bin: int, is_core: bool, need: Bools, inner: Bools) -> int:
    """Return the flat index of the bin in which a sample at (u, v) [cells] counts; -1 if it counts in none.

    In an inner cell only samples in its middle, and in the core of the heading bin, count.
    """
    i, k = int(u), int(v)
    if not need[i, k, heading_bin]:
        return -1
    if inner[i, k] and (abs(u - i - 0.5) > 0.25 or abs(v - k - 0.5) > 0.25 or not is_core):
        return -1
    return int((i * need.shape[1] + k) * need.shape[2] + heading_bin)


@inlined_kernel
def try_primitive(
    x: float,
    y: float,
    h: int,
    m: int,
    j: int,
    world: SearchWorld,
    primitives: MotionPrimitives,
    covered: Ints,
) -> tuple[bool, int]:
    """Return whether branch j is clear, and the number of bins that it covers; their indices are written to `covered`.

    The distance to barriers is interpolated at every sample. A bin counts if the samples in a row stay in it
    for at least the required time; the margins account for borders crossed between two samples.

    One piece on purpose: it is the innermost kernel of all searches, and inlined. It first looks for walls.
    Then it tests the few samples that no sufficient stay can miss, and evaluates the stays only if one of
    these is in a wanted bin.
    """
    distance, need, inner = world.distance, world.need, world.inner
    offsets, bins, core = primitives.offsets, primitives.bins, primitives.core
    n_samples = bins.shape[3]
    step, clearance = world.step, world.clearance
    per_step, per_cell = 1.0 / step, 1.0 / world.cell
    x, y = x - world.x0, y - world.y0
    mx, my = distance.shape
    middle = n_samples // 2
    i = int((x + offsets[h, m, j, middle, 0]) * per_step)
    k = int((y + offsets[h, m, j, middle, 1]) * per_step)
    if i < 0 or k < 0 or i >= mx or k >= my:
        return False, 0
    if distance[i, k] < clearance + primitives.max_offset + 2.0 * step:  # else no wall is near enough
        for s in range(n_samples + 1):
            u = (x + offsets[h, m, j, s, 0]) * per_step - 0.5
            v = (y + offsets[h, m, j, s, 1]) * per_step - 0.5
            if u < 0.0 or v < 0.0:
                return False, 0
            i, k = int(u), int(v)
            if i >= mx - 1 or k >= my - 1:
                return False, 0
            near = distance[i, k]
            if near < clearance + 1.5 * step:
                if near < clearance - 1.5 * step:
                    return False, 0
                if interpolate(distance, i, k, u - i, v - k) < clearance:
                    return False, 0
    n_covered = 0
    if primitives.stops_first[m, j]:
        u, v = x * per_cell, y * per_cell
        i, k, rim = int(u), int(v), STOP_MARGIN * per_cell
        heading_bin = primitives.heading_bin[h]
        if need[i, k, heading_bin] and rim < u - i < 1 - rim and rim < v - k < 1 - rim:
            covered[0] = (i * need.shape[1] + k) * need.shape[2] + heading_bin
            n_covered = 1
    period = primitives.sample_period[m, j]
    least = min(world.dwell, world.inner_dwell) / period + min(primitives.core_margin, 0.5)
    every = min(max(int(np.ceil(least - 1e-9)), 1), n_samples)  # samples of the shortest stay that counts
    is_seen = False
    for s in range(every - 1, n_samples, every):
        u, v = (x + offsets[h, m, j, s, 0]) * per_cell, (y + offsets[h, m, j, s, 1]) * per_cell
        if wanted_bin(u, v, bins[h, m, j, s], core[h, m, j, s], need, inner) >= 0:
            is_seen = True
            break
    if not is_seen:
        return True, n_covered
    run_id, run_start, run_inner = -1, 0, False
    for s in range(n_samples + 1):
        bin_here = -1
        if s < n_samples:
            u, v = (x + offsets[h, m, j, s, 0]) * per_cell, (y + offsets[h, m, j, s, 1]) * per_cell
            bin_here = wanted_bin(u, v, bins[h, m, j, s], core[h, m, j, s], need, inner)
        if bin_here != run_id:
            if run_id >= 0:
                margin = primitives.core_margin if run_inner else 0.5
                first = 0.0 if run_start == 0 else run_start + margin
                last = float(n_samples) if s == n_samples and bin_here == -1 else s - margin
                wanted = world.inner_dwell if run_inner else world.dwell
                if (last - first) * period >= wanted and n_covered < MAX_BINS_PER_PRIMITIVE:
                    covered[n_covered] = run_id
                    n_covered += 1
            run_id, run_start = bin_here, s
            if bin_here >= 0:
                run_inner = inner[int(u), int(v)]
    return True, n_covered


@inlined_kernel
def end_state(
    x: float, y: float, h: int, m: int, j: int, primitives: MotionPrimitives
) -> tuple[float, float, int, int]:
    """Return the state after branch j."""
    offset = primitives.offsets[h, m, j, primitives.bins.shape[3]]
    return (
        x + offset[0],
        y + offset[1],
        (h + primitives.turned_steps[m, j]) % len(primitives.offsets),
        primitives.next_mode[m, j],
    )


@outer_kernel
def find_escape(
    x: float,
    y: float,
    h: int,
    m: int,
    depth: int,
    world: SearchWorld,
    primitives: MotionPrimitives,
    scratch: Scratch,
) -> int:
    """Find a sequence of clear branches from a state: depth-first search, branches that slow down first.

    Parameters
    ----------
    depth : Number of branches; if negative, up to -depth branches until the robot is at rest (mode 0).

    Returns
    -------
    The number of branches, which are written to `scratch.escape`; -1: none was found, so the state is not
    safe.
    """
    until_rest = depth < 0
    most = abs(depth)
    if most == 0 or (until_rest and m == 0):
        return 0
    n_branches = primitives.next_mode.shape[1]
    places, states = scratch.places, scratch.states
    places[0, 0], places[0, 1] = x, y
    states[0, 0], states[0, 1], states[0, 2] = h, m, 0
    at, tries = 0, 0
    while at >= 0 and tries < MAX_ESCAPE_TRIES:
        h, m, j = states[at, 0], states[at, 1], states[at, 2]
        if j >= n_branches or at == most:
            at -= 1
            continue
        states[at, 2] += 1
        if primitives.next_mode[m, j] < 0 or primitives.is_fine[m, j]:
            continue
        tries += 1
        free, _ = try_primitive(places[at, 0], places[at, 1], h, m, j, world, primitives, scratch.covered)
        if free:
            scratch.escape[at] = j
            x2, y2, h2, m2 = end_state(places[at, 0], places[at, 1], h, m, j, primitives)
            at += 1
            if (until_rest and m2 == 0) or (not until_rest and at == most):
                return at
            places[at, 0], places[at, 1] = x2, y2
            states[at, 0], states[at, 1], states[at, 2] = h2, m2, 0
    return -1


@inner_kernel
def find_slot(table: Ints, size: int, stamp: int, marks: Ints, key: int) -> int:
    """Return the slot of `key` in an open-addressing hash table, or insert it and return -1 - slot.

    Parameters
    ----------
    size : Number of slots in use, a power of two; a small table stays in the processor's cache.
    stamp : Number of the search; slots with another stamp in `marks` are free.
    """
    mask = size - 1
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
def lattice_key(x: float, y: float, h: int, m: int, world: SearchWorld, primitives: MotionPrimitives) -> int:
    """Return the index of the lattice cell of a state."""
    i, k = int((x - world.x0) / LATTICE), int((y - world.y0) / LATTICE)
    return int(((i * 65536 + k) * primitives.offsets.shape[0] + h) * primitives.offsets.shape[1] + m)


@inner_kernel
def trace_back(node: int, parents: Int32s, branches: Int32s, out: Int32s) -> int:
    """Write the branches from the root to a node to `out`; return their number."""
    n, up = 0, node
    while parents[up] >= 0:
        n += 1
        up = parents[up]
    for k in range(n - 1, -1, -1):
        out[k] = branches[node]
        node = parents[node]
    return n


@outer_kernel
def apply_primitive(
    state: Floats, j: int, world: SearchWorld, primitives: MotionPrimitives, covered: Ints
) -> int:
    """Execute branch j, remove the bins that it covers from the wanted ones, and return their number."""
    n_covered, ny, n_phi = 0, world.need.shape[1], world.need.shape[2]
    x, y, h, m = state[0], state[1], int(state[2]), int(state[3])
    _, n_credited = try_primitive(x, y, h, m, j, world, primitives, covered)
    for c in range(n_credited):
        ci, ck, cb = covered[c] // (n_phi * ny), (covered[c] // n_phi) % ny, covered[c] % n_phi
        if world.need[ci, ck, cb]:
            world.need[ci, ck, cb] = False
            world.missing[ci, ck] -= 1
            n_covered += 1
    state[0], state[1], state[2], state[3] = end_state(x, y, h, m, j, primitives)
    return n_covered
