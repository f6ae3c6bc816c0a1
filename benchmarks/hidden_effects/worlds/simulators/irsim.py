"""A case in ir-sim: a flat world with ideal wheels, its own lidar, and people who walk by its own behaviours.

`pip install ir-sim`; nothing is drawn. The world moves in steps of 50 ms, and all that is logged is of one instant.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import irsim
import numpy as np
import yaml

from benchmarks.hidden_effects.case import Case, Spec
from benchmarks.hidden_effects.geometry import Room
from benchmarks.hidden_effects.log import Floats, Log, Odometry
from benchmarks.hidden_effects.worlds.simulators.hidden import (
    EPOCH_NS,
    SIGMA_XY,
    SIGMA_YAW,
    Hidden,
    Secrets,
    as_built,
    bent_by_lens,
    case_of,
    draw_hidden,
    hidden_of,
    seen_by_camera,
    truth,
)
from benchmarks.hidden_effects.worlds.simulators.rooms import OUTER, Pilot, draw_room

ROOT_SEED = 20261123
SUITES = ("none", "singles", "foreign")
STEP = 0.05
DURATION = 80.0
SIGMA = 0.01
MOUNT = (0.1, 0.0, 0.0)
PER_SCAN = 4
"""Steps between two scans: 5 Hz."""


def world_yaml(
    built: Room, start: Floats, secrets: Secrets, n_rays: int, fov: float, people: int
) -> dict[str, Any]:
    """Return the world file of ir-sim."""
    x0, y0 = built.rings[OUTER].min(axis=0) - 1.0
    w, h = built.rings[OUTER].max(axis=0) - [x0, y0] + 1.0
    mount = np.array(MOUNT) + secrets.mount
    lidar = {
        "type": "lidar2d", "range_min": 0.0, "range_max": secrets.value("max_range", "R", 8.0), "angle_range": fov,
        "number": n_rays, "noise": True, "std": SIGMA, "angle_std": secrets.value("beam_jitter", "std"),
        "offset": [float(v) for v in mount],
    }  # fmt: skip
    robot = {
        "kinematics": {"name": "diff"}, "shape": {"name": "circle", "radius": 0.2}, "state": [float(v) for v in start],
        "vel_max": [1.0, 2.0], "vel_min": [-1.0, -2.0], "acce": [math.inf, math.inf], "sensors": [lidar],
    }  # fmt: skip
    walls = [
        {
            "state": [0.0, 0.0, 0.0],
            "shape": {"name": "linestring", "vertices": [[float(x), float(y)] for x, y in (*ring, ring[0])]},
        }
        for ring in built.rings.values()
    ]
    if people:
        middle = built.rings[OUTER].mean(axis=0)
        walls.append(
            {
                "number": people, "kinematics": {"name": "omni"}, "shape": {"name": "circle", "radius": 0.2},
                "distribution": {"name": "manual"}, "behavior": {"name": "dash", "wander": True},
                "state": [[float(middle[0]), float(middle[1]), 0.0]] * people, "goal": [float(x0 + 2), float(y0 + 2), 0],
                "vel_max": [0.7, 0.7], "vel_min": [-0.7, -0.7],
            }
        )  # fmt: skip
    return {
        "world": {
            "height": float(h), "width": float(w), "offset": [float(x0), float(y0)], "step_time": STEP,
            "sample_time": 10.0, "collision_mode": "unobstructed",
        },
        "robot": [robot],
        "obstacle": walls,
    }  # fmt: skip


def make(spec: Spec) -> Case:
    """Make a case."""
    name, n = hidden_of("irsim", spec)
    background = spec.background_in_turn(n)
    dirty = background == "dirty"
    rng = np.random.default_rng([ROOT_SEED, int(spec.kinds == "report"), spec.index, len(spec.suite)])
    room = draw_room(rng)
    n_rays, fov = int(rng.choice([121, 181])), float(rng.choice([np.pi, 4.0]))
    one = _hidden(name, room, rng)
    secrets = Secrets(one)
    built, passable = as_built(room, secrets, rng, dirty=dirty)
    pilot = Pilot(passable, rng)
    start = pilot.start()
    people = round(secrets.value("people", "count"))
    world = world_yaml(built, start, secrets, n_rays, fov, people)
    poses, commands, ranges = _run(world, pilot, rng)
    stamps = STEP * np.arange(len(poses))
    log = _log(stamps, poses, commands, ranges, secrets, room, rng, n_rays, fov, dirty=dirty)
    robot = f"""name: irsim
