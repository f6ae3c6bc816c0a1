"""Planners of coverage side by side: what they cover, how long that drives, and how long it takes to plan.

    python -m benchmarks.coverage_planners                     # square, office, the coverage search, stops and spins
    python -m benchmarks.coverage_planners --arena --random 10 --planner coverage   # ten random offices
    python -m benchmarks.coverage_planners --drive dubins --arena square
    python -m benchmarks.coverage_planners --race square office -o docs/pages/pictures/coverage_by_time.png
    python -m benchmarks.coverage_planners --large 42 30       # one floor of 42 x 42 m with 30 rooms: some minutes

The random offices and the large floor are those of `benchmarks/offices.py`, made by code of their own: seeds 1001 on, on which
nothing was tuned. `s/10k` is the time to plan 10,000 bins, `cpu` the processor time in
it, which another load on the machine changes less; compiling is left out of both.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from benchmarks.arguments import parser_of
from benchmarks.measures import peak_memory, timed
from benchmarks.offices import office
from benchmarks.places import arena_named, vehicle
from planners import PlanError, plan
from planners.arena import Arena
from planners.maps import geojson
from planners.types import Floats
from planners.vehicle import Drive
from sensorgraph.loading import load_arena
from sensorgraph.show.figures.drives import growth_picture

FIRST_SEED = 1001
"""Seed of the first random office."""
TABLE_HEAD = f"{'arena':12} {'planner':14} {'bins':>7} {'cover':>10} {'core':>6} {'T/Tref':>7} {'s/10k':>6} {'cpu':>6} {'viol':>5} {'clear':>6}"


def main() -> None:
    """Print the table, or draw the race."""
    parser = parser_of(__doc__)
    parser.add_argument("--arena", nargs="*", default=["square", "office"])
    parser.add_argument("--planner", nargs="*", default=["coverage", "stop_and_spin"])
    parser.add_argument("--drive", default="diff", choices=["diff", "reeds_shepp", "dubins"])
    parser.add_argument("--random", type=int, default=0, help="count of random offices")
    parser.add_argument("--race", nargs="+", help="draw coverage against driving time in these arenas")
    parser.add_argument("--large", nargs=2, type=int, metavar=("SIDE", "ROOMS"), help="plan one large floor")
    parser.add_argument("-o", "--out", type=Path, default=Path("race.png"))
    options = parser.parse_args()
    warm_up(options.drive)
    if options.race:
        race({name: load_arena(name) for name in options.race}, options.out)
        return
    if options.large:
        large(*options.large)
        return
    arenas = {name: load_arena(name) for name in options.arena}
    seeds = range(FIRST_SEED, FIRST_SEED + options.random)
    arenas |= {f"office {k}": arena_named(str(k)) for k in seeds}
    planners = options.planner if options.drive == "diff" else ["coverage"]
    print(TABLE_HEAD)
    for planner in planners:
        rows = [row(name, arena, planner, options.drive) for name, arena in arenas.items()]
        if options.random:
            summary(planner, np.array(rows[-options.random :]))


def warm_up(drive: Drive) -> None:
    """Compile, so that planning times leave that out."""
    plan(load_arena("square"), vehicle(drive), cell=0.5, headings=4)


def row(name: str, arena: Arena, planner: str, drive: Drive) -> tuple[float, ...]:
    """Plan and print one line; return coverage, core, driving time over the reference, seconds, and violations."""
    before = time.process_time()
    try:
        report = plan(arena, vehicle(drive), planner=planner).report
    except PlanError as exc:
        print(f"{name:12} {planner:14} {exc}")
        return (float("nan"),) * 6
    share = 1e4 / report["reachable_cells"]
    wall, cpu = share * report["planning_s"], share * (time.process_time() - before)
    print(
        f"{name:12} {planner:14} {report['reachable_cells']:7,} {100 * report['coverage']:8.3f} % "
        f"{report['core_coverage']:6.3f} {report['ratio']:7.3f} {wall:6.1f} {cpu:6.1f} "
        f"{report['limit_violations']:5} {report['min_clearance_m']:6.3f}"
    )
    return report["coverage"], report["core_coverage"], report["ratio"], wall, cpu, report["limit_violations"]


def summary(planner: str, rows: np.ndarray) -> None:
    """Print the mean of rows (n, 6), and the worst of them."""
    cover, core, ratio, wall, cpu, violations = rows.T
    print(
        f"{len(rows)} random offices, {planner}: T/Tref {ratio.mean():.3f} mean, {ratio.max():.3f} worst; "
        f"coverage {100 * cover.min():.3f} % at least, core {core.mean():.3f} mean, {core.min():.3f} least; "
        f"s/10k {wall.mean():.1f} mean, cpu {cpu.mean():.1f}; {violations.sum():.0f} violations"
    )


def large(side: int, rooms: int) -> None:
    """Plan a random office of side x side [m]; print how long it takes, and the most memory it needs."""
    arena = geojson.loads(office(0, width=side, depth=side, rooms=rooms))
    with timed() as took:
        report = plan(arena, vehicle("diff"), cell=0.25, headings=16).report
    bins, joins = report["reachable_cells"], report["joins"]
    print(
        f"{bins:,} bins in {report['reachable_positions']:,} cells: cover {100 * report['coverage']:.3f} %, "
        f"T/Tref {report['ratio']:.3f}, {report['drive_time_s'] / 3600:.1f} h, {report['path_m'] / 1000:.1f} km, "
        f"{report['limit_violations']} violations, clearance {report['min_clearance_m']:.3f} m; "
        f"joins {joins['direct']} direct, {joins['planned']} planned, {joins['failed']} failed; "
        f"planned in {took.wall:.0f} s ({took.cpu:.0f} s of processor, "
        f"{1e4 * report['planning_s'] / bins:.1f} s per 10,000 bins); "
        f"most memory {peak_memory(with_children=True) / 1024:.2f} GiB"
    )


def race(arenas: dict[str, Arena], path: Path) -> None:
    """Draw coverage against driving time: the search, stops and spins, random bounces, wall following."""
    lines: dict[str, dict[str, tuple[Floats, Floats]]] = {}
    for name, arena in arenas.items():
        made = {
            planner: plan(arena, vehicle("diff"), planner=planner)
            for planner in ("coverage", "stop_and_spin")
        }
        longest = max(one.trajectory.duration for one in made.values())
        for planner in ("random_bounce", "wall_following"):
            made[planner] = plan(arena, vehicle("diff"), planner=planner, duration=longest)
        lines[name] = {planner: one.growth() for planner, one in made.items()}
        done = made["coverage"].trajectory.duration
        print(
            f"{name}: bins met after a quarter, half, three quarters and all of the {done / 60:.0f} min of the search"
        )
        for planner, (stamps, share) in lines[name].items():
            marks = np.interp(np.array([0.25, 0.5, 0.75, 1.0]) * done, stamps, share)
            print(f"  {planner:16} " + " ".join(f"{100 * mark:6.1f} %" for mark in marks))
    growth_picture(lines, path)
    print(f"wrote {path}")


if __name__ == "__main__":
    main()
