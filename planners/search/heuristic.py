"""Cost-to-go map of a car around its pose: the time to the nearest missing bin, on a coarse lattice (compiled kernels).

State s: lattice point (i, k), heading class c, gear g. Primitive j is driven in gear[j] and leads to f(s, j).
The cost-to-go V [units of time] is 0 if the bin of s is missing. Otherwise:

    V(s) = min over j of  cost[j] + pause [g ≠ gear[j]] + V(f(s, j)).

Dijkstra's algorithm solves this backward from all missing
bins near the car, with a bucket queue for the integer costs (R. B. Dial, Algorithm 360, Communications of the
ACM 12, 1969).

The map guides the search for the nearest bin; unlike distances in cells, it includes headings. For a car, the
bin next to it may be ten metres away. The map is no bound: the ends of primitives are rounded to lattice
points, up and down in turn, so that the errors average out. The constants were set with `python -m
benchmarks.coverage_planners --drive reeds_shepp` (column `cpu`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planners.kernel import inner_kernel, outer_kernel
from planners.search.area import SearchArea
from planners.search.kernel_world import SearchWorld
from planners.search.motion_primitives import MotionPrimitives
from planners.search.settings import SearchSettings
from planners.types import Bools, Floats, Int16s, Int32s, Ints

POINTS_PER_CELL = 4
"""Number of lattice points along the side of a cell."""
WINDOW_RADIUS = 1.2
"""[m] radius of the map around the car."""
CLEARANCE_SLACK = 0.02
"""[m] by which a lattice point may be too near to a wall, since poses next to it may be clear."""
RIM = 5
"""Number of empty points along the border of the window; more than the length of a primitive."""
OVERRUN = 6
"""[units of time] that the wave continues after it has reached the car."""
ROUNDINGS = 16
"""Number of roundings of a primitive's end to the lattice, used in turn so that the errors average out."""
UNREACHED = 1 << 12
"""[units of time] cost-to-go of poses that the wave does not reach."""


class HeuristicLattice(NamedTuple):
    """Coarse lattice of a car's poses, with the transitions of its primitives."""

    spacing: float
    """[m] between points."""
    steps_per_class: int
    """Number of heading steps of the primitives in one heading class."""
    side: int
    """Number of points along each side of the window."""
    free: Bools
    """(Lx, Ly) points of the area that are free, or almost free."""
    back: Ints
    """(ROUNDINGS, n_classes, n_moves) index offset in the map from a state to its predecessor by a primitive, at equal
    gear."""
    cost: Ints
    """(n_moves,) [units of time] duration of each primitive."""
    gear: Ints
    """(n_moves,) gear of each primitive."""
    pause: int
    """[units of time] duration of a gear change."""
    bins: Ints
    """(n_classes,) heading bin of each class."""
    n_gears: int


