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
from planners.arena import Arena
from planners.errors import PlanError
from planners.kernel import kernel
from planners.reach import Reach
from sensorgraph.evaluation.evaluate import poses_for
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.base import Prediction
from sensorgraph.types import Floats, Ints, Progress
from sensorgraph.world.raycast import cast as cast_arena
from sensorgraph.world.raycast import laser_poses

SPACE_CELL = 0.05  # [m] cell of crossed space
SURFACE_CELL = 0.02  # [m] cell of surface
MIN_RAYS = 3  # rays through a cell of space that make it known
SPACE_WORTH = 2.0  # of a metre of unknown space on a ray, up to one metre
N_CANDIDATES = 2500  # poses to choose from, or
CANDIDATES_PER_VIEW = 5  # so many for each view, if that is more
MIN_RAY_WEIGHT = 0.02  # what a ray counts at least, of one that nobody can answer yet

Caster = Callable[[Floats], Floats]
"""Poses (n, 3) of base_link -> ranges (n, n_rays) [m]; inf where nothing would be seen."""


def views_within(
    reach: Reach,
    n: int,
    *,
    arena: Arena,
    sensor: RangeSensor,
    graph: Sensorgraph | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Floats:
    """Choose n poses (n, 3) [m, m, rad] of base_link where the robot can be, the most telling first.

    Parameters
    ----------
    graph : expect to see what it says, and let a ray count by how little it knows of it; None: cast from `arena`
    """
    if n < 1:
        raise PlanError(f"{n} views are asked for, expected 1 or more")
    rng = np.random.default_rng(seed)
    nodes = np.nonzero(reach.mask)
    pick = rng.integers(len(nodes[0]), size=max(N_CANDIDATES, CANDIDATES_PER_VIEW * n))
    places = reach.nodes((nodes[0][pick], nodes[1][pick]))
    candidates = np.column_stack([places, rng.uniform(-np.pi, np.pi, len(places))])
    if graph is None:
        chosen = choose_views(
            candidates, lambda poses: cast_arena(arena, poses, sensor).ranges, sensor, n, progress=progress
        )
        return candidates[chosen]
    known = graph

    def said(poses: Floats) -> Prediction:
        return known.predict(poses_for(known, "base_link", known.sensor.mount, poses))

    chosen = choose_views(
        candidates,
        lambda poses: said(poses).ranges,
        known.sensor,
        n,
        worth=lambda poses: uncertainty_of(said(poses)),
        progress=progress,
    )
    return candidates[chosen]


def uncertainty_of(said: Prediction) -> Floats:
    """Return (n_poses, n_rays) what a look along each ray is worth: 1 where unanswered, else its chance of being off."""
    return np.asarray(np.where(said.answered, np.maximum(said.p_off, MIN_RAY_WEIGHT), 1.0), dtype=np.float64)


def choose_views(
    candidates: Floats,
    cast: Caster,
    sensor: RangeSensor,
    n: int,
    *,
    worth: Caster | None = None,
    progress: Progress | None = None,
) -> Ints:
    """Choose n of the candidates (n_candidates, 3), the most telling first; return their indices.

    Parameters
    ----------
    cast : what is expected to be seen: of the map, or the mode of a sensorgraph
    worth : what a ray counts, poses (n, 3) -> (n, n_rays), 0 or more; None: 1
    """
    n = min(n, len(candidates))
    ranges = np.clip(cast(candidates), 0.0, sensor.range_max)
    weight = np.ones_like(ranges) if worth is None else worth(candidates)
    lasers = laser_poses(candidates, sensor.mount)
    reach = float(ranges.max(initial=1.0)) + 1.0
    low = lasers[:, :2].min(axis=0) - reach
    high = lasers[:, :2].max(axis=0) + reach
    space = np.zeros(np.ceil((high - low) / SPACE_CELL).astype(int) + 1, dtype=np.uint8)
    surface = np.zeros(np.ceil((high - low) / SURFACE_CELL).astype(int) + 1, dtype=np.uint16)
    hit = (ranges > 0) & (ranges < sensor.range_max)
    theta = lasers[:, 2, None] + sensor.bearings
    cos, sin = np.cos(theta), np.sin(theta)

    def gain(i: int, mark: bool) -> float:
        return float(
            gain_of_scan(
                lasers[i, :2] - low, cos[i], sin[i], ranges[i], hit[i], weight[i], space, surface, mark
            )
        )

    heap = [(-gain(i, False), i) for i in range(len(candidates))]
    heapq.heapify(heap)
    chosen: list[int] = []
    while len(chosen) < n:
        _, i = heapq.heappop(heap)
        now = gain(i, False)
        if heap and now < -heap[0][0]:
            heapq.heappush(heap, (-now, i))
            continue
        gain(i, True)
        chosen.append(i)
        if progress is not None:
            progress(len(chosen), n)
    return np.array(chosen, dtype=np.intp)


@kernel
def gain_of_scan(
    at: Floats,
    cos: Floats,
    sin: Floats,
    ranges: Floats,
    hit: Floats,
    weight: Floats,
    space: Floats,
    surface: Floats,
    mark: bool,
) -> float:
    """Add up what the rays of one pose would add; note them if `mark`."""
    total = 0.0
    for k in range(len(ranges)):
        steps = int(ranges[k] / SPACE_CELL)
        unknown = 0.0
        for m in range(steps):
            s = (m + 0.5) * SPACE_CELL
            i, j = int((at[0] + s * cos[k]) / SPACE_CELL), int((at[1] + s * sin[k]) / SPACE_CELL)
            if space[i, j] < MIN_RAYS:
                unknown += SPACE_CELL
                if mark:
                    space[i, j] += 1
            if unknown >= 1.0 and not mark:
                break
        total += weight[k] * SPACE_WORTH * min(unknown, 1.0)
        if hit[k]:
            i = int((at[0] + ranges[k] * cos[k]) / SURFACE_CELL)
            j = int((at[1] + ranges[k] * sin[k]) / SURFACE_CELL)
            total += weight[k] / (1.0 + surface[i, j])
            if mark and surface[i, j] < 65535:
                surface[i, j] += 1
    return total
