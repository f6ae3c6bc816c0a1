"""Views: the few poses that show most surface, chosen greedily; where to scan when time is short.

A pose is worth what its rays would add: space that no chosen ray has crossed, and surface that few have hit.
Both saturate, so the gain of a pose only falls as others are chosen (it is submodular) and a heap of stale gains
gives the greedy choice without rescoring every candidate (Minoux 1978).
"""

from __future__ import annotations

import heapq
from collections.abc import Callable

import numpy as np

from logs.run import RangeSensor
from sensorgraph.models.base import Floats, Ints, Progress
from sensorgraph.models.kernel import kernel
from sensorgraph.world.raycast import laser_poses

SPACE = 0.05  # [m] cell of crossed space
SURFACE = 0.02  # [m] cell of surface
SEEN = 3  # rays through a cell of space that make it known
SPACE_WORTH = 2.0  # of a metre of unknown space on a ray, up to one metre

Caster = Callable[[Floats], Floats]
"""Poses (n, 3) of base_link -> ranges (n, n_rays) [m]; inf where nothing would be seen."""


def choose_views(
    candidates: Floats, cast: Caster, sensor: RangeSensor, n: int, *, progress: Progress | None = None
) -> Ints:
    """Choose n of the candidates (n_candidates, 3), the most telling first; return their indices.

    Parameters
    ----------
    cast : what is expected to be seen: of the map, or the mode of a sensorgraph
    """
    n = min(n, len(candidates))
    ranges = np.minimum(cast(candidates), sensor.range_max)
    lasers = laser_poses(candidates, sensor.mount)
    reach = float(ranges.max(initial=1.0)) + 1.0
    low = lasers[:, :2].min(axis=0) - reach
    high = lasers[:, :2].max(axis=0) + reach
    space = np.zeros(np.ceil((high - low) / SPACE).astype(int) + 1, dtype=np.uint8)
    surface = np.zeros(np.ceil((high - low) / SURFACE).astype(int) + 1, dtype=np.uint16)
    hit = ranges < sensor.range_max
    theta = lasers[:, 2, None] + sensor.bearings
    cos, sin = np.cos(theta), np.sin(theta)

    def gain(i: int, mark: bool) -> float:
        return float(_gain(lasers[i, :2] - low, cos[i], sin[i], ranges[i], hit[i], space, surface, mark))

    heap = [(-gain(i, False), i) for i in range(len(candidates))]
    heapq.heapify(heap)
    chosen: list[int] = []
    while len(chosen) < n:
        _, i = heapq.heappop(heap)
        worth = gain(i, False)
        if heap and worth < -heap[0][0]:
            heapq.heappush(heap, (-worth, i))
            continue
        gain(i, True)
        chosen.append(i)
        if progress is not None:
            progress(len(chosen), n)
    return np.array(chosen, dtype=np.intp)


@kernel
def _gain(
    at: Floats,
    cos: Floats,
    sin: Floats,
    ranges: Floats,
    hit: Floats,
    space: Floats,
    surface: Floats,
    mark: bool,
) -> float:
    """Add up what the rays of one pose would add; note them if `mark`."""
    total = 0.0
    for k in range(len(ranges)):
        steps = int(ranges[k] / SPACE)
        unknown = 0.0
        for m in range(steps):
            s = (m + 0.5) * SPACE
            i, j = int((at[0] + s * cos[k]) / SPACE), int((at[1] + s * sin[k]) / SPACE)
            if space[i, j] < SEEN:
                unknown += SPACE
                if mark:
                    space[i, j] += 1
            if unknown >= 1.0 and not mark:
                break
        total += SPACE_WORTH * min(unknown, 1.0)
        if hit[k]:
            i = int((at[0] + ranges[k] * cos[k]) / SURFACE)
            j = int((at[1] + ranges[k] * sin[k]) / SURFACE)
            total += 1.0 / (1.0 + surface[i, j])
            if mark and surface[i, j] < 65535:
                surface[i, j] += 1
    return total
