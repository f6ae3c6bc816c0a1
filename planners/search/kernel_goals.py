"""Compiled kernels that beam search and nearest-goal search share: distances to missing bins, and safe ends."""

from __future__ import annotations

import numpy as np

from planners.kernel import inner_kernel, kernel
from planners.search.kernel_world import PrimitiveArrays, SearchWorld, is_safe
from planners.search.workspace import BeamSettings
from planners.types import Floats, Ints


@kernel
def is_safe_cached(
    x: float,
    y: float,
    h: int,
    m: int,
    settings: BeamSettings,
    world: SearchWorld,
    primitives: PrimitiveArrays,
    covered: Ints,
) -> bool:
    """Tell whether a state is safe. Unsafe ones are remembered: in a pocket the test takes thousands of tries."""
    if world.trapped.size == 1:
        return is_safe(x, y, h, m, settings.safe_depth, world, primitives, covered)
    i, k = int((x - world.x0) / settings.lattice), int((y - world.y0) / settings.lattice)
    if world.trapped[i, k, h]:
        return False
    world.trapped[i, k, h] = not is_safe(x, y, h, m, settings.safe_depth, world, primitives, covered)
    return not world.trapped[i, k, h]


@inner_kernel
def cell_distance(x: float, y: float, world: SearchWorld, far: Ints) -> int:
    """Return the count of cell borders from a place to the nearest cell with a missing bin."""
    return int(far[int((x - world.x0) / world.cell), int((y - world.y0) / world.cell)])


@inner_kernel
def cell_distances(world: SearchWorld, far: Ints, queue: Ints) -> None:
    """Fill `far (nx, ny)` with the count of cell borders to the nearest cell with a missing bin, by a grassfire from all."""
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


@kernel
def smallest_first(costs: Floats, most: int) -> Ints:
    """Return the indices of the `most` least costs of (n,), or a few more if they tie, in ascending order."""
    if len(costs) <= most:
        return np.argsort(costs, kind="mergesort")
    few = np.flatnonzero(costs <= np.partition(costs, most)[most])
    return few[np.argsort(costs[few], kind="mergesort")]
