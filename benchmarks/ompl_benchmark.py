"""OMPL's own Benchmark tool over the planners of our registry and planners of OMPL, on one problem.

    python -m benchmarks.ompl_benchmark                                    # square arena, diff drive
    python -m benchmarks.ompl_benchmark --drive reeds_shepp --runs 3 -o square.log

The others drive from start to goal; our coverage planners do so through every bin. A planner of your own is named by
`--own module:Class`. The log is OMPL's, to be read by its ompl_benchmark_statistics. Nothing is simplified, since that
would cut the drive through the bins short.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from ompl import geometric, tools, util  # type: ignore[import-untyped]

from benchmarks.arguments import parser_of
from benchmarks.places import vehicle
from planners.joins.ompl_process import planner_named
from planners.ompl_planner import problem, registry_planners
from sensorgraph.loading import load_arena

START, GOAL = np.array([0.8, 0.8, 0.3]), np.array([3.3, 0.7, 1.0])
"""[m, m, rad]"""
TIME, DURATION = 120.0, 60.0
"""[s] for each run, and that the baselines drive."""
OMPL_COLUMNS = {
    "solved BOOLEAN": "solved",
    "correct solution BOOLEAN": "correct",
    "time REAL": "time_s",
    "solution length REAL": "length",
    "solution segments INTEGER": "segments",
}


def main() -> None:
    """Run the benchmark, print a line for each run, write OMPL's log."""
    parser = parser_of(__doc__)
    parser.add_argument("--drive", default="diff", choices=["diff", "reeds_shepp", "dubins"])
    parser.add_argument("--cell", type=float, default=0.25, help="[m]")
    parser.add_argument("--headings", type=int, default=16)
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--own", nargs="*", default=[], help="module:Class of planners of your own")
    parser.add_argument("-o", "--out", type=Path, default=Path("ompl_benchmark.log"))
    options = parser.parse_args()
    util.setLogLevel(util.LOG_ERROR)
    arena = load_arena("square")
    robot = vehicle(options.drive)
    setup = problem(arena, robot, START, GOAL)
    information = setup.getSpaceInformation()
    benchmark = tools.Benchmark(setup, f"square {options.drive}")
    benchmark.addPlanner(geometric.RRTConnect(information))
    benchmark.addPlanner(geometric.KPIECE1(information))
    for name in options.own:
        benchmark.addPlanner(planner_named(name, geometric, information))
    for ours in registry_planners(
        information, arena, robot, duration=DURATION, cell=options.cell, headings=options.headings
    ):
        benchmark.addPlanner(ours)
    benchmark.benchmark(request(options.runs, TIME))
    for name, run in runs(benchmark):
        print(f"{name:24} " + "  ".join(f"{head} {run[key]}" for key, head in OMPL_COLUMNS.items()))
    benchmark.saveResultsToFile(str(options.out))
    print(f"wrote {options.out}")


def request(count: int, seconds: float) -> Any:
    """Return OMPL's request for so many runs of each planner."""
    return tools.Request(
        maxTime=seconds,
        maxMem=4096.0,
        runCount=count,
        displayProgress=False,
        saveConsoleOutput=False,
        simplify=False,
    )


def runs(benchmark: Any) -> list[tuple[str, dict[str, str]]]:
    """Return the planner and the properties of each run."""
    found = benchmark.getRecordedExperimentData().planners
    return [(planner.name, run.to_dict()) for planner in found for run in planner.runs]


if __name__ == "__main__":
    main()
