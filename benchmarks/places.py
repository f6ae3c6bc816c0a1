"""Where the benchmarks drive: shipped arenas and random offices by name, the vehicle of the planners, drives in memory: along a
trajectory, a coverage plan, or in closed loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmarks.offices import office
from logs.run import Run
from planners import plan
from planners.arena import Arena
from planners.maps import geojson
from planners.trajectory import Trajectory
from planners.types import Floats
from planners.vehicle import Drive, Limits, Vehicle
from sensorgraph.effects import Amendment
from sensorgraph.loading import load_arena
from sensorgraph.recording.controllers import Controller, controller_named
from sensorgraph.recording.identified_world import ArenaWorld
from sensorgraph.world.drive import follow, react
from sensorgraph.world.robot import Robot, default_robot
from sensorgraph.world.simulate import simulate
from sensorgraph.world.wall_distance import WallDistance


def arena_named(name: str) -> Arena:
    """Return a random office by its number, or else a shipped arena or that of a file."""
    return geojson.loads(office(int(name))) if name.isdigit() else load_arena(name)


def vehicle(drive: Drive) -> Vehicle:
    """Return a vehicle with the limits of the shipped robot; cars turn at 0.4 m or wider."""
    return Vehicle(drive=drive, limits=Limits(turning_radius=0.0 if drive == "diff" else 0.4))


def write_map(folder: Path, grey: NDArray[np.uint8], origin: tuple[float, float], cell: float) -> Path:
    """Write map.pgm and map.yaml of a picture, row 0 on top, with its lower left corner and the size of cells [m]; return the latter."""
    folder.mkdir(parents=True, exist_ok=True)
    Image.fromarray(grey).save(folder / "map.pgm")
    path = folder / "map.yaml"
    path.write_text(
        f"image: map.pgm\nmode: trinary\nresolution: {cell}\norigin: [{origin[0]}, {origin[1]}, 0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n",
        encoding="utf-8",
    )
    return path


def drive_and_log(
    trajectory: Trajectory, arena: Arena, robot: Robot, seed: int, effects: Sequence[Amendment] = ()
) -> Run:
    """Follow a trajectory with the robot's motors and noise, and log it."""
    rng = np.random.default_rng(seed)
    driven = follow(trajectory, robot, clearance=WallDistance(arena), rng=rng)
    return simulate(driven, arena, robot, rng=rng, effects=effects, seed=seed)


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
