"""Drive a plan in this ir-sim world and record it: python drive.py PLAN -o run.mcap

It needs sensorgraph and ir-sim: pip install 'ir-sim>=2.10'
"""

from __future__ import annotations

import io
import os
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np

os.environ.setdefault("MPLBACKEND", "Agg")
try:
    with redirect_stdout(io.StringIO()):  # it prints the display libraries that are missing
        import irsim
        from irsim.lib.algorithm.ray_casting_2d import boundary_segments, cast_ray_segments
except ImportError:
    raise SystemExit("error: drive.py needs ir-sim; install it with: pip install 'ir-sim>=2.10'") from None

from sensorgraph.cli.twin import run_script

HERE = Path(__file__).parent
FAR = 1e4
"""[m] Maximum distance of a cast."""


class IrsimWorld:
    """The ir-sim world, driven by twists."""

    name = f"ir-sim {irsim.__version__}"
    has_motors = False

    def __init__(self, folder: Path = HERE) -> None:
        self.env = irsim.make(
            str(folder / "world.yaml"), headless=True, disable_all_plot=True, log_level="ERROR"
        )
        self.robot = self.env.robot
        parts = [boundary_segments(obstacle.geometry) for obstacle in self.env.obstacle_list]
        self.first, self.last = (np.concatenate([part[i] for part in parts]) for i in (0, 1))

    def place(self, pose: np.ndarray) -> None:
        """Put the robot at a pose, at rest."""
        self.robot.set_state(np.c_[pose], init=True)
        self.robot.set_velocity([0.0, 0.0], init=True)
        self.heading = float(pose[2])

    def step(self, v: float, omega: float, duration: float) -> tuple[np.ndarray, np.ndarray]:
        """Move for `duration` [s]; return the pose, phi not wrapped, and the twist."""
        twist = np.array([v, omega])
        for _ in range(round(duration / self.env.step_time)):
            self.robot.step(np.c_[twist])
        x, y, phi = self.robot.state[:3, 0]
        self.heading += np.remainder(phi - self.heading + np.pi, 2 * np.pi) - np.pi
        return np.array([x, y, self.heading]), twist

    def shift(self, pose: np.ndarray) -> None:
        """Move the body to a nearby pose, while its wheels keep turning."""
        self.robot.set_state(np.c_[pose])
        self.heading = float(pose[2])

    def cast(self, ox: np.ndarray, oy: np.ndarray, ux: np.ndarray, uy: np.ndarray) -> np.ndarray:
        """Return the ranges of rays; inf without a hit."""
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
    run_script(HERE, IrsimWorld, "world.yaml")
