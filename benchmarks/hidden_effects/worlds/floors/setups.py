"""Draw a set-up: floor, room, robot, flaws and drive."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import shapely

from benchmarks.hidden_effects.case import Redraw
from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.floors.base import STYLES, drive
from benchmarks.hidden_effects.worlds.floors.logged import aim
from benchmarks.hidden_effects.worlds.floors.robots import ROBOTS, Robot, draw_background
from benchmarks.hidden_effects.worlds.floors.rooms import OUTLINE, Room, cut_room
from benchmarks.hidden_effects.worlds.floors.scene import PHI, STEP, Scene, Setup, V, X, Y
from benchmarks.hidden_effects.worlds.floors.ways import survey

SEED = 331
SUITES = {"none": 0, "singles": 1, "foreign": 2}
"""Number of each in the seeds."""
MOST_CORNER = 0.004
"""[m] that a corner is off at most."""
MOST_TOUCH = 0.03
"""[m] that the footprint may overlap with a wall of the map."""


def draw_scene(suite: str, index: int, is_dirty: bool, attempt: int, floors: Sequence[Path]) -> Scene:
    """Draw a set-up and drive it; a `Redraw` where the robot touches something or hardly moves."""
    seed = (SEED, SUITES[suite], index, int(is_dirty), attempt)
    rng = np.random.default_rng(seed)
    robot = _robot(suite, index)
    plan = cut_room(rng, robot.footprint, floors)
    background = draw_background(rng, is_dirty, robot)
    room = _true_room(rng, plan, background.corners, is_dirty)
    ways = survey(plan, robot.footprint)
    style = str(rng.choice([STYLES[0], STYLES[0], STYLES[1]]))
    duration = round(float(rng.uniform(*robot.duration)), 1)
    wide = np.array([ways.clearances[i, j] for i, j in ways.cells])
    x, y = ways.place(rng.choice(np.flatnonzero(wide >= np.quantile(wide, 0.5))))
    setup = Setup(
        seed=seed,
        robot=robot,
        plan=plan,
        room=room,
        background=background,
        ways=ways,
        style=style,
        duration=duration,
        start=(x, y, float(rng.uniform(-3.1, 3.1))),
    )
    run, commands = drive(setup)
    clearance = distances(plan, run).min() - robot.footprint
    way = float(np.abs(np.diff(run[:, V].cumsum() * STEP)).sum())
    if clearance < -MOST_TOUCH:
        raise Redraw("touches")
    span = np.ptp(run[::50, X:PHI], axis=0).max()
    if span < min(2.0, 12 * robot.v) or way < 0.3 * robot.v * duration * 0.5:
        raise Redraw("hardly moves")
    return Scene(
        **vars(setup),
        rng=rng,
        run=run,
        commands=commands,
        hits=aim(setup, run),
        clearance=float(clearance),
        way=way,
    )


def distances(room: Room, run: Floats) -> Floats:
    """Return how far the walls of a room are [m] from some places of a drive."""
    free = room.free()
    shapely.prepare(free)
    places = shapely.points(run[::50, X], run[::50, Y])
    return np.asarray(shapely.distance(free.boundary, places))


def _robot(suite: str, index: int) -> Robot:
    """Return a robot; each five cases have each robot once."""
    n = len(ROBOTS)
    turns = np.random.default_rng((SEED, SUITES[suite], index // n)).permutation(n)
    return ROBOTS[int(turns[index % n])]


def _true_room(rng: np.random.Generator, plan: Room, corners: float, is_dirty: bool) -> Room:
    """Return the room as it is: corners off by some millimetres [m], those of a thing partly together."""

    def built(name: str, ring: Floats) -> Floats:
        is_thing = name != OUTLINE
        shift = rng.normal(0, corners / 1.4, (1, 2)) if is_thing else np.zeros((1, 2))
        if not is_dirty:
            return ring
        off = rng.normal(0, corners / (1.4 if is_thing else 1.0), ring.shape)
        return ring + np.clip(off + shift, -MOST_CORNER, MOST_CORNER)

    return plan.changed(built)
