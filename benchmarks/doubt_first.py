"""How much of a graph's doubt a drive meets by when, with `--priority` and without.

A robot bounces at random through an arena for some minutes, and what it logs becomes a graph. Then each kind of robot
plans to fill (x, y, phi), once by the doubts of that graph and once without: how much of all doubt lies in the bins
met after a share of the reference time, and what it costs.
"""

from __future__ import annotations

import numpy as np

from benchmarks.arguments import parser_of
from benchmarks.drives import drive_and_log
from benchmarks.places import vehicle
from planners import plan
from planners.arena import Arena
from planners.planning import Plan
from planners.types import Floats
from planners.vehicle import Drive
from sensorgraph.building.build import build
from sensorgraph.graph import Sensorgraph
from sensorgraph.loading import load_arena
from sensorgraph.planning.priority import uncertainty
from sensorgraph.world.robot import default_robot

SHARES = (0.1, 0.25, 0.5, 0.75, 1.0)
"""Of the reference time."""
MINUTES = 15.0
"""[min] of random driving."""
COMPARED_DRIVES: tuple[Drive, ...] = ("diff", "reeds_shepp", "dubins")


def main() -> None:
    """Print a row for each arena and drive."""
    parser = parser_of(__doc__)
    parser.add_argument("--arena", nargs="+", default=["square", "office"])
    options = parser.parse_args()
    print("doubt met after a share of the reference time, by doubt (without)")
    print("| arena, drive | T / T_ref | " + " | ".join(f"{share:g}" for share in SHARES) + " |")
    print("|---|---|" + "---|" * len(SHARES))
    for name in options.arena:
        arena = load_arena(name)
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


if __name__ == "__main__":
    main()
