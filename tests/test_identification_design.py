"""Design in an identified world: what is asked is met, predicted beforehand, and the drive holds the prediction."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shapely.geometry import box

from logs.run import RangeSensor, Run
from planners.arena import Arena
from robotmodic_ident import polynomial
from sensorgraph.building.build import build
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.identification.design import (
    DESIGN,
    ControllerDesign,
    design,
    drive_design,
    start_poses,
)
from sensorgraph.identification.design_task import DesignTask, Interval, follows_wall, predicted, quantities
from sensorgraph.identification.population_drive import ClosedLoopPopulation
from sensorgraph.identification.signals import rays_of, variable
from sensorgraph.recording.controllers import PolynomialController
from sensorgraph.recording.identified_world import IdentifiedWorld
from sensorgraph.world.drive import ExecutedDrive, react
from sensorgraph.world.identified_arena import arena_of
from sensorgraph.world.raycast import cast
from sensorgraph.world.robot import Robot, load_robot
from sensorgraph.world.wall_distance import WallDistance

pytestmark = pytest.mark.usefixtures("trusted_scans")

QUICK = replace(DESIGN, population=12, rounds=8, search_duration=15.0, n_predicted=5)
TASK = DesignTask(wall_distance=0.6, speed=0.25, duration=20.0)
INPUTS = ("L0-40", "L70-110")


@pytest.fixture(scope="module")
def arena() -> Arena:
    corners = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 3.0], [0.0, 3.0]])
    walls = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    names = tuple(f"room/edge_{i}" for i in range(4))
    return Arena(free=box(0, 0, 3, 3), walls=walls, names=names, surfaces=("wall",) * 4)


@pytest.fixture(scope="module")
def robot() -> Robot:
    shipped = load_robot()
    few = RangeSensor(bearings=np.radians(np.arange(-90.0, 91.0, 10.0)), sigma=0.01, range_max=8.0)
    return replace(shipped, sensor=replace(few, mount=shipped.sensor.mount))


@pytest.fixture(scope="module")
def graph(arena: Arena, robot: Robot) -> Sensorgraph:
    rng = np.random.default_rng(0)
    poses = np.column_stack([rng.uniform(0.3, 2.7, (400, 2)), rng.uniform(-3, 3, 400)])
    ranges = cast(arena, poses, robot.sensor).ranges + 0.01 * rng.normal(size=(400, robot.sensor.n_rays))
    stamps = np.arange(400.0)
    run = Run(sensor=robot.sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses)
    return build([run], calibrate=False)


@pytest.fixture(scope="module")
def found(graph: Sensorgraph, robot: Robot) -> ControllerDesign:
    return design(graph, TASK, robot, inputs=INPUTS, degree=1, settings=QUICK)


def test_design_keeps_the_wall_distance_and_the_drive_holds_the_prediction(
    found: ControllerDesign, arena: Arena, robot: Robot
) -> None:
    assert abs(found.prediction["wall_distance_m"].mean - TASK.wall_distance) < 0.15
    assert found.prediction["contacts"].mean == 0
    assert found.prediction["turn_change_rad_s2"].mean < 1.3 * TASK.smoothness
    drive, driven = drive_design(found, arena, robot)
    turned = np.unwrap(np.arctan2(*(drive.poses[:, :2] - 1.5).T[::-1]))
    assert turned[-1] - turned[0] > 1.5  # along the walls, which are on the right; not in a circle before one
    assert driven.contacts == 0
    assert abs(driven.wall_distance_m - found.prediction["wall_distance_m"].mean) < 0.03


def test_saved_design_is_the_controller_that_was_predicted(
    found: ControllerDesign, robot: Robot, tmp_path: Path
) -> None:
    found.save(tmp_path / "controller.json")
    again = PolynomialController.load(tmp_path / "controller.json", robot)
    own = PolynomialController(found.model, found.facts, robot, name="own")
    readings = np.linspace(0.5, 2.0, robot.sensor.n_rays)
    assert again(readings) == pytest.approx(own(readings), abs=1e-12)
    assert again(readings)[0] == TASK.speed
    json.dumps(found.to_dict(), allow_nan=False)


def test_population_drives_as_the_embedded_robot_does(
    graph: Sensorgraph, robot: Robot, found: ControllerDesign
) -> None:
    """The quick simulation of the search agrees with the one of the prediction, but for noise and steps of time."""
    walls = WallDistance(arena_of(graph))
    world = IdentifiedWorld(graph, robot, 3)
    steer = PolynomialController(found.model, found.facts, robot, name="own")
    slow = react(steer, world.scan, found.start, 15.0, robot, clearance=walls)
    rays = {variable(name): world.rays[rays_of(robot.sensor, name)] for name in INPUTS}
    quick = ClosedLoopPopulation(graph.model, robot, walls, rays, 3, np.zeros(3))  # type: ignore[arg-type]
    terms = polynomial([f"{name}(k)" for name in rays], 1)
    theta = np.array(
        [dict(zip(found.model.terms.names, found.model.theta, strict=True))[n] for n in terms.names]
    )
    done = quick.drive(
        terms, theta[None], np.zeros(2), found.start[None], speed=TASK.speed, wall_distance=0.6, duration=15.0
    )
    away = quantities(slow, walls, np.array([1.5, 1.5]), 0.1)
    assert done.touching.max() == 0
    assert abs(np.sqrt(done.distance_error[0, 0]) - _error(slow, walls)) < 0.03
    assert away.speed_m_s > 0.8 * TASK.speed
    assert abs(done.turn_change[0, 0] - away.turn_change_rad_s2) < 0.2 * away.turn_change_rad_s2


def _error(drive: ExecutedDrive, walls: WallDistance) -> float:
    """Return the root mean square of both distances that the search looks at."""
    poses = drive.at(np.arange(0.0, 15.0, 0.1))
    own = [(walls(x, y) - 0.6) ** 2 for x, y, _ in poses]
    right = [(walls(x + 0.2 * np.sin(phi), y - 0.2 * np.cos(phi)) - 0.4) ** 2 for x, y, phi in poses]
    return float(np.sqrt(np.mean(own) + np.mean(right)))


def test_starts_have_the_wall_on_the_right(arena: Arena, robot: Robot) -> None:
    walls = WallDistance(arena)
    starts = start_poses(walls, arena, 0.5, 3)
    for x, y, phi in starts:
        assert abs(walls(x, y) - 0.5) < 0.05
        right = walls(x + 0.2 * np.sin(phi), y - 0.2 * np.cos(phi))
        assert right < walls(x, y) - 0.15


def test_a_search_that_ends_in_a_circle_begins_again(graph: Sensorgraph, robot: Robot) -> None:
    """The first search of this seed finds a robot that touches the wall twice in each drive."""
    task = DesignTask(wall_distance=0.35, speed=0.4, duration=20.0)
    few = replace(QUICK, population=8, rounds=2)
    again = design(graph, task, robot, inputs=INPUTS, settings=few, seed=2)
    assert again.n_failed == again.to_dict()["n_failed"] == 0
    assert again.prediction["contacts"].mean == 0


def test_a_wall_is_followed_where_it_stays_on_the_right() -> None:
    t = np.arange(0.0, 40.0, 0.1)
    along = np.column_stack([0.1 * t, np.full(len(t), 0.5), np.zeros(len(t))])
    turn = 2 * np.pi * t / 8.0
    circle = np.column_stack([0.3 * np.sin(turn), 0.5 - 0.3 * np.cos(turn), turn])
    for poses, contacts, follows in ((along, 0, True), (along, 1, False), (circle, 0, False)):
        drive = ExecutedDrive(
            stamps=t, poses=poses, twists=np.zeros((len(t), 2)), cmd_stamps=t, commands=np.zeros((len(t), 2)),
            contacts=contacts,
        )  # fmt: skip
        assert follows_wall(drive, lambda _, y: float(y)) == follows


def test_lap_of_a_circle_is_its_period() -> None:
    t = np.arange(0.0, 40.0, 0.01)
    angle = 2 * np.pi * t / 16.0
    poses = np.column_stack([np.cos(angle), np.sin(angle), angle + np.pi / 2])
    drive = ExecutedDrive(
        stamps=t, poses=poses, twists=np.zeros((len(t), 2)), cmd_stamps=np.arange(0.0, 40.0, 0.05),
        commands=np.zeros((800, 2)), contacts=0,
    )  # fmt: skip
    found = quantities(drive, lambda x, y: 2.0 - float(np.hypot(x, y)), np.zeros(2), 0.1)
    assert found.lap_s == pytest.approx(16.0, rel=1e-3)
    assert found.wall_distance_m == pytest.approx(1.0)
    assert found.speed_m_s == pytest.approx(2 * np.pi / 16, rel=1e-3)
    assert predicted([found, found])["lap_s"].holds(16.0) is not None


def test_interval_holds_what_lies_within() -> None:
    assert Interval(mean=1.0, low=0.9, high=1.1).holds(1.05)
    assert not Interval(mean=1.0, low=0.9, high=1.1).holds(1.2)
    same = Interval(mean=0.1995208, low=0.1995207, high=0.1995209)  # all print 0.2
    assert same.holds(0.1995215) and not same.holds(0.201)
    assert Interval(mean=float("nan"), low=float("nan"), high=float("nan")).holds(float("nan"))


@pytest.mark.parametrize(
    ("task", "said"),
    [
        (DesignTask(wall_distance=0.1, speed=0.2), "wall distance is 0.1 m, expected more than 0.2"),
        (DesignTask(wall_distance=0.5, speed=9.0), "speed is 9 m/s, expected more than 0 and at most 0.4"),
        (DesignTask(wall_distance=1.9, speed=0.2), "no place is 1.9 m from its nearest wall"),
    ],
)
def test_what_the_robot_cannot_do_is_refused(
    graph: Sensorgraph, robot: Robot, task: DesignTask, said: str
) -> None:
    with pytest.raises(SensorgraphError, match=said):
        design(graph, task, robot, settings=QUICK)
