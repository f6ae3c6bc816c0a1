"""Controllers that steer by what the sensor perceives, scan by scan; registry CONTROLLERS."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planners.arena import Bools, Floats
from sensorgraph.world.robot_file import RobotFile

Controller = Callable[[Floats], tuple[float, float]]
"""Readings (n_rays,) [m] -> (v, omega) [m/s, rad/s]."""
NEAR = 0.35
"""[m] beyond the footprint at which a robot turns away from what is ahead."""
BESIDE = 0.30
"""[m] beyond the footprint at which a wall is followed."""
AHEAD = np.radians(30.0)  # half width of what counts as ahead
CRUISE = 0.75  # of the largest speed


class _Reactive:
    """What both controllers share: the way ahead, as the nearest reading in a sector."""

    def __init__(self, robot: RobotFile, seed: int) -> None:
        self.limits, self.radius = robot.robot.limits, robot.robot.footprint_radius
        self.bearings = robot.sensor.bearings + robot.sensor.mount[2]
        self.reach = float(np.hypot(*robot.sensor.mount[:2]))
        self.ahead = np.abs(self.bearings) < AHEAD
        self.rng = np.random.default_rng([seed, 4])

    def nearest(self, readings: Floats, sector: Bools) -> float:
        """Return the nearest reading [m] of a sector, its second lowest: one stray ray steers nothing."""
        values = readings[sector & ~np.isnan(readings)]
        return float(np.partition(values, 1)[1]) if len(values) > 1 else np.inf

    def open_way(self, readings: Floats) -> float:
        """Return how far [m] the footprint can move ahead."""
        return self.nearest(readings, self.ahead) - self.radius + self.reach


class WallFollowing(_Reactive):
    """Keep the wall on the right at an even distance; turn left before what is ahead."""

    def __init__(self, robot: RobotFile, seed: int) -> None:
        super().__init__(robot, seed)
        self.right = (self.bearings < -np.radians(20.0)) & (self.bearings > -np.radians(100.0))

    def __call__(self, readings: Floats) -> tuple[float, float]:
        """Steer by the distance to the right and the way ahead."""
        way = self.open_way(readings)
        if way < NEAR:
            return 0.0, 0.6 * self.limits.omega
        off = self.nearest(readings, self.right) - self.radius - BESIDE
        slow = min((way - NEAR) / 0.5 + 0.2, 1.0)
        turn = float(np.clip(-1.6 * off, -0.5, 0.5)) * self.limits.omega
        return CRUISE * self.limits.v * slow, turn


class RandomBounce(_Reactive):
    """Drive straight; before an obstacle turn by a random angle, on until the way is open."""

    def __init__(self, robot: RobotFile, seed: int) -> None:
        super().__init__(robot, seed)
        self.period = 1.0 / robot.sensor.rate
        self.left = 0.0  # [rad] still to turn
        self.side = 1.0

    def __call__(self, readings: Floats) -> tuple[float, float]:
        """Steer by the way ahead."""
        way = self.open_way(readings)
        if self.left <= 0 and way < NEAR:
            self.left = float(self.rng.uniform(np.pi / 3, np.pi))
            self.side = 1.0 if self.rng.random() < 0.5 else -1.0
        if self.left > 0:
            rate = 0.6 * self.limits.omega
            self.left -= rate * self.period
            if self.left <= 0 and way < NEAR:
                self.left = rate * self.period
            return 0.0, self.side * rate
        return CRUISE * self.limits.v, 0.0


CONTROLLERS: dict[str, Callable[[RobotFile, int], Controller]] = {
    "wall_following": WallFollowing,
    "random_bounce": RandomBounce,
}
"""Name -> (robot, seed) -> controller."""
