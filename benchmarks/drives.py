"""Drives of the embedded robot in memory, for the experiments: closed loop, or along a coverage plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.places import drive_and_log
from logs.run import Run
from planners import plan
from planners.arena import Arena
from planners.types import Floats
from sensorgraph.recording.controllers import Controller, controller_named
from sensorgraph.recording.identified_world import ArenaWorld
from sensorgraph.world.drive import react
from sensorgraph.world.robot import Robot, default_robot
from sensorgraph.world.simulate import simulate
from sensorgraph.world.wall_distance import WallDistance

LOG_PERIOD = 0.25  # [s] of the paper's log


def robot_of_the_paper() -> Robot:
    """Return the shipped robot, logging and steering every 250 ms."""
    robot = default_robot()
    return replace(robot, sensor=replace(robot.sensor, rate=1 / LOG_PERIOD))


def closed_loop(
    controller: str | Controller, arena: Arena, robot: Robot, start: Floats, seconds: float, seed: int
) -> Run:
    """Let a controller, or one by its name, drive for so long."""
    world = ArenaWorld(arena, robot, seed)
    steer = controller_named(controller, robot, seed) if isinstance(controller, str) else controller
    driven = react(steer, world.scan, start, seconds, robot, clearance=WallDistance(arena))
    meta = {"contacts": str(driven.contacts)}
    rng = np.random.default_rng([seed, 3])
    return simulate(driven, arena, robot, rng=rng, perceive=world.scans, meta=meta)


def covered(arena: Arena, robot: Robot, seed: int, *, headings: int = 16) -> Run:
    """Drive a coverage plan."""
    way = plan(arena, robot, cell=0.25, headings=headings, seed=seed).trajectory
    return drive_and_log(way, arena, robot, seed)
