"""Drive one controller many times at once in an identified world, each time with another robot, sensor or obstacle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from logs.transforms import compose
from robotmodic_ident import Narmax
from sensorgraph.identification.population_drive import MOTION_STEP, ClosedLoopPopulation
from sensorgraph.types import Floats, Progress

OBSTACLE_RADIUS = 0.15
"""[m] Radius of the disc that protrudes from a wall."""
MIN_TURNED = 2.0 * np.pi
"""[rad] Minimum turn around the centre of the floor for a lap time."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Varied:
    """Values (n,) of the factors, one per drive."""

    noise: Floats
    """[m] Standard deviation of noise in addition to that of the graph."""
    scale: Floats
    """Ratio of reading to distance."""
    yaw: Floats
    """[rad] Yaw of the laser in addition to that of the robot."""
    wheels: Floats
    """Ratio of turn rate to command, equal to the assumed wheel base over the true one."""
    tau: Floats
    """[s] Time constant of the motors."""
    delay: Floats
    """[s] Time from a command to its first effect."""
    obstacle: Floats
    """[m] Length by which a disc protrudes from the wall."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WallObstacle:
    """Place of the disc at a wall."""

    wall: Floats
    """(2,) [m] Point of the wall."""
    outward: Floats
    """(2,) Unit vector from the wall into the room."""

    def centres(self, out: Floats) -> Floats:
        """Return the centres (n, 2) [m] of discs that protrude by `out` (n,) [m]."""
        return np.asarray(self.wall + (out - OBSTACLE_RADIUS)[:, None] * self.outward)


@dataclass(frozen=True, kw_only=True, eq=False)
class VariedDrives:
    """Quantities and tracks of the drives."""

    quantities: Mapping[str, Floats]
    """Quantity of behaviour -> values (n,)."""
    tracks: Floats
    """(n_scans, n, 3) [m, m, rad] Poses."""


class VariedPopulation(ClosedLoopPopulation):
    """A world for many robots with different factors."""

    def drive_varied(
        self, controller: Narmax, speed: float, start: Floats, varied: Varied, obstacle: WallObstacle | None,
        middle: Floats, duration: float, progress: Progress | None = None,
    ) -> VariedDrives:  # fmt: skip
        """Drive the controller once for each value of the factors.

        Parameters
        ----------
        controller : Static polynomial of the inputs that returns the turn rate [rad/s].
        start : (3,) [m, m, rad] Start pose of all drives.
        middle : (2,) [m] Centre of the laps.
        """
        robot, n = self.robot, len(varied.noise)
        self.varied, self.discs = varied, None if obstacle is None else obstacle.centres(varied.obstacle)
        poses = np.tile(start, (n, 1)).astype(np.float64)
        command, v, omega = np.zeros(n), np.zeros(n), np.zeros(n)
        steps = max(1, round(1.0 / robot.sensor.rate / MOTION_STEP))
        late = np.round(varied.delay / MOTION_STEP).astype(int)
        waiting = np.zeros((int(late.max()) + 1, n))  # row k: the command k steps ago
        held = np.zeros(n, dtype=np.bool_)
        tracks, turns, contacts = [], np.zeros(n), np.zeros(n)
        n_scans = int(duration * robot.sensor.rate)
        for scan in range(n_scans):
            tracks.append(poses)
            command = self._steered(controller, poses, scan, command)
            for _ in range(steps):
                waiting = np.concatenate([command[None], waiting[:-1]])
                turn = varied.wheels * waiting[late, np.arange(n)]
                v, omega = self._motors(v, omega, speed, turn, varied.tau)
                poses, now = self._moved(poses, v, omega)
                contacts += now & ~held
                held = now
                turns += omega**2 / steps
            if progress is not None:
                progress(scan + 1, n_scans)
        whole = np.array(tracks)
        distance = np.array([self.clearance(xy) for xy in whole[:, :, :2]])
        angle = np.unwrap(np.arctan2(whole[:, :, 1] - middle[1], whole[:, :, 0] - middle[0]), axis=0)
        turned = np.abs(angle[-1] - angle[0])
        lap = np.where(turned >= MIN_TURNED, 2 * np.pi * duration / np.maximum(turned, 1e-9), np.nan)
        found = {
            "wall_distance_m": distance.mean(axis=0),
            "wall_distance_sd_m": distance.std(axis=0),
            "lap_s": lap,
            "turn_rate_rms_rad_s": np.sqrt(turns / n_scans),
            "contacts": contacts,
        }
        return VariedDrives(quantities=found, tracks=whole)

    def _steered(self, controller: Narmax, poses: Floats, scan: int, before: Floats) -> Floats:
        """Return the commanded turn rates (n,); where an input is unknown, repeat the last command."""
        seen = self.perceived(poses, scan, 1)
        known = np.isfinite(seen).all(axis=1)
        columns = {f"{name}(k)": np.nan_to_num(seen[:, j]) for j, name in enumerate(self.inputs)}
        turn = controller.terms.matrix(columns, controller.scale, n=len(poses)) @ controller.theta
        limit = self.robot.limits.omega
        return np.where(known, np.clip(np.clip(turn, *controller.limits), -limit, limit), before)

    def _there(self, poses: Floats) -> Floats:
        there = super()._there(poses)
        there[:, 2] += self.varied.yaw
        return there

    def drawn(self, poses: Floats, uniform: Floats, normal: Floats, scan: int) -> Floats:
        """Draw readings (n, n_rays) of the graph and of the disc, with the scale and the noise of the sensor."""
        out = super().drawn(poses, uniform, normal, scan)
        if self.discs is not None:
            out = np.minimum(out, self._disc_ranges(poses))
        extra = np.random.default_rng([self.seed, 9, scan]).normal(size=len(self.rays))
        return np.maximum(out * self.varied.scale[:, None] + self.varied.noise[:, None] * extra, 0.0)

    def _disc_ranges(self, poses: Floats) -> Floats:
        """Return the distance (n, n_rays) [m] of the disc along each ray; inf if the ray misses it."""
        lasers = compose(poses, self.robot.sensor.mount)
        heading = (lasers[:, 2] + self.varied.yaw)[:, None] + self.bearings
        to = (np.zeros(2) if self.discs is None else self.discs) - lasers[:, :2]
        along = to[:, :1] * np.cos(heading) + to[:, 1:] * np.sin(heading)
        reach = along**2 - (to**2).sum(axis=1)[:, None] + OBSTACLE_RADIUS**2
        near = along - np.sqrt(np.maximum(reach, 0.0))
        return np.where((reach > 0) & (near > 0) & (near < self.robot.sensor.range_max), near, np.inf)

    def clearance(self, xy: Floats) -> Floats:
        """Return the distance (n,) [m] of points (n, 2) to the nearest wall or disc; 0 outside."""
        free = super().clearance(xy)
        if self.discs is None:
            return free
        return np.asarray(
            np.minimum(free, np.maximum(np.hypot(*(xy - self.discs).T) - OBSTACLE_RADIUS, 0.0)),
            dtype=np.float64,
        )
