"""What options of `plan` buy in the shipped square and office: the margin of a bin, `--resume` and `--priority`.

    python -m benchmarks.plan_options margin --arena square office
    python -m benchmarks.plan_options resume --arena office
    python -m benchmarks.plan_options priority --arena square office

`margin`: coverage that a robot logs which does not track exactly, by error, with and without the planner's own margin: in cells
whose inner half is in reach a bin counts only there, in the middle half of its heading. `all` counts every reachable bin,
`roomy` those cells only; the others are slivers along walls, where no plan can keep a margin. The error is a random walk that
is pulled back to the plan (Ornstein-Uhlenbeck, 2 s), the same along and across, and 0.5° of heading per centimetre; the last
row is the shipped robot as `sensorgraph record` simulates it, with its controller, motors and pose noise.

`resume`: what is driven where an earlier run has left bins all over the floor, beside a fresh plan of everything. Earlier runs
are random bounces of one and three hours, coverage in cells of 1 m, an anytime plan of twenty minutes, and a whole plan of
which a quarter of the log is lost, in spells of two seconds.

`priority`: how much of a graph's doubt a drive meets by when. A robot bounces at random for some minutes, and what it logs
becomes a graph. Each kind of robot plans to fill (x, y, phi) by the doubts of that graph and without: how much of all doubt
lies in the bins met after a share of the reference time, and what it costs.
"""

from __future__ import annotations

from collections.abc import Iterator
from unittest import mock

import numpy as np

from benchmarks.arguments import heads, parser_of
from benchmarks.places import drive_and_log, vehicle
from planners import Plan, plan
from planners.arena import Arena, wrap
from planners.search import area
from planners.types import Bools, Floats
from planners.vehicle import Drive
from sensorgraph.building.build import build
from sensorgraph.graph import Sensorgraph
from sensorgraph.loading import load_arena
from sensorgraph.planning.plan_folder import counted
from sensorgraph.planning.priority import uncertainty
from sensorgraph.planning.survey import survey_of
from sensorgraph.world.drive import follow
from sensorgraph.world.robot import default_robot
from sensorgraph.world.wall_distance import WallDistance

ERRORS = (0.0, 0.01, 0.02, 0.035, 0.05, 0.07)
"""[m] root mean square distance from the plan."""
HEADING = np.radians(0.5) / 0.01
"""[rad/m] root mean square error of heading by that of the place."""
MEMORY = 2.0
"""[s] that an error lasts."""
N_SEEDS = 5
"""Drives of each error, of which the mean is told."""
SEED = 1
SPELL = 20
"""Scans that are lost together."""
SHARES = (0.1, 0.25, 0.5, 0.75, 1.0)
"""Of the reference time."""
MINUTES = 15.0
"""[min] of random driving."""
COMPARED_DRIVES: tuple[Drive, ...] = ("diff", "reeds_shepp", "dubins")


def margin(arena: Arena, _: str) -> None:
    """Print coverage and core by error for both plans."""
    plans = {"inner half": plan(arena, default_robot())}
    roomy = area.search_area(plans["inner half"].reach).inner
    with mock.patch.object(area, "MIN_INNER_SHARE", np.inf):
        plans["anywhere"] = plan(arena, default_robot())
    for name, made in plans.items():
        print(f"{name:10}: T / T_ref {made.report['ratio']:.3f}")
    print(f"{'rms error':>14}" + "".join(f"{name + ': all':>20} {'roomy':>9} {'core':>6}" for name in plans))
    for rms in ERRORS:
        shares = [mean_share(made, rms, roomy) for made in plans.values()]
        print(row(f"{100 * rms:.1f} cm", shares))
    print(row("shipped robot", [share_of(made, simulated(made, arena), roomy) for made in plans.values()]))


def row(name: str, shares: list[Floats]) -> str:
    """Return a line of the table."""
    return f"{name:>14}" + "".join(
        f"{100 * cover:18.2f} % {100 * middle:7.2f} % {core:6.3f}" for cover, middle, core in shares
    )


def mean_share(made: Plan, rms: float, roomy: Bools) -> Floats:
    """Return `share_of` logs that are off by `rms` [m], the mean over some drives."""
    poses, rate = made.curve.log(made.report["rate"]), made.report["rate"]
    drives = []
    for seed in range(N_SEEDS):
        off = wander(len(poses), 1.0 / rate, np.random.default_rng(seed))
        off *= rms / np.sqrt(2) * np.array([1.0, 1.0, np.sqrt(2) * HEADING])
        there = np.column_stack([(poses + off)[:, :2], wrap((poses + off)[:, 2])])
        drives.append(share_of(made, there, roomy))
    return np.asarray(np.mean(drives, axis=0))


