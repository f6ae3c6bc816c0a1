"""Space and surface observed so far, and the gain of another scan, for views and the order anytime.

The gain of a pose is the sum over its rays k of

    weight_k (SPACE_WORTH min(unknown_k, 1) + hit_k / (1 + surface_k)).

Here unknown_k [m] is the length of the ray in space that fewer than `MIN_RAYS` rays have crossed, and surface_k is
the number of earlier hits on its surface cell.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from logs.run import RangeSensor
from planners.arena import Arena
from planners.kernel import outer_kernel
from sensorgraph.evaluation.evaluate import poses_for
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.base import Prediction
from sensorgraph.types import Floats
from sensorgraph.world.raycast import cast, laser_poses

SPACE_CELL = 0.05
"""[m] Side of a cell of space."""
SURFACE_CELL = 0.02
"""[m] Side of a cell of surface."""
MIN_RAYS = 3
"""Number of rays through a cell of space after which it is known."""
SPACE_WORTH = 2.0
"""Gain per metre of unknown space on a ray, up to one metre."""
MIN_RAY_WEIGHT = 0.02
"""Minimum weight of an answered ray; an unanswered one has 1."""
Worth = Callable[[Floats], Floats]
"""Poses (n, 3) of base_link -> weight of each ray (n, n_rays), 0 or more."""


class LaserSurvey:
    """Space crossed and surface hit by the expected scans in a map; implements `planners.task.Survey`."""

    def __init__(self, arena: Arena, sensor: RangeSensor, worth: Worth | None = None) -> None:
        """Start with nothing observed.

        Parameters
        ----------
        worth : Weight of each ray; None: 1.
        """
        self.arena, self.sensor, self.worth = arena, sensor, worth
        far = sensor.range_max + float(np.hypot(*sensor.mount[:2])) + 1.0
        self.low = np.array(arena.bounds[:2]) - far
        size = np.array(arena.bounds[2:]) + far - self.low
        self.space = np.zeros(np.ceil(size / SPACE_CELL).astype(int) + 1, dtype=np.uint8)
        self.surface = np.zeros(np.ceil(size / SURFACE_CELL).astype(int) + 1, dtype=np.uint16)
        self._weights: dict[bytes, Floats] = {}

    def gain(self, poses: Floats) -> Floats:
        """Return the gain (n,) of one scan at each pose (n, 3) [m, m, rad]."""
        return self._scan(poses, self._weight(poses), False)

    def mark(self, poses: Floats) -> None:
        """Mark the space and surface of scans at poses (n, 3) [m, m, rad] as observed."""
        self._scan(poses, np.ones((len(poses), self.sensor.n_rays)), True)

    def copy(self) -> LaserSurvey:
        """Return a copy that can be marked independently."""
        other = LaserSurvey.__new__(LaserSurvey)
        other.__dict__.update(self.__dict__)
        other.space, other.surface = self.space.copy(), self.surface.copy()
        return other

    def _weight(self, poses: Floats) -> Floats:
        """Return the weight of each ray (n, n_rays); a sensorgraph is queried once per pose."""
        if self.worth is None:
            return np.ones((len(poses), self.sensor.n_rays))
        keys = [pose.tobytes() for pose in poses]
        fresh = [k for k, key in enumerate(keys) if key not in self._weights]
        if fresh:
            self._weights |= zip([keys[k] for k in fresh], self.worth(poses[fresh]), strict=True)
        return np.array([self._weights[key] for key in keys])

    def _scan(self, poses: Floats, weight: Floats, mark: bool) -> Floats:
        if not len(poses):
            return np.zeros(0)
        ranges = np.clip(cast(self.arena, poses, self.sensor).ranges, 0.0, self.sensor.range_max)
        hit = (ranges > 0) & (ranges < self.sensor.range_max)
        lasers = laser_poses(poses, self.sensor.mount)
        theta = lasers[:, 2, None] + self.sensor.bearings
        cos, sin, at = np.cos(theta), np.sin(theta), lasers[:, :2] - self.low
        return np.array(
            [
                gain_of_scan(
                    at[i], cos[i], sin[i], ranges[i], hit[i], weight[i], self.space, self.surface, mark
                )
                for i in range(len(poses))
            ]
        )


def survey_of(arena: Arena, sensor: RangeSensor, graph: Sensorgraph | None = None) -> LaserSurvey:
    """Return a survey with nothing observed.

    Parameters
    ----------
    graph : Sensorgraph; the weight of a ray is its expected error. None: equal weights.
    """
    if graph is None:
        return LaserSurvey(arena, sensor)
    known = graph

    def worth(poses: Floats) -> Floats:
        return uncertainty_of(known.predict(poses_for(known, "base_link", known.sensor.mount, poses)))

    return LaserSurvey(arena, known.sensor, worth)


def uncertainty_of(prediction: Prediction) -> Floats:
    """Return the weight (n_poses, n_rays) of each ray: 1 if unanswered, otherwise its probability of an error."""
    return np.asarray(
        np.where(prediction.answered, np.maximum(prediction.p_off, MIN_RAY_WEIGHT), 1.0), dtype=np.float64
    )


@outer_kernel
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
