"""Drive a plan in this ir-sim world and record it: python drive.py PLAN -o run.mcap

pip install ir-sim sensorgraph
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

os.environ.setdefault("MPLBACKEND", "Agg")
import irsim
from irsim.lib.algorithm.ray_casting_2d import boundary_segments, cast_ray_segments

from sensorgraph.cli.twin import run_script
from sensorgraph.world.robot import load_robot

HERE = Path(__file__).parent
FAR = 1e4
"""[m] nothing is farther."""


class IrsimWorld:
    """The world, driven by twists; motors lag as robot.yaml says, which ir-sim's do not."""

    name = f"ir-sim {irsim.__version__}"

    def __init__(self, folder: Path = HERE) -> None:
        self.description = load_robot(folder / "robot.yaml")
        self.env = irsim.make(
            str(folder / "world.yaml"), headless=True, disable_all_plot=True, log_level="ERROR"
        )
        self.robot = self.env.robot
        parts = [boundary_segments(thing.geometry) for thing in self.env.obstacle_list]
        self.first, self.last = (np.concatenate([part[i] for part in parts]) for i in (0, 1))

    def place(self, pose: np.ndarray) -> None:
        """Put the robot at a pose, at rest."""
        self.robot.set_state(np.c_[pose], init=True)
        self.robot.set_velocity([0.0, 0.0], init=True)
        self.speed, self.heading = np.zeros(2), float(pose[2])

    def step(self, v: float, omega: float, duration: float) -> tuple[np.ndarray, np.ndarray]:
        """Move for a while; return the pose, phi not wrapped, and the twist that the wheels turn with."""
        step, limits = self.env.step_time, self.description.limits
        tau, most = self.description.actuators.tau, np.array([limits.a, limits.alpha])
        share = 1 - np.exp(-step / tau) if tau > 0 else 1.0
        for _ in range(round(duration / step)):
            before = self.speed
            change = (np.array([v, omega]) - before) * share
            self.speed = before + np.clip(change, -most * step, most * step)
            self.robot.step(np.c_[(before + self.speed) / 2])
        x, y, phi = self.robot.state[:3, 0]
        self.heading += np.remainder(phi - self.heading + np.pi, 2 * np.pi) - np.pi
        return np.array([x, y, self.heading]), self.speed.copy()

    def cast(self, ox: np.ndarray, oy: np.ndarray, ux: np.ndarray, uy: np.ndarray) -> np.ndarray:
        """Return the ranges of rays; inf where nothing is."""
        out = np.full(ox.shape, np.inf)
        for i in range(len(ox)):
            origins, ways = np.stack([ox[i], oy[i]], axis=1), np.stack([ux[i], uy[i]], axis=1)
            shared = (
                [slice(None)]
                if np.ptp(origins, axis=0).max() == 0
                else [slice(k, k + 1) for k in range(len(ways))]
            )
            for rays in shared:
                ranges, hit = cast_ray_segments(origins[rays][0], ways[rays], self.first, self.last, FAR)
                out[i, rays] = np.where(hit >= 0, ranges, np.inf)
        return out


if __name__ == "__main__":
    run_script(HERE, IrsimWorld)
