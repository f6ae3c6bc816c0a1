"""Arenas and tasks that several planner tests share."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import shapely

from planners.arena import Arena
from planners.clearance import Barriers
from planners.coverage import Coverage
from planners.maps import geojson
from planners.reach import reach
from planners.task import Task
from planners.types import Bools, Floats
from planners.vehicle import Drive, Limits, Vehicle


def shipped(name: str) -> Arena:
    """Read a shipped arena."""
    return geojson.loads((files("sensorgraph.data") / f"{name}.geojson").read_text())


def outlined(free: shapely.Polygon | shapely.MultiPolygon) -> Arena:
    """Make every border of free space a wall."""
    lines = shapely.get_parts(shapely.boundary(free))
    rings = [np.asarray(line.coords) for line in lines]
    walls = np.concatenate([np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings])
    names = tuple(f"w/edge_{i}" for i in range(len(walls)))
    return Arena(free=free, walls=walls, names=names, surfaces=("wall",) * len(walls))


def door_arena(width: float) -> Arena:
    """Two rooms of 2 x 3 m behind a wall of 10 cm at x = 2 with a door in its middle; 0: closed, 9: no wall."""
    free = shapely.box(0, 0, 4, 3)
    if width < 3:
        free = free.difference(shapely.box(1.95, 0, 2.05, 1.5 - width / 2))
        free = free.difference(shapely.box(1.95, 1.5 + width / 2, 2.05, 3))
    return outlined(free)


def random_arena(rng: np.random.Generator) -> Arena:
    """A 4 x 3.5 m room with up to four convex obstacles."""
    free = shapely.box(0, 0, 4, 3.5)
    for _ in range(int(rng.integers(0, 5))):
        corners = rng.uniform(0.5, 3.2, 2) + rng.uniform(-0.4, 0.4, (6, 2))
        free = free.difference(shapely.convex_hull(shapely.multipoints(corners)))
    return outlined(free)


def task_of(arena: Arena, drive: Drive, start: Floats) -> Task:
    """Return the task to cover all of an arena from `start` (3,), in cells of 0.25 m and 16 headings."""
    barriers = Barriers(arena)
    free = reach(arena, barriers, clearance=0.22, cell=0.25, start=start)
    grid = Coverage.empty(origin=free.origin, cell=free.cell, cells=free.cells(), headings=16)
    return Task(
        arena=arena,
        vehicle=Vehicle(drive=drive, limits=Limits(turning_radius=0.3)),
        barriers=barriers,
        reach=free,
        coverage=grid,
        start=start,
        seed=0,
        rate=10.0,
        priority=None,
        duration=None,
        progress=None,
    )


def some(task: Task, *bins: tuple[int, int, int]) -> Bools:
    """Return (nx, ny, n_phi) some of the bins of a task."""
    todo = np.zeros_like(task.coverage.reachable)
    todo[tuple(np.array(bins).T)] = True
    return todo
