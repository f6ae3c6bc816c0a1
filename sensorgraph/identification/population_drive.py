"""Drive many polynomial controllers at once in an identified world, all with the same noise.

Controller: turn = sum_j theta_j term_j(inputs - centres), limited to ± limits.omega.
Motors: v <- v + clip((speed - v) (1 - exp(-dt / tau)), ± a dt).
Motors: omega <- omega + clip((turn - omega) (1 - exp(-dt / tau)), ± alpha dt).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.transforms import compose
from robotmodic_ident import Terms
from sensorgraph.models.faces.model import Faces
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.robot import Robot
from sensorgraph.world.wall_distance import WallDistance

MOTION_STEP = 0.02
"""[s] Time step of the motion between scans."""
RIGHT_OFFSET = 0.2
"""[m] Offset of a second point to the right of the robot, whose wall distance is requested smaller by this offset.

It makes the robot follow the wall instead of circling in front of it.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class PopulationDrive:
    """Quantities of the drives, one value per controller and start."""

    distance_error: Floats
    """(n_controllers, n_starts) [m^2] Mean square error of the wall distance at the robot plus that at its right."""
    turn_change: Floats
    """(n_controllers, n_starts) [rad/s^2] Root mean square change of the turn rate."""
    touching: Floats
    """(n_controllers, n_starts) Share of time in contact with a wall."""


