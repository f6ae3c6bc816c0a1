"""Runs of scans in a hall and in the 4 x 3 m room, with effects on request."""

from __future__ import annotations

from functools import cache

import numpy as np
from conftest import polygon_arena

from logs.run import Run
from planners.arena import Arena, wrap
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import ScanData, prepare_scans
from sensorgraph.diagnosis.scan.unnamed import Checked
from sensorgraph.effects import Amendment
from sensorgraph.world.raycast import cast
from sensorgraph.world.robot import parse_robot
from sensorgraph.world.scene import Scene, draw_readings

ROOM_ROBOT = """
name: tester
sensor: {mount: [0.1, 0.0, 0.0], n_rays: 61, fov: 3.14159265, range_min: 0.05, range_max: 8.0, sigma: 0.01, rate: 10.0}
"""


@cache
def hall_arena() -> Arena:
    """Return a 6 x 5 m hall with two pillars."""
    return polygon_arena(
        [(0, 0), (6, 0), (6, 5), (0, 5)],
        [(2.0, 3.0), (2.6, 3.0), (2.6, 3.5), (2.0, 3.5)],
        [(4.0, 1.0), (4.5, 1.2), (4.3, 1.7)],
    )


def drive(hall: Arena, effects: tuple[Amendment, ...] = (), *, seed: int = 0, n: int = 160) -> Run:
    """Scan along a circle that breathes, with turns of both senses; noisy reference at every scan."""
    rng = np.random.default_rng(seed)
    t = 0.2 * np.arange(n)
    phase = 0.35 * t
    x, y = 3.0 + 1.5 * np.cos(phase), 2.3 + 1.0 * np.sin(phase) + 0.2 * np.sin(3 * phase)
    poses = np.column_stack([x, y, phase + 1.5 * np.sin(0.9 * t)])
    robot = parse_robot("sensor: {n_rays: 61}")
    fine = np.linspace(0, t[-1], 20 * n)
    path = np.stack([np.interp(fine, t, c) for c in poses.T], axis=1)
    scene = Scene(
        arena=hall,
        sensor=robot.sensor,
        stamps=t,
        motion=lambda times: np.stack([np.interp(times, fine, c) for c in path.T], axis=-1),
        span=float(t[-1]),
    )
    scene.run(effects)
    noise = rng.normal(size=path.shape) * [0.002, 0.002, 0.0015]
    reference = path + noise
    return Run(
        sensor=robot.sensor,
        stamps=t,
        ranges=draw_readings(scene, rng),
        pose_stamps=fine,
        poses=np.column_stack([reference[:, :2], wrap(reference[:, 2])]),
    )


def data_of(hall: Arena, effects: tuple[Amendment, ...] = (), **options: int) -> ScanData:
    robot = parse_robot("sensor: {n_rays: 61}")
    return prepare_scans(drive(hall, effects, **options), hall, robot)[0]


def checked_of(
    fitted: Fitted,
    null: Fitted | None = None,
    *,
    data: ScanData | None = None,
    gains: dict[int, float] | None = None,
    gained: float = 0.0,
    seed: int = 0,
) -> Checked:
    """Return what a test for differences without a name is given; each effect of the model gains 1000 nats."""
    data = fitted.solver.data if data is None else data
    return Checked(
        view=FitResiduals(data, fitted),
        gains=dict.fromkeys(range(len(fitted.model)), 1000.0) if gains is None else gains,
        gained=gained,
        null=null,
        rng=np.random.default_rng(seed),
    )


def drive_in_room(room: Arena, *, bias: float = 0.0) -> Run:
    """Return a short run through the room, without odometry and commands."""
    rng = np.random.default_rng(4)
    machine = parse_robot(ROOM_ROBOT)
    t = np.arange(0.0, 16.0, 0.1)
    phi = 0.9 * np.sin(0.9 * t) + 0.5 * t
    poses = np.stack(
        [1.4 + 0.8 * np.cos(0.4 * t), 1.5 + 0.9 * np.sin(0.4 * t), (phi + np.pi) % (2 * np.pi) - np.pi],
        axis=1,
    )
    ranges = cast(room, poses, machine.sensor).ranges + bias
    ranges = ranges + machine.sensor.sigma * rng.normal(size=ranges.shape)
    return Run(sensor=machine.sensor, stamps=t, ranges=ranges, pose_stamps=t, poses=poses)
