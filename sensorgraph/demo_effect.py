"""Hide a random effect in a simulation and find it by diagnosis, for `demo`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planners import plan as make_plan
from planners.arena import Arena
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.report.data import effect_dict
from sensorgraph.diagnosis.report.data import to_dict as report_dict
from sensorgraph.diagnosis.report.files import save_report
from sensorgraph.effects import Amendment
from sensorgraph.effects.glass import GLASS
from sensorgraph.effects.latency import LATENCY
from sensorgraph.effects.mount_xy import MOUNT_XY
from sensorgraph.effects.mount_yaw import MOUNT_YAW
from sensorgraph.effects.moved_wall import MOVED_WALL
from sensorgraph.effects.range_bias import RANGE_BIAS
from sensorgraph.effects.range_scale import RANGE_SCALE
from sensorgraph.effects.unmapped_obstacle import UNMAPPED_OBSTACLE
from sensorgraph.recording.record import record
from sensorgraph.types import Floats, ProgressBars
from sensorgraph.world.robot import Robot
from sensorgraph.world.wall_distance import WallDistance

DURATION = 60.0
"""[s] Duration of each drive."""
MIN_WALL, PANE = 1.2, 0.9
"""[m] Minimum length of a wall that is moved or contains a pane of glass, and length of the pane."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HiddenEffect:
    """A hidden effect and the result of the diagnosis."""

    planted: Amendment
    finding: Finding

    @property
    def found(self) -> Amendment | None:
        """The reported effect with the name of the hidden one; None if it was not found."""
        return next((a for a in self.finding.effects if a.name == self.planted.name), None)


def to_dict(hidden: HiddenEffect) -> dict[str, Any]:
    """Return the hidden effect, the reported effect, and the gap before and after as plain data."""
    report = report_dict(hidden.finding)
    planted, found = hidden.planted, hidden.found
    return {
        "planted": planted.name,
        "planted_parameters": dict(planted.parameters),
        "planted_at": planted.place or None,
        "found": None if found is None else effect_dict(found),
        **{key: report[key] for key in ("effects", "gap", "gap_second_run")},
    }


def hide_and_find(
    folder: Path, arena: Arena, robot: Robot, seed: int, *, progress: ProgressBars
) -> HiddenEffect:
    """Drive twice with an effect that map and robot.yaml lack; diagnose the first run, verify on the second."""
    planted = random_effect(arena, robot, np.random.default_rng([seed, 7]))
    folder.mkdir(parents=True, exist_ok=True)
    runs = []
    for k, name in enumerate(("first", "second")):
        trajectory = make_plan(
            arena,
            robot,
            planner="random_bounce",
            seed=seed + 50 + k,
            rate=robot.sensor.rate,
            duration=DURATION,
        ).trajectory
        path = folder / f"{name}.mcap"
        runs.append(
            record(path, arena, robot, trajectory, effects=[planted], seed=seed + k, progress=progress)
        )
    finding = diagnose(runs[0], arena, robot, second=runs[1], seed=seed, progress=progress)
    settings = {"seed": seed, "runs": ["first.mcap", "second.mcap"], "tolerances": vars(robot.tolerances)}
    with progress("reporting", "files") as tick:
        save_report(finding, folder, name="first.mcap", settings=settings, progress=tick)
    return HiddenEffect(planted=planted, finding=finding)


def random_effect(arena: Arena, robot: Robot, rng: np.random.Generator) -> Amendment:
    """Draw a random effect with its size and its place."""
    sign = float(rng.choice([-1.0, 1.0]))
    outline = arena.names[0].rsplit("/", 1)[0]
    long = [
        i
        for i, name in enumerate(arena.names)
        if name.rsplit("/", 1)[0] == outline and _length(arena, i) > MIN_WALL
    ]
    wall = int(rng.choice(long)) if long else 0
    start = rng.uniform(0.1, 0.4) * _length(arena, wall)
    point = _free_point(arena, robot, rng)
    choices = [
        RANGE_BIAS(b=sign * rng.uniform(0.015, 0.04)),
        RANGE_SCALE(s=sign * rng.uniform(0.008, 0.02)),
        MOUNT_YAW(delta=sign * np.radians(rng.uniform(0.8, 2.0))),
        MOUNT_XY(dx=sign * rng.uniform(0.02, 0.05), dy=rng.uniform(-0.03, 0.03)),
        LATENCY(tau=rng.uniform(0.03, 0.08)),
        MOVED_WALL(d=sign * rng.uniform(0.04, 0.1)).at(arena.names[wall], _middle(arena, wall)),
        GLASS(a=start, b=start + PANE, alpha_ret=np.radians(rng.uniform(15, 35)), depth=1.5).at(
            arena.names[wall], _middle(arena, wall)
        ),
        UNMAPPED_OBSTACLE(x=point[0], y=point[1], r=rng.uniform(0.06, 0.15)).at("", point),
    ]
    made = choices[int(rng.integers(len(choices)))]
    return made.moved_to({k: round(float(v), 4) for k, v in made.parameters.items()})


def _length(arena: Arena, wall: int) -> float:
    return float(np.hypot(*(arena.walls[wall, 1] - arena.walls[wall, 0])))


def _middle(arena: Arena, wall: int) -> Floats:
    return np.asarray(arena.walls[wall].mean(axis=0))


def _free_point(arena: Arena, robot: Robot, rng: np.random.Generator) -> tuple[float, float]:
    """Return a point near a wall, where a robot that does not know the obstacle does not drive."""
    x0, y0, x1, y1 = arena.bounds
    clearance = WallDistance(arena)
    best, point = np.inf, (0.0, 0.0)
    for x, y in rng.uniform([x0, y0], [x1, y1], (400, 2)):
        off = abs(clearance(x, y) - 0.7 * robot.footprint_radius)
        if arena.contains(np.array([x, y])) and off < best:
            best, point = off, (round(float(x), 3), round(float(y), 3))
    return point
