"""An effect hidden by seed, to be found again: what `demo` shows of diagnosis."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planners import plan as make_plan
from planners.arena import Arena
from sensorgraph.diagnosis.diagnose import Finding, diagnose
from sensorgraph.diagnosis.report.data import effect_dict
from sensorgraph.diagnosis.report.data import to_dict as report_dict
from sensorgraph.diagnosis.report.files import save_report
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.recording.record import record
from sensorgraph.types import Floats, ProgressBars
from sensorgraph.world.robot import Robot
from sensorgraph.world.wall_distance import WallDistance

DURATION = 60.0  # [s] that the robot drives


@dataclass(frozen=True, kw_only=True, eq=False)
class Hidden:
    """What was hidden, and what was found."""

    planted: Amendment
    finding: Finding

    @property
    def found(self) -> Amendment | None:
        """The effect of that name among those found."""
        return next((a for a in self.finding.effects if a.name == self.planted.name), None)


def to_dict(hidden: Hidden) -> dict[str, Any]:
    """Return as plain data what was planted, what was found in its place, and the gap before and after."""
    report = report_dict(hidden.finding)
    planted, found = hidden.planted, hidden.found
    return {
        "planted": planted.name,
        "planted_parameters": dict(planted.parameters),
        "planted_at": planted.place or None,
        "found": None if found is None else effect_dict(found),
        **{key: report[key] for key in ("effects", "gap", "gap_second_run")},
    }


def hide_and_find(folder: Path, arena: Arena, robot: Robot, *, seed: int, progress: ProgressBars) -> Hidden:
    """Drive twice with an effect that the map and robot.yaml lack; diagnose one run, prove it on the other."""
    planted = chosen(arena, robot, np.random.default_rng([seed, 7]))
    folder.mkdir(parents=True, exist_ok=True)
    runs = []
    for k, name in enumerate(("first", "second")):
        way = make_plan(
            arena,
            robot,
            planner="random_bounce",
            seed=seed + 50 + k,
            rate=robot.sensor.rate,
            duration=DURATION,
        ).trajectory
        path = folder / f"{name}.mcap"
        runs.append(record(path, arena, robot, way, effects=[planted], seed=seed + k, progress=progress))
    with progress("diagnosing", "parts") as tick:
        finding = diagnose(runs[0], arena, robot, second=runs[1], seed=seed, progress=tick)
    settings = {"seed": seed, "runs": ["first.mcap", "second.mcap"], "tolerances": vars(robot.tolerances)}
    with progress("reporting", "files") as tick:
        save_report(finding, folder, name="first.mcap", settings=settings, progress=tick)
    return Hidden(planted=planted, finding=finding)


def chosen(arena: Arena, robot: Robot, rng: np.random.Generator) -> Amendment:
    """Draw an effect, its size and its place."""
    sign = float(rng.choice([-1.0, 1.0]))
    outline = arena.names[0].rsplit("/", 1)[0]
    long = [
        i
        for i, name in enumerate(arena.names)
        if name.rsplit("/", 1)[0] == outline and _length(arena, i) > 1.2
    ]
    wall = int(rng.choice(long)) if long else 0
    start = rng.uniform(0.1, 0.4) * _length(arena, wall)
    point = _free_point(arena, robot, rng)
    choices = [
        EFFECTS["range_bias"](b=sign * rng.uniform(0.015, 0.04)),
        EFFECTS["range_scale"](s=sign * rng.uniform(0.008, 0.02)),
        EFFECTS["mount_yaw"](delta=sign * np.radians(rng.uniform(0.8, 2.0))),
        EFFECTS["mount_xy"](dx=sign * rng.uniform(0.02, 0.05), dy=rng.uniform(-0.03, 0.03)),
        EFFECTS["latency"](tau=rng.uniform(0.03, 0.08)),
        EFFECTS["moved_wall"](d=sign * rng.uniform(0.04, 0.1)).at(arena.names[wall], _middle(arena, wall)),
        EFFECTS["glass"](a=start, b=start + 0.9, alpha_ret=np.radians(rng.uniform(15, 35)), depth=1.5).at(
            arena.names[wall], _middle(arena, wall)
        ),
        EFFECTS["unmapped_obstacle"](x=point[0], y=point[1], r=rng.uniform(0.06, 0.15)).at("", point),
    ]
    made = choices[int(rng.integers(len(choices)))]
    return made.moved_to({k: round(float(v), 4) for k, v in made.parameters.items()})


def _length(arena: Arena, wall: int) -> float:
    return float(np.hypot(*(arena.walls[wall, 1] - arena.walls[wall, 0])))


def _middle(arena: Arena, wall: int) -> Floats:
    return np.asarray(arena.walls[wall].mean(axis=0))


def _free_point(arena: Arena, robot: Robot, rng: np.random.Generator) -> tuple[float, float]:
    """Return a point in a corner that the robot, which does not know of the obstacle, does not drive through."""
    x0, y0, x1, y1 = arena.bounds
    clearance = WallDistance(arena)
    best, point = np.inf, (0.0, 0.0)
    for x, y in rng.uniform([x0, y0], [x1, y1], (400, 2)):
        off = abs(clearance(x, y) - 0.7 * robot.footprint_radius)
        if arena.contains(np.array([x, y])) and off < best:
            best, point = off, (round(float(x), 3), round(float(y), 3))
    return point
