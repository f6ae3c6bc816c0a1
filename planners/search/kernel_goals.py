"""Compiled kernels that beam search and nearest-goal search share: distances to missing bins, and safe ends."""

from __future__ import annotations

from planners.kernel import inner_kernel, outer_kernel
from planners.search.kernel_world import LATTICE, SearchWorld, find_escape
from planners.search.workspace import SearchTables
from planners.types import Ints


@inner_kernel
def is_safe(x: float, y: float, h: int, m: int, tables: SearchTables) -> bool:
    """Return whether the robot can go on from a state, or stop.

    Unsafe states are cached: in a dead end, each test takes thousands of tries.
    """
    _, world, primitives, workspace = tables
    remembered = world.trapped.size > 1
    i, k = 0, 0
    if remembered:
        i, k = int((x - world.x0) / LATTICE), int((y - world.y0) / LATTICE)
        if world.trapped[i, k, h]:
            return False
    safe = bool(find_escape(x, y, h, m, primitives.safe_depth, world, primitives, workspace.scratch) >= 0)
    if remembered:
        world.trapped[i, k, h] = not safe
    return safe


@inner_kernel
def cell_distance(x: float, y: float, world: SearchWorld, far: Ints) -> int:
    """Return the number of cell borders from a place to the nearest cell with a missing bin."""
    return int(far[int((x - world.x0) / world.cell), int((y - world.y0) / world.cell)])


@outer_kernel
def cell_distances(world: SearchWorld, far: Ints, queue: Ints) -> None:
    """Fill `far (nx, ny)` with the number of cell borders to the nearest cell with a missing bin.

        The recurrence is far[c] = 0 in cells with a missing bin, else 1 + min far over the neighbours with an
        open border. It is solved by breadth-first search from all cells with a missing bin (grassfire transform, H. Blum
    1967).
    """
    missing, open_borders = world.missing, world.open_borders
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
            if open_borders[i, k] & (1 << d):
                ni = i + (1, -1, 0, 0, 1, 1, -1, -1)[d]
                nk = k + (0, 0, 1, -1, 1, -1, 1, -1)[d]
                if far[ni, nk] > far[i, k] + 1:
                    far[ni, nk] = far[i, k] + 1
                    queue[tail] = ni * ny + nk
                    tail += 1
