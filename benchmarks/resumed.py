"""What `plan --resume` drives where an earlier run has left bins all over the floor, beside a fresh plan of everything.

    python -m benchmarks.resumed                # the shipped office
    python -m benchmarks.resumed --arena square

Earlier runs: random bounces of one and three hours, coverage in cells of 1 m, an anytime plan of twenty minutes, and a whole plan of
which a quarter of the log is lost, in spells of two seconds.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.arguments import parser_of
from planners import plan
from planners.arena import Arena
from planners.types import Floats
from sensorgraph.loading import load_arena
from sensorgraph.planning.survey import survey_of
from sensorgraph.world.robot import Robot, default_robot

SEED = 1
SPELL = 20
"""Scans that are lost together."""


def main() -> None:
    """Print a row for each earlier run."""
    parser = parser_of(__doc__)
    parser.add_argument("--arena", default="office")
    options = parser.parse_args()
    arena, robot = load_arena(options.arena), default_robot()
    print(
        "| earlier run | met before | coverage | driving [min] | of a fresh plan |\n|---|---:|---:|---:|---:|"
    )
    fresh = plan(arena, robot, rate=robot.sensor.rate, seed=SEED)
    for name, poses in earlier(arena, robot, fresh.curve.log(robot.sensor.rate)):
        report = plan(arena, robot, rate=robot.sensor.rate, seed=SEED, visited=poses, start=poses[-1]).report
        print(
            f"| {name} | {100 * report['coverage_before']:.1f} % | {100 * report['coverage']:.2f} % | "
            f"{report['drive_time_s'] / 60:.1f} | {report['drive_time_s'] / fresh.report['drive_time_s']:.3f} |"
        )


def earlier(arena: Arena, robot: Robot, whole: Floats) -> Iterator[tuple[str, Floats]]:
    """Yield names and logs (n, 3) [m, m, rad] of earlier runs."""
    rate = robot.sensor.rate
    for hours in (1, 3):
        made = plan(arena, robot, planner="random_bounce", duration=3600.0 * hours, rate=rate, seed=SEED)
        yield f"random bounce, {hours} h", made.curve.log(rate)
    yield "coverage, cells of 1 m", plan(arena, robot, cell=1.0, rate=rate, seed=SEED).curve.log(rate)
    survey = survey_of(arena, robot.sensor)
    made = plan(arena, robot, order="anytime", survey=survey, budget=1200.0, rate=rate, seed=SEED)
    yield "anytime, 20 min", made.curve.log(rate)
    spells = np.random.default_rng(SEED).random(len(whole) // SPELL + 1) < 0.75
    yield "a whole plan, a quarter of its log lost", whole[np.repeat(spells, SPELL)[: len(whole)]]


if __name__ == "__main__":
    main()
