"""Where the benchmarks drive: shipped arenas and random offices by name, the vehicle of the planners, drives in memory."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmarks.offices import office
from logs.run import Run
from planners.arena import Arena
from planners.maps import geojson
from planners.trajectory import Trajectory
from planners.vehicle import Drive, Limits, Vehicle
from sensorgraph.effects import Amendment
from sensorgraph.loading import load_arena
from sensorgraph.world.drive import follow
from sensorgraph.world.robot import Robot
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
