"""What a robot that does not track exactly logs of a plan: coverage by error, with and without the inner-half margin.

    python -m benchmarks.tracking_error                    # the shipped square
    python -m benchmarks.tracking_error --arena office

The margin is the planner's own: in cells whose inner half is in reach a bin counts only there, in the middle half of
its heading. Without it any logged pose in the bin will do. `all` counts every reachable bin, `roomy` those cells only;
the others are slivers along walls, where no plan can keep a margin. The error is a random walk that is pulled back to the
plan (Ornstein-Uhlenbeck, 2 s), the same along and across, and 0.5° of heading per centimetre; the last
row is the shipped robot as `sensorgraph record` simulates it, with its controller, motors and pose noise.
"""

from __future__ import annotations

from unittest import mock

import numpy as np

from benchmarks.arguments import parser_of
from planners import Plan, plan
from planners.arena import Arena, wrap
from planners.search import area
from planners.types import Bools, Floats
from sensorgraph.loading import load_arena
from sensorgraph.planning.plan_folder import counted
from sensorgraph.world.drive import follow
from sensorgraph.world.robot import load_robot
from sensorgraph.world.wall_distance import WallDistance

ERRORS = (0.0, 0.01, 0.02, 0.035, 0.05, 0.07)
"""[m] root mean square distance from the plan."""
HEADING = np.radians(0.5) / 0.01
"""[rad/m] root mean square error of heading by that of the place."""
MEMORY = 2.0
"""[s] that an error lasts."""
N_SEEDS = 5
"""Drives of each error, of which the mean is told."""


def main() -> None:
    """Print coverage and core by error for both plans."""
    parser = parser_of(__doc__)
    parser.add_argument("--arena", default="square")
    options = parser.parse_args()
    arena = load_arena(options.arena)
    plans = {"inner half": plan(arena, load_robot(None))}
    roomy = area.search_area(plans["inner half"].reach).inner
    with mock.patch.object(area, "MIN_INNER_SHARE", np.inf):
        plans["anywhere"] = plan(arena, load_robot(None))
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
    robot = load_robot(None)
    driven = follow(made.trajectory, robot, clearance=WallDistance(arena), rng=np.random.default_rng(0))
    poses = driven.at(np.arange(0.0, driven.stamps[-1], 1.0 / robot.sensor.rate))
    return np.column_stack([poses[:, :2], wrap(poses[:, 2])])


def share_of(made: Plan, poses: Floats, roomy: Bools) -> Floats:
    """Return (3,) coverage of logged poses (n, 3) on the plan's grid, that of the cells `roomy` alone, and core."""
    grid = counted(made.coverage, poses)
    within = grid.reachable & roomy[:, :, None]
    return np.array([grid.fraction, (grid.covered & within).sum() / within.sum(), grid.core_fraction])


if __name__ == "__main__":
    main()
