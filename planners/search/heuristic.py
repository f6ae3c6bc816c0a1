"""How far a car is from the nearest missing bin, by a coarse lattice of its own moves round it: compiled kernels.

A cell count knows nothing of headings: for a car, the bin beside it may be ten metres away. The wave runs backward from
all missing bins near the car, over poses on a lattice and gears, and says how many units of time each is from one. It
guides the search, and proves nothing: moves start and end at lattice points, rounded up or down in turn so that many
of them come out right.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planners.kernel import inner_kernel
from planners.search.motion_primitives import Table
from planners.types import Bools, Floats, Ints

POINTS = 4
"""Lattice points along a cell's side."""
AROUND = 1.2
"""[m] round the car that the wave covers."""
SLACK = 0.02
"""[m] that lattice points may be too near to a wall: poses beside them may not be."""
BEYOND = 6
"""Units of time that the wave goes on when it has come to the car."""
RIM = 5
"""Points at the window's rim where no wave comes, more than a move is long."""
PHASES = 16
"""Lattice points round up and down in so many ways."""
FARTHEST = 1 << 12
"""Units of time of what the wave does not reach."""
Units = NDArray[np.int16]


class Lattice(NamedTuple):
    """The coarse lattice of a car's poses, and its moves."""

    fine: float
    """[m] between points."""
    group: int
    """Heading steps of the table in one of the lattice."""
    side: int
    """Points of the window each way."""
    free: Bools
    """(Lx, Ly) points of the scene where the car may be, or almost."""
    back: Ints
    """(PHASES, n_classes, n_moves) from the place of a pose among the wave's values to that from which a move leads
    there, if the gear stays."""
    cost: Ints
    """(n_moves,) units of time."""
    gear: Ints
    """(n_moves,)"""
    pause: int
    """Units of time of a change of gear."""
    bins: Ints
    """(n_classes,) heading bin."""
    n_gears: int


def lattice(table: Table, distance: Floats, step: float, cell: float, least: float) -> Lattice:
    """Return the lattice of a car's table in a scene (`search.Scene`)."""
    fine = cell / POINTS
    own = ~table.patient[0]
    turn, gear = table.turn[0][own], table.then[0][own]
    length = table.cost.min(axis=0)[own]
    group = int(abs(turn[turn != 0]).min())
    size = (np.array(distance.shape) * step / fine).astype(np.int64)
    at = [np.minimum(((np.arange(n) + 0.5) * fine / step).astype(np.int64), distance.shape[k] - 1)
          for k, n in enumerate(size.tolist())]  # fmt: skip
    side, bins, n_gears = (
        2 * (int(np.ceil(AROUND / fine)) + RIM) + 1,
        table.rests[group // 2 :: group],
        len(table.then),
    )
    ahead = (
        table.ways[group // 2 :: group, 0][:, own, -1] / fine
    )  # (n_classes, n_moves, 2) points that a move leads on
    classes, dither = np.arange(len(bins))[:, None], (np.arange(PHASES)[:, None, None] + 0.5) / PHASES
    before = (classes - turn // group) % len(bins)
    i, k = np.moveaxis(ahead[before, np.arange(len(turn))], -1, 0)
    points = np.floor(i + dither) * side + np.floor(k + 1.0 - dither)
    return Lattice(
        fine=fine,
        group=group,
        side=side,
        free=np.ascontiguousarray(distance[np.ix_(*at)] >= least - SLACK),
        back=((before - classes - points * len(bins)) * n_gears).astype(np.int64),
        cost=length,
        gear=gear,
        pause=int((table.cost - table.cost.min(axis=0)).max()),
        bins=bins.astype(np.int64),
        n_gears=n_gears,
    )


@inner_kernel
def wave(
    x: float,
    y: float,
    need: Bools,
    missing: Ints,
    grid: Lattice,
    value: Units,
    here: int,
    mode: int,
    queue: NDArray[np.int32],
    following: NDArray[np.int32],
    heads: NDArray[np.int32],
) -> tuple[int, int]:
    """Fill `value (side * side * n_classes * n_gears,)` with the units of time to the nearest missing bin.

    x, y : [m] of the car, from the scene's origin; here, mode : its lattice heading, and its gear
    queue, following : of entries of the wave; heads : of the entries of each unit of time, in turn

    Returns
    -------
    the lattice point that is the window's (0, 0)
    """
    side, n_classes, n_gears, ring = grid.side, len(grid.bins), grid.n_gears, len(heads)
    i0, k0 = int(x / grid.fine) - side // 2, int(y / grid.fine) - side // 2
    n_queued = _begin(i0, k0, need, missing, grid, value, queue, following, heads)
    units, empty = 0, 0
    at_car = ((side // 2 * side + side // 2) * n_classes + here) * n_gears + mode
    while empty < ring and value[at_car] + BEYOND >= units:
        entry = heads[units % ring]
        heads[units % ring] = -1
        empty = empty + 1 if entry < 0 else 0
        while entry >= 0:
            state = queue[entry]
            entry = following[entry]
            if value[state] != units:
                continue  # reached earlier
            g, pose = state % n_gears, state // n_gears
            c, point = pose % n_classes, pose // n_classes
            phase = ((point // side) * 5 + (point % side) * 3 + c * 7) % PHASES
            for j in range(len(grid.gear)):
                if grid.gear[j] != g:
                    continue
                before = state - g + grid.back[phase, c, j]
                for own in range(n_gears):
                    later = units + grid.cost[j] + (grid.pause if own != g else 0)
                    if later < value[before + own] and n_queued < len(queue):
                        value[before + own] = later
                        queue[n_queued] = before + own
                        following[n_queued] = heads[later % ring]
                        heads[later % ring] = n_queued
                        n_queued += 1
        units += 1
    return i0, k0


@inner_kernel
def _begin(
    i0: int,
    k0: int,
    need: Bools,
    missing: Ints,
    grid: Lattice,
    value: Units,
    queue: NDArray[np.int32],
    following: NDArray[np.int32],
    heads: NDArray[np.int32],
) -> int:
    """Start the wave in every missing bin of the window whose (0, 0) is point (i0, k0); return the count of entries.

    Points that are not free, and the window's rim, are nearer than any wave can come.
    """
    side, n_classes, n_gears, (n, m) = grid.side, len(grid.bins), grid.n_gears, grid.free.shape
    value[:] = -1
    heads[:] = -1
    n_queued = 0
    for i in range(max(RIM, -i0), min(side - RIM, n - i0)):
        for k in range(max(RIM, -k0), min(side - RIM, m - k0)):
            ci, ck = (i + i0) // POINTS, (k + k0) // POINTS
            if not grid.free[i + i0, k + k0]:
                continue
            first = (i * side + k) * n_classes * n_gears
            value[first : first + n_classes * n_gears] = FARTHEST
            if missing[ci, ck] == 0:
                continue
            for c in range(n_classes):
                if need[ci, ck, grid.bins[c]]:
                    for g in range(n_gears):
                        state = first + c * n_gears + g
                        value[state] = 0
                        queue[n_queued] = state
                        following[n_queued] = heads[0]
                        heads[0] = n_queued
                        n_queued += 1
    return n_queued
