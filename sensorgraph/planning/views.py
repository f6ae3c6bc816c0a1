"""Views: the poses that show most surface, chosen greedily, for scans when time is short.

The gain of a pose is the sum over its rays k of

    weight_k (SPACE_WORTH min(unknown_k, 1) + hit_k / (1 + surface_k)).

Here unknown_k [m] is the length of the ray in space that fewer than `MIN_RAYS` chosen rays have crossed, and
surface_k is the number of earlier hits on its surface cell. The gain of a pose can only decrease when others
are chosen (it is submodular). So a heap of outdated gains gives the greedy choice without a new evaluation of
every candidate (Minoux 1978).
"""

from __future__ import annotations

import heapq
from collections.abc import Callable

import numpy as np

from logs.run import RangeSensor
from planners.arena import Arena
from planners.errors import PlanError
from planners.kernel import kernel
from planners.methods.overview import N_CANDIDATES
from planners.reach import Reach
from sensorgraph.evaluation.evaluate import poses_for
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.base import Prediction
from sensorgraph.types import Floats, Ints, Progress
from sensorgraph.world.raycast import cast as cast_arena
from sensorgraph.world.raycast import laser_poses

SPACE_CELL = 0.05  # [m] side of a cell of space
SURFACE_CELL = 0.02  # [m] side of a cell of surface
MIN_RAYS = 3  # number of rays through a cell of space after which it is known
SPACE_WORTH = 2.0  # gain per metre of unknown space on a ray, up to one metre
CANDIDATES_PER_VIEW = 5  # minimum number of candidate poses for each view
MIN_RAY_WEIGHT = 0.02  # minimum weight of an answered ray; an unanswered one has 1

Caster = Callable[[Floats], Floats]
"""Poses (n, 3) of base_link -> ranges (n, n_rays) [m]; inf without a hit."""


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
    """Choose n poses (n, 3) [m, m, rad] of base_link that the robot can reach, in order of decreasing gain.

    Parameters
    ----------
    graph : Sensorgraph that predicts the scans and weights each ray by its expected error; None: scans are
        cast in `arena`.
    """
    if n < 1:
        raise PlanError(f"`views` is {n}, expected 1 or more")
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

    def predicted(poses: Floats) -> Prediction:
        return known.predict(poses_for(known, "base_link", known.sensor.mount, poses))

    chosen = choose_views(
        candidates,
        lambda poses: predicted(poses).ranges,
        known.sensor,
        n,
        worth=lambda poses: uncertainty_of(predicted(poses)),
        progress=progress,
    )
    return candidates[chosen]


def uncertainty_of(prediction: Prediction) -> Floats:
    """Return the weight (n_poses, n_rays) of each ray: 1 if unanswered, otherwise its probability of an error."""
    return np.asarray(
        np.where(prediction.answered, np.maximum(prediction.p_off, MIN_RAY_WEIGHT), 1.0), dtype=np.float64
    )


def choose_views(
    candidates: Floats,
    cast: Caster,
    sensor: RangeSensor,
    n: int,
    *,
    worth: Caster | None = None,
    progress: Progress | None = None,
) -> Ints:
    """Return the indices of n of the candidates (n_candidates, 3), in order of decreasing gain.

    Parameters
    ----------
    cast : Expected ranges, from the map or as the mode of a sensorgraph.
    worth : Weight of each ray, poses (n, 3) -> (n, n_rays), 0 or more; None: 1.
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
    """Return the gain of the scan at one pose; update space and surface if `mark`."""
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
