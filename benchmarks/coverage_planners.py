"""Planners of coverage side by side: what they cover, how long that drives, and how long it takes to plan.

    python benchmarks/coverage_planners.py                     # square, office, the coverage search, stops and spins
    python benchmarks/coverage_planners.py --random 10         # and ten random offices made by separate code
    python benchmarks/coverage_planners.py --drive dubins --arena square
    python benchmarks/coverage_planners.py --race square -o race.png

The random offices are those of `benchmarks/offices.py`, seeds 1000 on; nothing was tuned on them.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks.offices import office
from planners import Plan, PlanError, plan
from planners.arena import Arena
from planners.maps import geojson
from planners.robot import Drive, Limits, Robot
from sensorgraph import figures
from sensorgraph.cli.inputs import named_arena

FIRST = 1000
"""Seed of the first random office."""
HEAD = "arena            planner          bins    cover    core  T/Tref  s/10k  viol  clear"


def main() -> None:
    """Print the table, or draw the race."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arena", nargs="*", default=["square", "office"])
    parser.add_argument("--planner", nargs="*", default=["coverage", "stop_and_spin"])
    parser.add_argument("--drive", default="diff", choices=["diff", "reeds_shepp", "dubins"])
    parser.add_argument("--random", type=int, default=0, help="count of random offices")
    parser.add_argument("--race", help="draw coverage against driving time in this arena")
    parser.add_argument("-o", "--out", type=Path, default=Path("race.png"))
    options = parser.parse_args()
    warm_up(options.drive)
    if options.race:
        race(named_arena(options.race), options.out)
        return
    arenas = {name: named_arena(name) for name in options.arena}
    arenas |= {f"office {k}": geojson.loads(office(k)) for k in range(FIRST, FIRST + options.random)}
    planners = options.planner if options.drive == "diff" else ["coverage"]
    print(HEAD)
    for planner in planners:
        ratios = [row(name, arena, planner, options.drive) for name, arena in arenas.items()]
        if options.random:
            print(
                f"mean of {options.random} random offices, {planner}: {np.mean(ratios[-options.random :]):.3f}"
            )


def robot(drive: Drive) -> Robot:
    """Return the robot of the benchmark."""
    return Robot(drive=drive, limits=Limits(turning_radius=0.0 if drive == "diff" else 0.4))


def warm_up(drive: Drive) -> None:
    """Compile, so that planning times leave that out."""
    plan(named_arena("square"), robot(drive), cell=0.5, headings=4)


def row(name: str, arena: Arena, planner: str, drive: Drive) -> float:
    """Plan and print one line; return driving time over the reference."""
    try:
        report = plan(arena, robot(drive), planner=planner).report
    except PlanError as exc:
        print(f"{name:16} {planner:14} {exc}")
        return float("nan")
    print(
        f"{name:16} {planner:14} {report['reachable_cells']:6,} {100 * report['coverage']:7.3f} % "
        f"{report['core_coverage']:6.3f} {report['ratio']:7.3f} "
        f"{1e4 * report['planning_s'] / report['reachable_cells']:6.1f} {report['limit_violations']:5} "
        f"{report['min_clearance_m']:6.3f}",
        flush=True,
    )
    return float(report["ratio"])


def race(arena: Arena, path: Path) -> None:
    """Draw coverage against driving time: the search, stops and spins, random bounces, wall following."""
    made: dict[str, Plan] = {}
    for planner in ("coverage", "stop_and_spin"):
        made[planner] = plan(arena, robot("diff"), planner=planner)
    longest = max(one.trajectory.duration for one in made.values())
    for planner in ("random_bounce", "wall_following"):
        made[planner] = plan(arena, robot("diff"), planner=planner, duration=longest)
    for planner, one in made.items():
        stamps, share = one.growth()
        marks = [np.interp(part * longest, stamps, share) for part in (0.25, 0.5, 0.75, 1.0)]
        print(f"{planner:16} " + " ".join(f"{100 * mark:6.1f} %" for mark in marks))
    figures.growth_picture(
        {name: (one.growth()[0] / 60, one.growth()[1]) for name, one in made.items()}, path
    )
    print(f"wrote {path}")


if __name__ == "__main__":
    main()
