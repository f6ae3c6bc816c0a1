"""Space and surface observed so far, and the gain of another scan, for the order anytime."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from logs.run import RangeSensor
from planners.arena import Arena
from sensorgraph.evaluation.evaluate import poses_for
from sensorgraph.graph import Sensorgraph
from sensorgraph.planning.views import SPACE_CELL, SURFACE_CELL, gain_of_scan, uncertainty_of
from sensorgraph.types import Floats
from sensorgraph.world.raycast import cast, laser_poses

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
        """Return the gain (n,) of one scan at each pose (n, 3) [m, m, rad] (see `views.gain_of_scan`)."""
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