footprint_radius: 0.2
limits: {{v: 0.4, omega: 1.0, a: 0.5, alpha: 2.0}}
sensor: {{mount: [0.1, 0.0, 0.0], n_rays: {n_rays}, fov: {fov}, range_min: 0.02, range_max: 8.0, sigma: {SIGMA},
  resolution: 0.001, rate: 5.0}}
pose: {{rate: 20.0, sigma_xy: {SIGMA_XY}, sigma_yaw: {SIGMA_YAW}}}
wheels: {{radius: 0.1, base: 0.4, sigma_v: 0.004, sigma_omega: 0.006, rate: 20.0}}
actuators: {{tau: 0.001, delay: 0.0}}
"""
    told = [] if one is None else [truth(one, None)]
    return case_of(spec, room, log, robot, told, seed=ROOT_SEED, background=background)


def _hidden(name: str, room: Room, rng: np.random.Generator) -> Hidden | None:
    if name == "beam_jitter":
        return Hidden(name=name, parameters={"std": float(rng.uniform(0.02, 0.05))})
    return draw_hidden(name, room, rng) if name else None


def _run(world: dict[str, Any], pilot: Pilot, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Let ir-sim move the robot; return poses (n, 3) and commands (n, 2) of every step, and scans."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "world.yaml"
        path.write_text(yaml.safe_dump(world))
        env = irsim.make(
            str(path), display=False, headless=True, log_level="ERROR", seed=int(rng.integers(2**31))
        )
    poses, commands, scans = [], [], []
    for k in range(round(DURATION / STEP)):
        pose = np.asarray(env.robot.state).ravel()[:3].astype(np.float64)
        poses.append(pose)
        if k % PER_SCAN == 0:
            scan = env.get_lidar_scan()
            z = np.asarray(scan["ranges"], dtype=np.float64)
            scans.append(np.where(np.asarray(env.robot.sensors[0].valid), z, np.inf))
        command = pilot.command(pose)
        commands.append(command)
        env.step(np.array([[command[0]], [command[1]]]))
    env.end()
    return np.array(poses), np.array(commands), np.array(scans)


def _log(
    stamps: Floats,
    poses: Floats,
    commands: Floats,
    ranges: Floats,
    secrets: Secrets,
    room: Room,
    rng: np.random.Generator,
    n_rays: int,
    fov: float,
    *,
    dirty: bool,
) -> Log:
    phi = np.unwrap(poses[:, 2])
    turn = np.diff(phi, prepend=phi[0])
    step = np.diff(poses[:, :2], axis=0, prepend=poses[:1, :2])
    way = step[:, 0] * np.cos(phi - turn / 2) + step[:, 1] * np.sin(phi - turn / 2)
    scale, base = 1 + secrets.value("wheel_radius", "s"), 1 + secrets.value("wheel_base", "s")
    way = way * scale + 0.004 * STEP * rng.normal(size=len(way))
    turn = turn * scale / base + 0.006 * STEP * rng.normal(size=len(turn))
    heading = np.cumsum(turn)
    xy = np.cumsum(
        way[:, None] * np.stack([np.cos(heading - turn / 2), np.sin(heading - turn / 2)], axis=1), axis=0
    )
    noise = rng.normal(size=poses.shape)
    seen = bent_by_lens(poses, room, secrets.value("lens_distortion", "edge"))
    return Log(
        epoch_ns=EPOCH_NS,
        bearings=np.linspace(-fov / 2, fov / 2, n_rays),
        range_limits=(0.02, 8.0),
        scan_stamps=stamps[::PER_SCAN],
        ranges=np.round(ranges, 3),
        pose_stamps=stamps,
        poses=seen_by_camera(seen, noise, 0.8 if dirty else 0.0),
        odometry=Odometry(
            stamps=stamps,
            poses=np.column_stack([xy, np.arctan2(np.sin(heading), np.cos(heading))]),
            twists=np.column_stack([way, turn]) / STEP,
        ),
        cmd_stamps=stamps,
        commands=commands,
    )