def heuristic_lattice(primitives: MotionPrimitives, area: SearchArea) -> HeuristicLattice:
    """Return the lattice of a car's primitives in an area."""
    distance, step, spacing = area.distance, area.step, area.cell / POINTS_PER_CELL
    coarse = ~primitives.is_fine[0]
    turn, gear = primitives.turned_steps[0][coarse], primitives.next_mode[0][coarse]
    length = primitives.cost.min(axis=0)[coarse]
    steps_per_class = int(abs(turn[turn != 0]).min())
    size = (np.array(distance.shape) * step / spacing).astype(np.int64)
    at = [np.minimum(((np.arange(n) + 0.5) * spacing / step).astype(np.int64), distance.shape[k] - 1)
          for k, n in enumerate(size.tolist())]  # fmt: skip
    side, bins, n_gears = (
        2 * (int(np.ceil(WINDOW_RADIUS / spacing)) + RIM) + 1,
        primitives.heading_bin[steps_per_class // 2 :: steps_per_class],
        len(primitives.next_mode),
    )
    ahead = (
        primitives.offsets[steps_per_class // 2 :: steps_per_class, 0][:, coarse, -1] / spacing
    )  # (n_classes, n_moves, 2) displacement of each move, in points
    classes, dither = np.arange(len(bins))[:, None], (np.arange(ROUNDINGS)[:, None, None] + 0.5) / ROUNDINGS
    before = (classes - turn // steps_per_class) % len(bins)
    i, k = np.moveaxis(ahead[before, np.arange(len(turn))], -1, 0)
    points = np.floor(i + dither) * side + np.floor(k + 1.0 - dither)
    return HeuristicLattice(
        spacing=spacing,
        steps_per_class=steps_per_class,
        side=side,
        free=np.ascontiguousarray(distance[np.ix_(*at)] >= area.clearance - CLEARANCE_SLACK),
        back=((before - classes - points * len(bins)) * n_gears).astype(np.int64),
        cost=length,
        gear=gear,
        pause=int((primitives.cost - primitives.cost.min(axis=0)).max()),
        bins=bins.astype(np.int64),
        n_gears=n_gears,
    )


class HeuristicBuffers(NamedTuple):
    """The cost-to-go map around a car, and the bucket queue that fills it."""

    lattice: HeuristicLattice
    cost_to_go: Int16s
    """(side * side * n_classes * n_gears,) units of time to the nearest missing bin."""
    queue: Int32s
    """(n_entries,) states as indices of `cost_to_go`."""
    next_entry: Int32s
    """(n_entries,) next entry with the same cost; -1: none."""
    heads: Int32s
    """(ring,) first entry of each cost, modulo the length of the ring."""
    corner: Ints
    """(2,) lattice point at the window's (0, 0)."""


def heuristic_buffers(
    settings: SearchSettings, primitives: MotionPrimitives, area: SearchArea
) -> HeuristicBuffers:
    """Return the memory of the cost-to-go map; minimal if the settings request no guided search."""
    lattice = heuristic_lattice(primitives, area)
    side = lattice.side if settings.guided_width > 0 else 1
    cost_to_go = np.empty(side * side * len(lattice.bins) * lattice.n_gears, dtype=np.int16)
    entries = np.empty((2, 4 * cost_to_go.size), dtype=np.int32)
    heads = np.empty(int(lattice.cost.max()) + lattice.pause + 1, dtype=np.int32)
    return HeuristicBuffers(lattice, cost_to_go, entries[0], entries[1], heads, np.zeros(2, dtype=np.int64))


@outer_kernel
def update_heuristic(state: Floats, world: SearchWorld, heuristic: HeuristicBuffers) -> None:
    """Fill the cost-to-go map around a state (4,): the units of time to the nearest missing bin.

    The wave stops `OVERRUN` units after it has reached the car.
    """
    lattice, cost_to_go, queue, next_entry, heads, corner = heuristic
    here, mode = int(state[2]) // lattice.steps_per_class, int(state[3])
    side, n_classes, n_gears, ring = lattice.side, len(lattice.bins), lattice.n_gears, len(heads)
    corner[0] = int((state[0] - world.x0) / lattice.spacing) - side // 2
    corner[1] = int((state[1] - world.y0) / lattice.spacing) - side // 2
    n_queued = _start_wave(corner[0], corner[1], world, heuristic)
    units, empty = 0, 0
    at_car = ((side // 2 * side + side // 2) * n_classes + here) * n_gears + mode
    while empty < ring and cost_to_go[at_car] + OVERRUN >= units:
        entry = heads[units % ring]
        heads[units % ring] = -1
        empty = empty + 1 if entry < 0 else 0
        while entry >= 0:
            state = queue[entry]
            entry = next_entry[entry]
            if cost_to_go[state] != units:
                continue  # already reached at a lower cost
            g, pose = state % n_gears, state // n_gears
            c, point = pose % n_classes, pose // n_classes
            phase = ((point // side) * 5 + (point % side) * 3 + c * 7) % ROUNDINGS
            for j in range(len(lattice.gear)):
                if lattice.gear[j] != g:
                    continue
                before = state - g + lattice.back[phase, c, j]
                for other in range(n_gears):
                    later = units + lattice.cost[j] + (lattice.pause if other != g else 0)
                    if later < cost_to_go[before + other] and n_queued < len(queue):
                        cost_to_go[before + other] = later
                        queue[n_queued] = before + other
                        next_entry[n_queued] = heads[later % ring]
                        heads[later % ring] = n_queued
                        n_queued += 1
        units += 1


@inner_kernel
def _start_wave(i0: int, k0: int, world: SearchWorld, heuristic: HeuristicBuffers) -> int:
    """Start the wave in every missing bin of the window whose (0, 0) is point (i0, k0); return the number of entries.

    Points that are not free, and the rim of the window, get a cost of -1, so that the wave never enters them.
    """
    lattice, cost_to_go, queue, next_entry, heads, _ = heuristic
    need, missing = world.need, world.missing
    side, n_classes, n_gears, (n, m) = lattice.side, len(lattice.bins), lattice.n_gears, lattice.free.shape
    cost_to_go[:] = -1
    heads[:] = -1
    n_queued = 0
    for i in range(max(RIM, -i0), min(side - RIM, n - i0)):
        for k in range(max(RIM, -k0), min(side - RIM, m - k0)):
            ci, ck = (i + i0) // POINTS_PER_CELL, (k + k0) // POINTS_PER_CELL
            if not lattice.free[i + i0, k + k0]:
                continue
            first = (i * side + k) * n_classes * n_gears
            cost_to_go[first : first + n_classes * n_gears] = UNREACHED
            if missing[ci, ck] == 0:
                continue
            for c in range(n_classes):
                if need[ci, ck, lattice.bins[c]]:
                    for g in range(n_gears):
                        state = first + c * n_gears + g
                        cost_to_go[state] = 0
                        queue[n_queued] = state
                        next_entry[n_queued] = heads[0]
                        heads[0] = n_queued
                        n_queued += 1
    return n_queued


@outer_kernel
def time_to_goal(x: float, y: float, h: int, m: int, world: SearchWorld, heuristic: HeuristicBuffers) -> int:
    """Return the units of time from a state to the nearest missing bin; UNREACHED outside the map."""
    lattice, corner = heuristic.lattice, heuristic.corner
    i = int((x - world.x0) / lattice.spacing) - corner[0]
    k = int((y - world.y0) / lattice.spacing) - corner[1]
    if i < 0 or k < 0 or i >= lattice.side or k >= lattice.side:
        return UNREACHED
    pose = (i * lattice.side + k) * len(lattice.bins) + h // lattice.steps_per_class
    away = int(heuristic.cost_to_go[pose * lattice.n_gears + m])
    return away if away >= 0 else UNREACHED