def wander(n: int, dt: float, rng: np.random.Generator) -> Floats:
    """Return (n, 3) three errors of unit variance that are forgotten within MEMORY."""
    keep = np.exp(-dt / MEMORY)
    steps = rng.normal(size=(n, 3))
    steps[1:] *= np.sqrt(1 - keep * keep)
    for k in range(1, n):
        steps[k] += keep * steps[k - 1]
    return steps


def simulated(made: Plan, arena: Arena) -> Floats:
    """Return the true poses (n, 3) at which the shipped robot scans when it drives the plan."""
    robot = default_robot()
    driven = follow(made.trajectory, robot, clearance=WallDistance(arena), rng=np.random.default_rng(0))
    poses = driven.at(np.arange(0.0, driven.stamps[-1], 1.0 / robot.sensor.rate))
    return np.column_stack([poses[:, :2], wrap(poses[:, 2])])


def share_of(made: Plan, poses: Floats, roomy: Bools) -> Floats:
    """Return (3,) coverage of logged poses (n, 3) on the plan's grid, that of the cells `roomy` alone, and core."""
    grid = counted(made.coverage, poses)
    within = grid.reachable & roomy[:, :, None]
    return np.array([grid.fraction, (grid.covered & within).sum() / within.sum(), grid.core_fraction])


def resume(arena: Arena, _: str) -> None:
    """Print a row for each earlier run."""
    robot = default_robot()
    print(heads("earlier run", "met before", "coverage", "driving [min]", "of a fresh plan"))
    fresh = plan(arena, robot, rate=robot.sensor.rate, seed=SEED)
    for name, poses in earlier(arena, fresh.curve.log(robot.sensor.rate)):
        report = plan(arena, robot, rate=robot.sensor.rate, seed=SEED, visited=poses, start=poses[-1]).report
        print(
            f"| {name} | {100 * report['coverage_before']:.1f} % | {100 * report['coverage']:.2f} % | "
            f"{report['drive_time_s'] / 60:.1f} | {report['drive_time_s'] / fresh.report['drive_time_s']:.3f} |"
        )


def earlier(arena: Arena, whole: Floats) -> Iterator[tuple[str, Floats]]:
    """Yield names and logs (n, 3) [m, m, rad] of earlier runs."""
    robot = default_robot()
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


def priority(arena: Arena, name: str) -> None:
    """Print a row for each drive."""
    print("doubt met after a share of the reference time, by doubt (without)")
    print(heads("arena, drive", "T / T_ref", *(f"{share:g}" for share in SHARES)))
    graph = bounced(arena)
    for drive in COMPARED_DRIVES:
        robot = vehicle(drive)
        without = plan(arena, robot)
        doubts = uncertainty(graph, without.coverage)
        by_doubt = plan(arena, robot, priority=doubts)
        met = zip(growth(by_doubt, doubts), growth(without, doubts), strict=True)
        cells = " | ".join(f"{100 * a:.0f} % ({100 * b:.0f})" for a, b in met)
        ratios = f"{by_doubt.report['ratio']:.3f} ({without.report['ratio']:.3f})"
        print(f"| {name}, {drive} | {ratios} | {cells} |")


def bounced(arena: Arena) -> Sensorgraph:
    """Return the graph of a random drive by the shipped robot."""
    robot = default_robot()
    drive = plan(arena, robot, planner="random_bounce", duration=60.0 * MINUTES, seed=1).trajectory
    return build([drive_and_log(drive, arena, robot, seed=1)])


def growth(made: Plan, doubts: Floats) -> list[float]:
    """Return the share of the doubt in reachable bins that lies in those met after each of SHARES."""
    grid = made.coverage
    weight = np.where(grid.reachable, doubts, 0.0)
    bins, inside = grid.bins(made.curve.log(10.0))
    flat = np.ravel_multi_index(tuple(bins.T), weight.shape)
    out = list[float]()
    for share in SHARES:
        n = int(10.0 * share * made.report["t_ref_s"])
        out.append(float(weight.ravel()[np.unique(flat[:n][inside[:n]])].sum() / weight.sum()))
    return out


def main() -> None:
    """Print the table of an option, arena by arena."""
    parser = parser_of(__doc__)
    options = {"margin": margin, "resume": resume, "priority": priority}
    parser.add_argument("option", choices=options)
    parser.add_argument("--arena", nargs="+", default=["office"])
    given = parser.parse_args()
    for name in given.arena:
        options[given.option](load_arena(name), name)


if __name__ == "__main__":
    main()
