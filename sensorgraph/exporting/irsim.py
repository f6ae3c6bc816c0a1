"""ir-sim: world.yaml with walls as lines, a disc-shaped robot and its lidar; drive.py records."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from sensorgraph.exporting.world import ExportedWorld
from sensorgraph.world.drive import TRUTH_STEP
from sensorgraph.world.robot_sensor import bearings as even_bearings

MARGIN = 0.5
"""[m] Margin around the arena."""


def write(world: ExportedWorld, folder: Path) -> list[str]:
    """Write world.yaml; return what it leaves out, one line each."""
    robot, sensor = world.robot, world.robot.sensor
    x0, y0, x1, y1 = world.arena.bounds
    left_out = []
    laser: dict[str, Any] = {}
    fov = float(sensor.bearings[-1] - sensor.bearings[0])
    if sensor.is_composite or not np.allclose(sensor.bearings, even_bearings(sensor.n_rays, fov), atol=1e-6):
        left_out.append(
            "the robot's bearings: ir-sim's lidar is symmetric with even steps; drive.py casts the robot's rays"
        )
    else:
        laser = {
            "name": "lidar2d",
            "range_min": float(sensor.range_min),
            "range_max": float(sensor.range_max),
            "angle_range": fov,
            "number": int(sensor.n_rays),
            "noise": sensor.sigma > 0,
            "std": float(sensor.sigma),
            "offset": [float(value) for value in world.mount],
        }
    if robot.drive != "diff":
        left_out.append(
            f"the {robot.drive} car: the robot turns in place; drive.py commands only motions of the car"
        )
    limits = robot.limits
    data: dict[str, Any] = {
        "world": {
            "width": float(x1 - x0 + 2 * MARGIN),
            "height": float(y1 - y0 + 2 * MARGIN),
            "offset": [float(x0 - MARGIN), float(y0 - MARGIN)],
            "step_time": TRUTH_STEP,
            "sample_time": 0.1,
            "collision_mode": "stop",
        },
        "robot": [
            {
                "name": robot.name,
                "kinematics": {"name": "diff"},
                "shape": {"name": "circle", "radius": float(robot.footprint_radius)},
                "state": [float(value) for value in world.start],
                "vel_min": [-float(limits.v), -float(limits.omega)],
                "vel_max": [float(limits.v), float(limits.omega)],
                **({"sensors": [laser]} if laser else {}),
            }
        ],
        "obstacle": [
            {
                "name": name.replace("/", "_"),
                "shape": {"name": "linestring", "vertices": wall.tolist()},
                "state": [0, 0, 0],
                "unobstructed": False,
            }
            for name, wall in zip(world.names, world.walls, strict=True)
        ]
        + [
            {"shape": {"name": "circle", "radius": float(r)}, "state": [float(x), float(y), 0.0]}
            for x, y, r in world.discs
        ],
    }
    (folder / "world.yaml").write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return left_out
