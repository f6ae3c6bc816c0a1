"""Drive a plan in this MuJoCo world and record it: python drive.py PLAN -o run.mcap

It needs sensorgraph and MuJoCo: pip install 'mujoco>=3.2'
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

try:
    import mujoco
except ImportError:
    raise SystemExit("error: drive.py needs MuJoCo; install it with: pip install 'mujoco>=3.2'") from None

from sensorgraph.cli.twin import run_script
from sensorgraph.world.robot import load_robot

HERE = Path(__file__).parent
WALLS = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)
"""Mask of the geom group that the laser sees."""
SETTLE = 0.5
"""[s] Time in which the robot settles on its wheels after placement."""


class MujocoWorld:
    """The MuJoCo scene, driven by twists."""

    name = f"MuJoCo {mujoco.__version__}"

    def __init__(self, folder: Path = HERE) -> None:
        self.robot = load_robot(folder / "robot.yaml")
        self.model = mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR  # rays are cast on demand
        self.data = mujoco.MjData(self.model)
        self.has_motors = self.model.nu == 2  # a car has a planar joint instead

    def place(self, pose: np.ndarray) -> None:
        """Put the robot at a pose, at rest."""
        mujoco.mj_resetData(self.model, self.data)
        self.heading = float(pose[2])
        if not self.has_motors:
            self.shift(pose)
            return
        self.data.qpos[:2] = pose[:2]
        self.data.qpos[3:7] = [np.cos(pose[2] / 2), 0.0, 0.0, np.sin(pose[2] / 2)]
        mujoco.mj_step(self.model, self.data, round(SETTLE / self.model.opt.timestep))

    def step(self, v: float, omega: float, duration: float) -> tuple[np.ndarray, np.ndarray]:
        """Move for `duration` [s]; return the pose, phi not wrapped, and the twist of the wheels."""
        n = round(duration / self.model.opt.timestep)
        if not self.has_motors:
            return self._slide(np.array([v, omega]), duration)
        radius, base = self.robot.wheels.radius, self.robot.wheels.base
        self.data.ctrl[:] = [(v - omega * base / 2) / radius, (v + omega * base / 2) / radius]
        mujoco.mj_step(self.model, self.data, n)
        left, right = (self.data.joint(f"{side}_wheel").qvel[0] * radius for side in ("left", "right"))
        w, x, y, z = self.data.qpos[3:7]
        phi = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        self.heading += np.remainder(phi - self.heading + np.pi, 2 * np.pi) - np.pi
        pose = np.array([self.data.qpos[0], self.data.qpos[1], self.heading])
        return pose, np.array([(left + right) / 2, (right - left) / base])

    def shift(self, pose: np.ndarray) -> None:
        """Move the body to a nearby pose, while its wheels keep turning."""
        if not self.has_motors:
            self.data.qpos[:3] = pose - [*self.model.body("base_link").pos[:2], 0.0]
            return
        turn, axis = pose[2] - self.heading, np.array([0.0, 0.0, 1.0])
        rotation, before = np.zeros(4), self.data.qpos[3:7].copy()
        mujoco.mju_axisAngle2Quat(rotation, axis, turn)
        mujoco.mju_mulQuat(self.data.qpos[3:7], rotation, before)
        mujoco.mju_rotVecQuat(self.data.qvel[:3], self.data.qvel[:3].copy(), rotation)
        self.data.qpos[:2], self.heading = pose[:2], float(pose[2])

    def _slide(self, twist: np.ndarray, duration: float) -> tuple[np.ndarray, np.ndarray]:
        """Move a car: its body follows the direction of its wheels."""
        step = self.model.opt.timestep
        for _ in range(round(duration / step)):
            phi = self.data.qpos[2] + twist[1] * step / 2
            self.data.qvel[:3] = [twist[0] * np.cos(phi), twist[0] * np.sin(phi), twist[1]]
            mujoco.mj_step(self.model, self.data)
        start = self.model.body("base_link").pos[:2]
        return np.array([*(self.data.qpos[:2] + start), self.data.qpos[2]]), twist

    def cast(self, ox: np.ndarray, oy: np.ndarray, ux: np.ndarray, uy: np.ndarray) -> np.ndarray:
        """Return the ranges of rays at the laser's height; inf without a hit."""
        height, hit = self.robot.sensor.height, np.zeros(1, dtype=np.int32)
        origin, way = np.array([0.0, 0.0, height]), np.zeros(3)
        out = np.full(ox.size, np.inf)
        mujoco.mj_kinematics(self.model, self.data)
        for i, (x, y, dx, dy) in enumerate(zip(ox.flat, oy.flat, ux.flat, uy.flat, strict=True)):
            origin[:2], way[:2] = (x, y), (dx, dy)
            r = mujoco.mj_ray(self.model, self.data, origin, way, WALLS, 1, -1, hit)
            if r >= 0:
                out[i] = r
        return out.reshape(ox.shape)


if __name__ == "__main__":
    run_script(HERE, MujocoWorld, "scene.xml")