class ClosedLoopPopulation:
    """The world, the robot and the inputs that all controllers share."""

    def __init__(
        self, model: Faces, robot: Robot, walls: WallDistance, inputs: dict[str, Ints], seed: int,
        mount: Floats,
    ) -> None:  # fmt: skip
        """Take inputs as variable -> rays of the graph; `mount` (3,) transforms poses of base_link to the graph's frame."""
        self.model, self.robot, self.inputs, self.seed, self.mount = model, robot, inputs, seed, mount
        self.rays = np.unique(np.concatenate(list(inputs.values())))
        self.columns = {name: np.searchsorted(self.rays, rays) for name, rays in inputs.items()}
        self.bearings = model.sensor.bearings[self.rays]
        self.walls, self.table = walls, np.array(walls.table)

    def perceived(self, poses: Floats, scan: int, n_starts: int) -> Floats:
        """Draw the inputs (n, n_inputs) [m] at poses (n, 3) in one scan; nan where no ray returned."""
        rng = np.random.default_rng([self.seed, 6, scan])
        shape = (n_starts, len(self.rays))
        uniform, normal = rng.random(shape), rng.normal(size=shape)
        times = len(poses) // n_starts
        drawn = self.drawn(poses, np.tile(uniform, (times, 1)), np.tile(normal, (times, 1)), scan)
        hit = np.isfinite(drawn)
        value = np.where(hit, drawn, 0.0)
        out = np.full((len(poses), len(self.inputs)), np.nan)
        for j, columns in enumerate(self.columns.values()):
            count = hit[:, columns].sum(axis=1)
            out[:, j] = np.where(count > 0, value[:, columns].sum(axis=1) / np.maximum(count, 1), np.nan)
        return out

    def drawn(self, poses: Floats, uniform: Floats, normal: Floats, scan: int) -> Floats:
        """Draw readings (n, n_rays) [m] at poses (n, 3) of base_link from random numbers (n, n_rays)."""
        return self.model.draw(self._there(poses), uniform, normal, self.rays)

    def _there(self, poses: Floats) -> Floats:
        return compose(poses, self.mount)

    def clearance(self, xy: Floats) -> Floats:
        """Return the distance (n,) [m] of points (n, 2) to the nearest wall; 0 outside."""
        u = (xy - [self.walls.x0, self.walls.y0]) / self.walls.cell
        inside = (u >= 0).all(axis=1) & (u[:, 0] < self.walls.nx - 1) & (u[:, 1] < self.walls.ny - 1)
        i, j = np.where(inside[:, None], np.floor(u), 0).astype(int).T
        a, b = np.where(inside[:, None], u - np.floor(u), 0).T
        t = self.table
        low = (1 - b) * t[i, j] + b * t[i, j + 1]
        high = (1 - b) * t[i + 1, j] + b * t[i + 1, j + 1]
        return np.where(inside, (1 - a) * low + a * high, 0.0)

    def drive(
        self, terms: Terms, theta: Floats, centres: Floats, starts: Floats, *, speed: float, wall_distance: float,
        duration: float,
    ) -> PopulationDrive:  # fmt: skip
        """Drive each controller from each start.

        Parameters
        ----------
        terms : Terms of the inputs minus their `centres`.
        theta : (n_controllers, n_terms) [rad/s]
        centres : (n_inputs,) [m]
        starts : (n_starts, 3) [m, m, rad]
        """
        robot, n_starts = self.robot, len(starts)
        poses = np.tile(starts, (len(theta), 1)).astype(np.float64)
        weights = np.repeat(theta, n_starts, axis=0)
        n = len(poses)
        names = list(self.inputs)
        command, v, omega = np.zeros(n), np.zeros(n), np.zeros(n)
        waiting = [np.zeros(n)] * (1 + round(robot.actuators.delay / MOTION_STEP))
        n_scans, steps = (
            int(duration * robot.sensor.rate),
            max(1, round(1.0 / robot.sensor.rate / MOTION_STEP)),
        )
        square, change, touch = np.zeros(n), np.zeros(n), np.zeros(n)
        for scan in range(n_scans):
            seen = self.perceived(poses, scan, n_starts) - centres
            known = np.isfinite(seen).all(axis=1)
            phi = terms.matrix({f"{name}(k)": np.nan_to_num(seen[:, j]) for j, name in enumerate(names)}, n=n)
            turn = np.clip((phi * weights).sum(axis=1), -robot.limits.omega, robot.limits.omega)
            turn = np.where(known, turn, command)
            change += ((turn - command) * robot.sensor.rate) ** 2 if scan else 0.0
            command = turn
            for _ in range(steps):
                waiting = [*waiting[1:], command]
                v, omega = self._motors(v, omega, speed, waiting[0], robot.actuators.tau)
                poses, held = self._moved(poses, v, omega)
                touch += held / steps
            right = poses[:, :2] + RIGHT_OFFSET * np.column_stack([np.sin(poses[:, 2]), -np.cos(poses[:, 2])])
            square += (self.clearance(poses[:, :2]) - wall_distance) ** 2
            square += (self.clearance(right) - (wall_distance - RIGHT_OFFSET)) ** 2
        shape = (len(theta), n_starts)
        return PopulationDrive(
            distance_error=(square / n_scans).reshape(shape),
            turn_change=np.sqrt(change / max(n_scans - 1, 1)).reshape(shape),
            touching=(touch / n_scans).reshape(shape),
        )

    def _motors(
        self, v: Floats, omega: Floats, speed: float, turn: Floats, tau: float | Floats
    ) -> tuple[Floats, Floats]:
        """Return the twists one step later: first-order lag of `tau` [s] with limited acceleration."""
        limits, share = self.robot.limits, 1.0 - np.exp(-MOTION_STEP / np.maximum(tau, 1e-9))
        dv, domega = limits.a * MOTION_STEP, limits.alpha * MOTION_STEP
        return (
            v + np.clip((speed - v) * share, -dv, dv),
            omega + np.clip((turn - omega) * share, -domega, domega),
        )

    def _moved(self, poses: Floats, v: Floats, omega: Floats) -> tuple[Floats, Bools]:
        """Return the poses one step later, and which robots are stopped by a wall."""
        turn = omega * MOTION_STEP
        middle = poses[:, 2] + turn / 2
        xy = poses[:, :2] + (v * MOTION_STEP)[:, None] * np.column_stack([np.cos(middle), np.sin(middle)])
        free = self.clearance(xy)
        held = (free < self.robot.footprint_radius) & (free < self.clearance(poses[:, :2]))
        return np.column_stack([np.where(held[:, None], poses[:, :2], xy), poses[:, 2] + turn]), held
