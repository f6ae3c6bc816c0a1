"""Drive a plan in another simulator and record it: what the scripts in an exported folder run on.

The script gives a `Simulator`: it moves by twists and casts rays. Commands come from the embedded robot's own tracking
law; readings go through the effects of effects.yaml, whose ranges are those of the simulator.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

import logs
from logs.run import Run
from planners.arena import Arena
from planners.maps import geojson, load
from planners.trajectory import Trajectory
from sensorgraph.effects import Amendment, effects_file
from sensorgraph.errors import SensorgraphError
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
"""Scans cast between two ticks of the progress."""


class Simulator(Protocol):
    """What a script offers: a robot that moves by twists, and rays."""

    name: str

    def place(self, pose: Floats) -> None:
        """Put the robot at a pose (3,) [m, m, rad], at rest."""

    def step(self, v: float, omega: float, duration: float) -> tuple[Floats, Floats]:
        """Move for a while [s] with the motors told v [m/s], omega [rad/s].

        Returns the pose (3,) of base_link in map, phi not wrapped, and the twist (2,) that the wheels turn with.
        """

    def cast(self, ox: Floats, oy: Floats, ux: Floats, uy: Floats) -> Floats:
        """Return the ranges [m] of rays from (ox, oy) [m] along the unit vectors (ux, uy); inf where nothing is."""


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
    folder : the exported one: arena.geojson, robot.yaml, and effects.yaml if it was exported with effects
    plan : a plan's folder, or its trajectory.csv

    Raises
    ------
    SensorgraphError : the plan is no trajectory, or `out` is no *.mcap
    """  # fmt: skip
    if out.suffix != ".mcap":
        raise SensorgraphError(f"{out}: a run is written as *.mcap")
    arena, robot = load(folder / "arena.geojson"), load_robot(folder / "robot.yaml")
    known = folder / "effects.yaml"
    effects = effects_file.read(known, arena) if known.exists() else ()
    way = open_drive(plan).way
    if not isinstance(way, Trajectory):
        raise SensorgraphError(f"{plan} is a run; a twin drives a plan's folder or its trajectory.csv")
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

    The drive comes first; the scans are then cast at its poses, which is the same as long as nothing but the robot
    moves. Walkers are drawn by the effect, not by the simulator.
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

    kept = {"arena.geojson": geojson.dumps(arena).encode(), "robot.yaml": robot.text.encode()}
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
    """Track the trajectory; the simulator has motors, mass and wheels, the dead time and the limits are kept here."""
    period, limits = 1.0 / robot.wheels.rate, robot.limits
    duration = trajectory.duration + STANDSTILL
    want, feed = tracking_targets(trajectory, robot, duration)
    noise = rng.normal(size=want.shape) * [robot.pose.sigma_xy, robot.pose.sigma_xy, robot.pose.sigma_yaw]
    pose = np.array(trajectory.poses[0], dtype=np.float64)
    simulator.place(pose)
    n_steps = round(duration / TRUTH_STEP)
    late = round(drivetrain.delay / TRUTH_STEP)
    backward = 0.0 if robot.drive == "dubins" else -limits.v
    told = [(0.0, 0.0)] * (late + 1)
    given: list[tuple[float, float]] = []
    poses, twists = [pose], [np.zeros(2)]
    command = (0.0, 0.0)
    for k in range(n_steps):
        if len(given) < len(want) and k * TRUTH_STEP >= len(given) * period - 1e-9:
            i = len(given)
            v, omega = tracking_law(want[i], feed[i], pose + noise[i])
            command = (
                min(max(v, backward), limits.v),
                min(max(omega, -limits.omega), limits.omega),
            )
            given.append(command)
            tick(i, len(want))
        told.append(command)
        v, omega = told[k + 1]
        pose, twist = simulator.step(min(max(v, -drivetrain.v_max), drivetrain.v_max), omega, TRUTH_STEP)
        poses.append(pose)
        twists.append(twist)
    return ExecutedDrive(
        stamps=np.arange(n_steps + 1) * np.float64(TRUTH_STEP),
        poses=np.array(poses),
        twists=np.array(twists),
        cmd_stamps=np.arange(len(given)) * np.float64(period),
        commands=np.array(given).reshape(-1, 2),
        contacts=0,
    )
