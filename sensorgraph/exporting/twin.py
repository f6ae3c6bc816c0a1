"""Drive a plan in another simulator and record it; the scripts in an exported folder use this module.

The script provides a `Simulator`, which moves by twists and casts rays. Commands come from the simulated
robot's tracking law. The drivetrain of robot.yaml and effects.yaml provides slippery floor, and motors if the
simulator lacks them. The effects of effects.yaml apply to readings with the ranges of the simulator.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

import logs
from logs.run import Run
from planners.arena import Arena
from planners.maps import load
from planners.trajectory import Trajectory
from sensorgraph.effects import Amendment, effects_file
from sensorgraph.errors import SensorgraphError
from sensorgraph.loading import attachments_of
from sensorgraph.recording.drive_source import open_drive
from sensorgraph.types import Floats, Progress, ProgressBars, no_progress
from sensorgraph.world.drive import (
    STANDSTILL,
    TRUTH_STEP,
    ExecutedDrive,
    tracking_law,
    tracking_targets,
)
from sensorgraph.world.drivetrain import Drivetrain
from sensorgraph.world.robot import Robot, load_robot
from sensorgraph.world.scene import Scene, draw_readings
from sensorgraph.world.simulate import simulate

SCANS_AT_ONCE = 200
"""Number of scans between two progress updates."""


class Simulator(Protocol):
    """Interface of a script: a robot that moves by twists, and rays."""

    name: str
    has_motors: bool
    """Its wheels follow a command with their own lag; otherwise the body moves exactly as commanded."""

    def place(self, pose: Floats) -> None:
        """Put the robot at a pose (3,) [m, m, rad], at rest."""

    def step(self, v: float, omega: float, duration: float) -> tuple[Floats, Floats]:
        """Move for `duration` [s] with the command v [m/s], omega [rad/s] to the motors, or to the body.

        Returns the pose (3,) of base_link in map, phi not wrapped, and the twist (2,) of the wheels.
        """

    def shift(self, pose: Floats) -> None:
        """Move the body to a nearby pose (3,), phi not wrapped, while its wheels keep turning."""

    def cast(self, ox: Floats, oy: Floats, ux: Floats, uy: Floats) -> Floats:
        """Return the ranges [m] of rays from (ox, oy) [m] along the unit vectors (ux, uy); inf without a hit."""


class Motors:
    """First-order motors with limited acceleration, as in the simulated robot, for simulators without motors."""

    def __init__(self, drivetrain: Drivetrain, robot: Robot) -> None:
        self._share = 1 - np.exp(-TRUTH_STEP / drivetrain.tau) if drivetrain.tau > 0 else 1.0
        self._most = np.array([robot.limits.a, robot.limits.alpha]) * TRUTH_STEP
        self.twist = np.zeros(2)
        """(2,) [m/s, rad/s] Twist of the wheels."""

    def step(self, commanded: Floats) -> Floats:
        """Follow a command (2,) for one time step; return the mean twist (2,)."""
        before = self.twist
        self.twist = before + np.clip((commanded - before) * self._share, -self._most, self._most)
        return (before + self.twist) / 2


def record_twin(
    folder: Path,
    simulator: Simulator,
    plan: Path,
    out: Path,
    *,
    seed: int = 0,
    progress: ProgressBars = no_progress,
) -> Run:
    """Drive a plan and write the run; the same seed gives the same run.

    Parameters
    ----------
    folder : The exported folder: arena.geojson, robot.yaml, and effects.yaml if effects were exported.
    plan : A plan's folder, or its trajectory.csv.

    Raises
    ------
    SensorgraphError : The plan is not a trajectory, or `out` is not *.mcap.
    """  # fmt: skip
    if out.suffix != ".mcap":
        raise SensorgraphError(f"{out}: a run is written as *.mcap; name it {out.with_suffix('.mcap').name}")
    arena, robot = load(folder / "arena.geojson"), load_robot(folder / "robot.yaml")
    known = folder / "effects.yaml"
    effects = effects_file.read(known, arena) if known.exists() else ()
    way = open_drive(plan).way
    if not isinstance(way, Trajectory):
        raise SensorgraphError(f"{plan} is a run; expected a plan's folder or its trajectory.csv")
    run = drive_twin(simulator, way, arena, robot, effects, seed=seed, progress=progress)
    wanted, _ = way.at(run.pose_stamps)
    off = np.hypot(*(run.poses[:, :2] - wanted[:, :2]).T).max()
    run = replace(run, meta={**run.meta, "off_plan_m": f"{off:.4f}"})
    logs.write(run, out)
    return run


def drive_twin(
    simulator: Simulator,
    trajectory: Trajectory,
    arena: Arena,
    robot: Robot,
    effects: Sequence[Amendment] = (),
    *,
    seed: int = 0,
    progress: ProgressBars = no_progress,
) -> Run:
    """Drive a trajectory in the simulator and return what the robot perceives there.

    The drive comes first, and the scans are then cast at its poses. The result is the same as long as only
    the robot moves. The effect simulates walking people, not the simulator.
    """
    rng = np.random.default_rng(seed)
    on_scans = [a for a in effects if a.effect.channel == "scan"]
    drivetrain = Drivetrain.of(robot, (a for a in effects if a.effect.channel != "scan"))
    with progress("driving", "commands") as tick:
        driven = _follow(simulator, trajectory, robot, drivetrain, rng, tick)

    def perceive(first: int, poses: Floats) -> Floats:
        stamps = (first + np.arange(len(poses))) / robot.sensor.rate
        out = []
        for k in range(0, len(stamps), SCANS_AT_ONCE):
            scene = Scene(
                arena=arena, sensor=robot.sensor, stamps=stamps[k : k + SCANS_AT_ONCE], motion=driven.at,
                span=float(driven.stamps[-1]), seed=seed, caster=simulator.cast,
            )  # fmt: skip
            scene.run(on_scans)
            out.append(draw_readings(scene, rng))
        return np.concatenate(out)

    kept = attachments_of(arena, robot)
    with progress("scanning", "scans") as tick:
        return simulate(
            driven, arena, robot, rng=rng, seed=seed, drivetrain=drivetrain, perceive=perceive, attachments=kept,
            meta={"simulated": "true", "simulator": simulator.name, "seed": str(seed)}, progress=tick,
        )  # fmt: skip


def _follow(
    simulator: Simulator,
    trajectory: Trajectory,
    robot: Robot,
    drivetrain: Drivetrain,
    rng: np.random.Generator,
    tick: Progress,
) -> ExecutedDrive:
    """Track the trajectory with the simulator's body and wheels, and with this drivetrain's dead time, limits and slip."""
    period, limits = 1.0 / robot.wheels.rate, robot.limits
    duration = trajectory.duration + STANDSTILL
    want, feed = tracking_targets(trajectory, robot, duration)
    noise = rng.normal(size=want.shape) * [robot.pose.sigma_xy, robot.pose.sigma_xy, robot.pose.sigma_yaw]
    pose = np.array(trajectory.poses[0], dtype=np.float64)
    simulator.place(pose)
    motors = None if simulator.has_motors else Motors(drivetrain, robot)
    n_steps = round(duration / TRUTH_STEP)
    late = drivetrain.delay / TRUTH_STEP
    least = [0.0 if robot.drive == "dubins" else -limits.v, -limits.omega]
    given: list[Floats] = []
    poses, twists = [pose], [np.zeros(2)]
    waiting = [np.zeros(2)] * (math.ceil(late - 1e-9) + 1)
    for k in range(n_steps):
        if len(given) < len(want) and k * TRUTH_STEP >= len(given) * period - 1e-9:
            i = len(given)
            given.append(
                np.clip(tracking_law(want[i], feed[i], pose + noise[i]), least, [limits.v, limits.omega])
            )
            tick(i, len(want))
        waiting = [*waiting[1:], given[-1]]
        commanded = np.clip(_delayed(waiting, late), [-drivetrain.v_max, -np.inf], [drivetrain.v_max, np.inf])
        before = pose
        v, omega = commanded if motors is None else motors.step(commanded)
        pose, twist = simulator.step(v, omega, TRUTH_STEP)
        slipped = _with_slip(drivetrain, before, pose)
        if slipped is not None:
            pose = slipped
            simulator.shift(pose)
        poses.append(pose)
        twists.append(twist if motors is None else motors.twist)
    return ExecutedDrive(
        stamps=np.arange(n_steps + 1) * np.float64(TRUTH_STEP),
        poses=np.array(poses),
        twists=np.array(twists),
        cmd_stamps=np.arange(len(given)) * np.float64(period),
        commands=np.array(given).reshape(-1, 2),
        contacts=0,
    )


def _with_slip(drivetrain: Drivetrain, before: Floats, after: Floats) -> Floats | None:
    """Return the end pose (3,) of a step (3,) -> (3,) with slipping wheels; None without slip."""
    if not drivetrain.patches:
        return None
    step = after - before
    middle = before[2] + step[2] / 2
    ahead = np.array([np.cos(middle), np.sin(middle)])
    distance = float(ahead @ step[:2])
    x, y, phi = (float(value) for value in before)
    moved, turned = drivetrain.moved(distance, float(step[2]), x, y, phi)
    if (moved, turned) == (distance, float(step[2])):
        return None
    aside = step[:2] - distance * ahead
    middle = phi + turned / 2
    way = moved * np.array([np.cos(middle), np.sin(middle)]) + aside
    return np.array([x + way[0], y + way[1], phi + turned])


def _delayed(waiting: Sequence[Floats], late: float) -> Floats:
    """Return the command (2,) of `late` steps ago, interpolated between steps; the newest is last."""
    whole = math.floor(late + 1e-9)
    share = max(late - whole, 0.0)  # of a step in which the older command still holds
    newer = waiting[-1 - whole]
    return newer + share * (waiting[-2 - whole] - newer) if share > 1e-9 else newer
