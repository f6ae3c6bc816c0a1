"""A plan fills (x, y, phi), is feasible, the same for the same seed, and goes round what is in the way."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import yaml
from planners_samples import door_arena, outlined, shipped

from planners import PLANNERS, Plan, PlanError, plan
from planners.arena import wrap
from planners.check import check
from planners.clearance import Barriers
from planners.coverage import Coverage
from planners.export import waypoints
from planners.joins.paths import connect
from planners.reach import reach
from planners.vehicle import Limits, Vehicle

ROBOT = Vehicle()


def fresh(made: Plan) -> Coverage:
    grid = made.coverage
    return Coverage.empty(
        origin=grid.origin, cell=grid.cell, cells=grid.reachable.any(axis=2), headings=grid.headings
    )


@pytest.fixture(scope="module")
def square() -> Plan:
    return plan(shipped("square"), ROBOT)


@pytest.fixture(scope="module")
def coarse() -> Plan:
    return plan(shipped("square"), ROBOT, cell=0.5, headings=8)


@pytest.mark.parametrize("phase", [0.0, 0.013, 0.037, 0.05, 0.071, 0.0999])
def test_every_reachable_bin_is_met_at_any_phase_of_the_log(square: Plan, phase: float) -> None:
    counted = fresh(square)
    counted.add(square.curve.log(10.0, phase))
    assert counted.fraction >= 0.999


def test_the_trajectory_alone_gives_the_reported_coverage(square: Plan) -> None:
    """Every fifth row of the 50 Hz trajectory is the 10 Hz log."""
    counted = fresh(square)
    counted.add(square.trajectory.poses[::5])
    assert counted.fraction == pytest.approx(square.report["coverage"], abs=1e-3)
    assert square.report["reachable_cells"] == counted.reachable.sum()
    assert square.report["covered_cells"] == square.coverage.covered.sum()


def test_the_plan_is_feasible_and_clear(square: Plan) -> None:
    found = check(square.trajectory, shipped("square"), ROBOT)
    assert found.count == 0
    assert found.min_clearance >= 0.219  # radius 0.20 and the margin of 0.02, to the resolution of the raster
    assert square.report["limit_violations"] == 0


def test_driving_time_is_near_the_reference(square: Plan) -> None:
    """(K-1) dphi / omega + h / v per cell, without accelerations, is 1; stops and spins take 1.2."""
    assert square.report["t_ref_s"] == pytest.approx(231 * (15 * np.pi / 8 + 0.25 / 0.4))
    assert square.report["ratio"] <= 1.15


def test_bins_are_met_in_the_middle_of_their_cells(square: Plan) -> None:
    """Where the inner half of a cell can be reached, the log has a pose in it, and in the middle half of the heading."""
    grid, reach_ = square.coverage, square.reach
    p = reach_.per_cell
    blocks = reach_.blocks(reach_.distance >= reach_.clearance + 0.01).reshape(*reach_.shape, p, p)
    rim = -(-p // 4)
    roomy = blocks[:, :, rim : p - rim, rim : p - rim].all(axis=(2, 3))
    assert roomy.sum() > 100
    assert ((grid.core > 0) & grid.reachable)[roomy].mean() > 0.985


@pytest.mark.parametrize("share", [0.013, 0.3, 0.77])
def test_any_prefix_of_a_plan_is_a_plan_that_ends_at_rest(square: Plan, share: float) -> None:
    stamp = share * square.curve.duration
    part = square.curve.until(stamp, ROBOT.limits.alpha)
    assert stamp - 10.0 < part.duration <= stamp + 1.0
    trajectory = part.trajectory()
    found = check(trajectory, shipped("square"), ROBOT)
    assert found.count == 0
    assert found.min_clearance >= 0.219
    np.testing.assert_allclose(part.sample(np.array([part.duration]))[1], 0.0, atol=1e-9)
    early = part.starts[-1]
    np.testing.assert_array_equal(
        part.sample(np.array([early]))[0], square.curve.sample(np.array([early]))[0]
    )


def test_stops_and_spins_are_slower_but_stand_still(square: Plan) -> None:
    made = plan(shipped("square"), ROBOT, planner="stop_and_spin")
    assert made.report["coverage"] == 1.0
    assert made.report["limit_violations"] == 0
    assert square.report["ratio"] < made.report["ratio"] <= 1.22


@pytest.mark.slow
def test_an_office_is_filled_too() -> None:
    made = plan(shipped("office"), ROBOT)
    assert made.report["coverage"] >= 0.999
    assert made.report["core_coverage"] >= 0.84
    assert made.report["ratio"] <= 1.15
    assert made.report["limit_violations"] == 0
    assert made.report["joins"]["failed"] == 0
    assert made.report["joins"]["planned"] > 0


SCRIPT = """
from test_planners_planning import fingerprint
print(fingerprint(5))
"""


def fingerprint(seed: int) -> str:
    """Return a hash of what the search and stops and spins drive, and how many joins OMPL planned."""
    made = [
        plan(door_arena(0.9), ROBOT, planner=planner, seed=seed, cell=0.5, headings=4)
        for planner in ("coverage", "stop_and_spin")
    ]
    data = [x.tobytes() for one in made for x in (one.trajectory.poses, one.trajectory.twists)]
    data += [waypoints(one).encode() for one in made]
    joins = sum(one.report["joins"]["planned"] for one in made)
    return f"{joins} {hashlib.sha256(b''.join(data)).hexdigest()}"


@pytest.mark.slow
def test_same_seed_same_plan_in_every_process_and_whatever_ran_before() -> None:
    """OMPL advances its random streams over a process; plans must not notice."""
    said = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True, cwd=Path(__file__).parent
    ).stdout.strip()
    other, same = fingerprint(6), fingerprint(5)
    assert said == same != other
    assert int(said.split()[0]) > 0


def test_a_wall_across_a_straight_join_makes_ompl_plan_round_it() -> None:
    arena = outlined(shapely.box(0, 0, 4, 3).difference(shapely.box(1.9, 0, 2.1, 2.0)))
    barriers = Barriers(arena)
    free = reach(arena, barriers, clearance=0.22, cell=0.25)
    starts, ends = np.array([[0.5, 0.5], [0.5, 0.5]]), np.array([[3.5, 0.5], [1.2, 2.5]])
    paths, joins = connect(starts, ends, reach=free, barriers=barriers, seed=1)
    assert (joins.direct, joins.planned, joins.failed) == (1, 1, 0)
    assert paths[1] is not None and len(paths[1]) == 2
    around = paths[0]
    assert around is not None
    np.testing.assert_allclose(around[[0, -1]], [[0.5, 0.5], [3.5, 0.5]], atol=1e-9)
    assert shapely.LineString(around).distance(shapely.boundary(arena.free)) >= 0.22 - 1e-9
    length = np.hypot(*np.diff(around, axis=0).T).sum()
    assert joins.planned_m == pytest.approx(length)
    shortest = 2 * np.hypot(1.4, 1.5) + 0.2  # over the wall's end without the robot's width
    assert shortest < length < 1.3 * shortest


def test_what_cannot_be_joined_is_counted_as_failed() -> None:
    arena = door_arena(0.0)
    barriers = Barriers(arena)
    free = reach(arena, barriers, clearance=0.22, cell=0.25)
    paths, joins = connect(
        np.array([[1.0, 1.0]]), np.array([[3.0, 1.0]]), reach=free, barriers=barriers, seed=0
    )
    assert paths == [None]
    assert (joins.direct, joins.planned, joins.failed) == (0, 0, 1)


def test_without_ompl_a_plan_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ompl", None)
    monkeypatch.delitem(sys.modules, "planners.ompl_frame", raising=False)
    with pytest.raises(PlanError, match="OMPL is not installed; pip install"):
        plan(outlined(shapely.box(0, 0, 2, 1.5)), ROBOT, cell=0.5, headings=4)


def test_importing_planners_does_not_import_ompl() -> None:
    code = "import sys, planners, planners.joins.paths; sys.exit('ompl' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.usefixtures("narrow_search_once")
def test_a_plan_begins_where_it_was_told_to() -> None:
    start = np.array([1.3, 2.2, 1.0])
    made = plan(door_arena(0.9), ROBOT, cell=0.5, headings=4, start=start)
    np.testing.assert_allclose(made.trajectory.poses[0], start, atol=1e-12)
    assert made.report["coverage"] == 1.0


@pytest.mark.usefixtures("narrow_search_once")
def test_a_closed_door_halves_what_counts_and_is_said() -> None:
    open_ = plan(door_arena(0.9), ROBOT, cell=0.5, headings=4)
    closed = plan(door_arena(0.0), ROBOT, cell=0.5, headings=4, start=np.array([1.0, 1.0, 0.0]))
    assert closed.report["coverage"] == 1.0
    assert closed.report["reachable_cells"] < 0.6 * open_.report["reachable_cells"]
    assert closed.trajectory.poses[:, 0].max() < 2.0
    assert "reachable" in closed.report["warnings"][0] or closed.reach.share >= 0.5


def test_resuming_plans_only_what_is_left(coarse: Plan) -> None:
    log = coarse.curve.log(10.0)
    half = log[: len(log) // 2]
    rest = plan(shipped("square"), ROBOT, cell=0.5, headings=8, visited=half, start=half[-1])
    assert rest.report["coverage"] >= 0.999
    assert rest.report["coverage_before"] == pytest.approx(0.5, abs=0.05)
    assert rest.trajectory.duration < 0.65 * coarse.trajectory.duration
    with pytest.raises(PlanError, match="covered already"):
        plan(shipped("square"), ROBOT, cell=0.5, headings=8, visited=log)


def test_single_headings_that_are_missing_all_over_take_less_than_all_of_them(coarse: Plan) -> None:
    """A quarter of the log is lost, in spells of half a second: less than a fresh plan, and never much more than by stops."""
    log = coarse.curve.log(10.0)
    kept = log[np.repeat(np.random.default_rng(1).random(len(log) // 5 + 1) < 0.75, 5)[: len(log)]]
    rest, stops = (
        plan(
            shipped("square"), ROBOT, planner=name, cell=0.5, headings=8, visited=kept, start=kept[-1]
        ).report
        for name in ("coverage", "stop_and_spin")
    )
    assert rest["coverage"] == stops["coverage"] == 1.0
    assert rest["drive_time_s"] < 0.9 * coarse.report["drive_time_s"]
    assert rest["drive_time_s"] < 1.05 * stops["drive_time_s"]


def test_priority_cells_come_first(coarse: Plan) -> None:
    nx, ny, n_phi = coarse.coverage.counts.shape
    priority = np.zeros((nx, ny, n_phi))
    priority[:, 3 * ny // 4 :] = 1.0  # the upper quarter of the arena
    made = plan(shipped("square"), ROBOT, cell=0.5, headings=8, priority=priority)
    assert made.report["coverage"] >= 0.999
    early = made.trajectory.poses[made.trajectory.stamps < 0.15 * made.trajectory.duration]
    assert early[:, 1].min() > 2.9
    with pytest.raises(PlanError, match="priority has shape"):
        plan(shipped("square"), ROBOT, priority=np.zeros((1, 1, 1)))


@pytest.mark.parametrize("planner", ["random_bounce", "wall_following"])
def test_baselines_are_feasible_and_see_far_less(square: Plan, planner: str) -> None:
    made = plan(shipped("square"), ROBOT, planner=planner, duration=600.0, seed=3)
    assert 600.0 <= made.trajectory.duration < 630.0
    assert made.report["limit_violations"] == 0
    assert made.report["min_clearance_m"] >= 0.219
    assert made.report["coverage"] < 0.5 * square.report["coverage"]


def test_wall_following_keeps_its_distance() -> None:
    """A disc along the walls of an empty room stays at one distance from them, round after round."""
    arena = outlined(shapely.box(0, 0, 4, 3))
    made = plan(arena, ROBOT, planner="wall_following", duration=300.0, start=np.array([0.5, 0.5, 0.0]))
    late = made.trajectory.poses[made.trajectory.stamps > 30.0, :2]
    away = Barriers(arena).distances(late)
    np.testing.assert_allclose(away, 0.22 + 0.15, atol=1e-6)
    assert made.trajectory.length > 2 * (2 * 3.26 + 2 * 2.26)


def test_waypoints_are_poses_with_quaternions_and_spins(square: Plan) -> None:
    data: dict[str, Any] = yaml.safe_load(waypoints(square))
    assert data["frame_id"] == "map"
    assert len(data["poses"]) == len(square.stops) + 1
    spins = sum(abs(stop["spin"]) > 5.0 for stop in data["poses"])
    assert spins >= square.report["reachable_positions"]
    for stop, (x, y, phi, spin) in zip(data["poses"], square.stops.tolist(), strict=False):
        q = stop["orientation"]
        assert (stop["position"]["x"], stop["position"]["y"]) == pytest.approx((x, y), abs=1e-6)
        assert np.cos(2 * np.arctan2(q["z"], q["w"]) - phi) == pytest.approx(1.0, abs=1e-12)
        assert stop["spin"] == pytest.approx(spin, abs=1e-6)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"planner": "boustrophedon"}, "expected one of coverage"),
        ({"cell": 0.0}, "cell is 0.0"),
        ({"cell": float("nan")}, "cell is nan"),
        ({"headings": 0}, "headings is 0"),
        ({"seed": -1}, "seed is -1"),
        ({"rate": -1.0}, "rate is -1"),
        ({"duration": 0.0, "planner": "random_bounce"}, "duration is 0"),
        ({"start": np.array([1.0, 2.0])}, "expected three finite numbers"),
        ({"start": np.array([0.05, 2.0, 0.0])}, r"0\.050 m from a wall"),
        ({"start": np.array([1.3, 2.7, 0.0])}, "inside a wall"),
    ],
)
def test_bad_input_is_one_line(options: dict[str, Any], says: str) -> None:
    with pytest.raises(PlanError, match=says) as caught:
        plan(shipped("square"), ROBOT, **options)
    assert "\n" not in str(caught.value)


def test_a_robot_that_fits_nowhere_is_told_so() -> None:
    with pytest.raises(PlanError, match="does not fit"):
        plan(shipped("square"), Vehicle(footprint_radius=2.5))


@pytest.mark.parametrize("planner", sorted(set(PLANNERS) - {"coverage"}))
def test_cars_are_refused_with_what_works(planner: str) -> None:
    car = Vehicle(drive="reeds_shepp", limits=Limits(turning_radius=0.4))
    with pytest.raises(PlanError, match="drive"):
        plan(
            shipped("square"),
            car,
            planner=planner,
            targets=np.array([[1.0, 1.0, 0.0]]) if planner == "views" else None,
        )


@pytest.mark.parametrize(
    ("cell", "headings", "limits"),
    [
        (0.25, 1, Limits()),
        pytest.param(0.8, 36, Limits(omega=3.0, alpha=8.0), marks=pytest.mark.slow),
        pytest.param(0.2, 5, Limits(v=0.1, a=0.05), marks=pytest.mark.slow),
        pytest.param(0.5, 16, Limits(omega=0.2), marks=pytest.mark.slow),
    ],
)
def test_other_grids_and_robots_are_filled_too(cell: float, headings: int, limits: Limits) -> None:
    """A quick robot must slow its spins for the log to see every heading."""
    vehicle = Vehicle(limits=limits)
    made = plan(door_arena(0.9), vehicle, cell=cell, headings=headings)
    assert made.report["coverage"] >= 0.999
    assert made.report["limit_violations"] == 0


@pytest.mark.usefixtures("narrow_search_once")
def test_progress_runs_to_its_total() -> None:
    said: list[tuple[int, int]] = []
    plan(
        door_arena(0.9), ROBOT, cell=0.5, headings=4, progress=lambda done, total: said.append((done, total))
    )
    assert said
    assert all(0 <= done <= total for done, total in said)
    assert said[-1][0] == said[-1][1]


@pytest.mark.slow
@pytest.mark.parametrize(("drive", "share"), [("reeds_shepp", 0.999), ("dubins", 0.995)])
def test_cars_fill_what_they_can_reach(drive: Any, share: float) -> None:
    """v, omega, a, radius and clearance hold; a Dubins car never backs."""
    car = Vehicle(drive=drive, limits=Limits(turning_radius=0.4))
    made = plan(shipped("square"), car)
    assert made.report["coverage"] >= share
    assert made.report["limit_violations"] == 0
    assert made.report["min_clearance_m"] >= 0.219
    assert made.report["ratio"] <= 2.3
    if drive == "dubins":
        assert made.trajectory.twists[:, 0].min() >= 0


@pytest.mark.slow
def test_a_car_slows_down_where_its_radius_would_turn_it_too_fast() -> None:
    car = Vehicle(drive="reeds_shepp", limits=Limits(turning_radius=0.3, omega=0.8))
    made = plan(outlined(shapely.box(0, 0, 2.5, 2.0)), car, cell=0.5, headings=8)
    assert made.report["coverage"] >= 0.999
    assert made.report["limit_violations"] == 0
    assert abs(made.trajectory.twists[:, 0]).max() <= 0.8 * 0.3 + 1e-9


def test_a_start_from_which_a_dubins_car_gets_nowhere_is_refused_with_a_better_one() -> None:
    """Facing a corner it can neither turn nor back."""
    car = Vehicle(drive="dubins", limits=Limits(turning_radius=0.4))
    room = outlined(shapely.box(0, 0, 2.4, 2.0))
    with pytest.raises(PlanError, match=r"reach and return from only 0 of .* bins; start at -?\d") as caught:
        plan(room, car, start=np.array([0.3, 0.3, -2.3]), headings=8, cell=0.5)
    assert "\n" not in str(caught.value)


def test_views_behind_a_closed_door_are_an_error_of_one_line() -> None:
    targets = np.array([[3.4, 0.6, 0.0]])
    start = np.array([0.6, 0.6, 0.0])
    with pytest.raises(PlanError, match="no path leads to any pose to visit; choose another start"):
        plan(door_arena(0.3), ROBOT, planner="views", targets=targets, start=start, cell=0.5, headings=4)


def test_views_are_all_visited_and_seen_by_the_log() -> None:
    """Each pose asked for is in the log, standing still, however the walls lie between them."""
    targets = np.array([[1.0, 1.0, 0.3], [0.6, 3.4, -2.0], [0.5, 0.6, 3.1], [3.2, 0.9, 1.5]])
    made = plan(shipped("square"), ROBOT, planner="views", targets=targets, seed=3)
    stills = made.trajectory.poses[np.abs(made.trajectory.twists).max(axis=1) == 0]
    for target in targets:
        off = stills - target
        off[:, 2] = wrap(off[:, 2])
        assert np.abs(off).max(axis=1).min() < 1e-6
    assert made.report["limit_violations"] == 0
    assert made.report["joins"]["failed"] == 0
