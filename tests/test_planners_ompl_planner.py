"""The coverage planner is one of OMPL's: it solves OMPL's problems, and runs in OMPL's Benchmark beside RRTConnect.

OMPL runs in a process of its own, whose answers are held against what OMPL itself says of them.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

START, GOAL = [0.8, 0.8, 0.3], [3.2, 2.2, -1.0]
HEADER = """
import json, sys
sys.path.insert(0, sys.argv[1])
import numpy as np
from ompl import geometric, util
from planners.ompl_frame import pose_of
from planners.ompl_planner import CoveragePlanner, problem
from planners.vehicle import Limits, Vehicle
from planners_samples import door_arena, shipped
util.setLogLevel(util.LOG_NONE)
START, GOAL = np.array([0.8, 0.8, 0.3]), np.array([3.2, 2.2, -1.0])
def setup_of(drive, arena=None):
    vehicle = Vehicle(drive=drive, limits=Limits(turning_radius=0.0 if drive == "diff" else 0.3))
    arena = arena or door_arena(1.2)
    setup = problem(arena, vehicle, START, GOAL)
    return setup, CoveragePlanner(setup.getSpaceInformation(), arena, vehicle, cell=0.5, headings=4)
"""
SOLVE = """
answers = {}
for drive in ("diff", "reeds_shepp"):
    setup, planner = setup_of(drive)
    setup.setPlanner(planner)
    setup.solve(600.0)
    path = setup.getSolutionPath()
    n = path.getStateCount()
    answers[drive] = {
        "exact": setup.haveExactSolutionPath(),
        "valid": path.check(),
        "ends": [pose_of(path.getState(k)).tolist() for k in (0, n - 1)],
        "length": path.length(),
        "coverage": planner.plan.report["coverage"],
        "path_m": planner.plan.report["path_m"],
        "states": n,
    }
    setup.clear()
    answers[drive]["cleared"] = planner.plan is None
print(json.dumps(answers))
"""
BENCHMARK = """
from ompl import tools
from benchmarks.ompl_benchmark import request, runs
from planners.ompl_frame import DrivingTime
from planners.ompl_planner import registry_planners
setup, planner = setup_of("diff")
benchmark = tools.Benchmark(setup, "door")
information = setup.getSpaceInformation()
benchmark.addPlanner(geometric.RRTConnect(information))
for one in registry_planners(information, planner.arena, planner.vehicle, duration=20.0, cell=0.5, headings=4):
    benchmark.addPlanner(one)
benchmark.benchmark(request(1, 600.0))
objective = setup.getProblemDefinition().getOptimizationObjective()
a, b = (information.getStateSpace().allocState() for _ in range(2))
for state, pose in ((a, (0.5, 0.5, 0.0)), (b, (0.5, 1.3, 0.2))):
    state.setXY(*pose[:2])
    state.setYaw(pose[2])
print(json.dumps({"runs": runs(benchmark), "cost": objective.motionCost(a, b).value()}))
"""
STOPPED = """
setup, planner = setup_of("diff")  # the kernels are compiled here, and not in the half second
setup.setPlanner(planner)
setup.solve(600.0)
setup, planner = setup_of("diff", shipped("square"))
planner.cell, planner.headings = 0.2, 24
setup.setPlanner(planner)
setup.solve(0.5)
definition = setup.getProblemDefinition()
path = setup.getSolutionPath()
print(json.dumps({
    "exact": setup.haveExactSolutionPath(),
    "approximate": definition.hasApproximateSolution(),
    "difference": definition.getSolutionDifference(),
    "coverage": planner.plan.report["coverage"],
    "end": pose_of(path.getState(path.getStateCount() - 1)).tolist(),
}))
"""


def said(script: str) -> Any:
    """Run a script in a process of its own and return what it prints."""
    tests = Path(__file__).parent
    done = subprocess.run(
        [sys.executable, "-c", HEADER + script, str(tests)],
        capture_output=True,
        text=True,
        check=False,
        cwd=tests.parent,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.strip().splitlines()[-1])


@pytest.mark.slow
def test_ompl_has_its_problem_solved_from_start_to_goal_through_every_bin() -> None:
    for drive, found in said(SOLVE).items():
        assert found["exact"]
        assert found["valid"]  # by OMPL's own motions between the states
        np.testing.assert_allclose(found["ends"], [START, GOAL], atol=1e-6)
        assert found["coverage"] >= 0.995
        assert found["cleared"]
        if drive == "reeds_shepp":  # chords and arcs of one length, but for those that hold a cusp
            assert found["length"] == pytest.approx(found["path_m"], rel=0.02)


@pytest.mark.slow
def test_ompls_benchmark_runs_all_our_planners_beside_rrtconnect() -> None:
    found = said(BENCHMARK)
    runs = found["runs"]
    names = [name.removeprefix("geometric_") for name, _ in runs]
    assert names == ["RRTConnect", "Coverage", "RandomBounce", "WallFollowing", "StopAndSpin"]
    assert all(run["solved BOOLEAN"] == run["correct solution strict BOOLEAN"] == "1" for _, run in runs)
    length = {name: float(run["solution length REAL"]) for name, (_, run) in zip(names, runs, strict=True)}
    assert min(length["Coverage"], length["StopAndSpin"]) > 5 * length["RRTConnect"]
    assert found["cost"] == pytest.approx(0.8 / 0.4)  # 0.8 m at 0.4 m/s, the turn meanwhile


@pytest.mark.slow
def test_what_ompl_stops_is_an_approximate_solution_that_leads_to_the_goal() -> None:
    found = said(STOPPED)
    assert found["approximate"]
    assert 0.0 < found["difference"] < 1.0
    assert found["difference"] == pytest.approx(1.0 - found["coverage"])
    np.testing.assert_allclose(found["end"], [3.2, 2.2, -1.0], atol=1e-6)
