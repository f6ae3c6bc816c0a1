"""Several sensors as one: rings of robot.yaml, rays from their own places, cones, and equations for each ray."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import further

import sensorgraph as sg
from planners.arena import Arena, wrap
from planners.trajectory import Trajectory
from sensorgraph.errors import SensorgraphError
from sensorgraph.world.orientation import CAUSES, orientation
from sensorgraph.world.raycast import cast
from sensorgraph.world.robot import parse_robot
from sensorgraph.world.scene import Scene

RING = """
name: sonar robot
footprint_radius: 0.2
sensors: [{ring: 16, radius: 0.2, cone: %s}]
sensor: {range_min: 0.05, range_max: 8.0, sigma: 0.0, resolution: 0.0, rate: 5.0}
"""


def distances(x: np.ndarray, y: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Range along rays in an empty room of 4 x 3 m, in closed form."""
    cos, sin = np.cos(theta), np.sin(theta)
    with np.errstate(divide="ignore", invalid="ignore"):
        across = np.where(cos > 0, 4 - x, x) / np.abs(cos)
        along = np.where(sin > 0, 3 - y, y) / np.abs(sin)
    return np.minimum(across, along)


@pytest.fixture
def empty_room(room: Arena) -> Arena:
    walls = np.array([[[0, 0], [4, 0]], [[4, 0], [4, 3]], [[4, 3], [0, 3]], [[0, 3], [0, 0]]], dtype=float)
    return Arena(free=room.free.convex_hull, walls=walls, names=("a", "b", "c", "d"), surfaces=("wall",) * 4)


def test_a_ring_of_robot_yaml_looks_outwards_from_its_rim() -> None:
    sensor = parse_robot(RING % 0.3).sensor
    assert sensor.n_rays == 16 and (sensor.cones == 0.3).all() and sensor.rate == 5.0
    np.testing.assert_allclose(np.hypot(*sensor.origins.T), 0.2)
    np.testing.assert_allclose(
        np.arctan2(sensor.origins[:, 1], sensor.origins[:, 0]), sensor.bearings, atol=1e-12
    )


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("sensors: 16", "expected a list such as"),
        ("sensors: [{ring: 16, radios: 0.2}]", "did you mean `sensors[0].radius`"),
        ("sensors: [{ring: 0}]", "expected a value above 0"),
        ("sensors: [{mount: [0, 0]}]", "expected 3 numbers"),
        ("sensors: [{ring: 4}]\nsensor: {n_rays: 4}", "`sensor.n_rays` does not go with `sensors`"),
    ],
)
def test_a_mistake_in_sensors_is_one_line(text: str, says: str) -> None:
    with pytest.raises(SensorgraphError) as caught:
        parse_robot(text)
    assert says in str(caught.value) and "\n" not in str(caught.value)


def test_every_ray_starts_where_its_sensor_sits(empty_room: Arena) -> None:
    text = "sensors: [{mount: [0.3, 0.1, 0.2], n_rays: 5, fov: 2.0}, {mount: [-0.3, 0, 3.0], n_rays: 4, fov: 1.0}]"
    sensor = parse_robot(text).sensor
    poses = np.array([[1.0, 1.2, 0.4], [2.5, 2.0, -2.0]])
    c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    x = poses[:, :1] + c * sensor.origins[:, 0] - s * sensor.origins[:, 1]
    y = poses[:, 1:2] + s * sensor.origins[:, 0] + c * sensor.origins[:, 1]
    want = distances(x, y, poses[:, 2:] + sensor.bearings)
    np.testing.assert_allclose(cast(empty_room, poses, sensor).ranges, want, atol=1e-9)
    scene = Scene(
        arena=empty_room,
        sensor=sensor,
        stamps=np.arange(2.0),
        motion=lambda t: poses[np.rint(t).astype(int)],
        span=1.0,
    )
    np.testing.assert_allclose(scene.run().reading, want, atol=1e-9)


def test_a_cone_measures_its_nearest_surface(empty_room: Arena) -> None:
    sensor = parse_robot(RING % 0.6).sensor
    poses = np.array([[1.0, 1.2, 0.4], [3.3, 2.0, -2.0]])
    scene = Scene(
        arena=empty_room,
        sensor=sensor,
        stamps=np.arange(2.0),
        motion=lambda t: poses[np.rint(t).astype(int)],
        span=1.0,
    )
    got = scene.run().reading
    c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    x = poses[:, :1] + c * sensor.origins[:, 0] - s * sensor.origins[:, 1]
    y = poses[:, 1:2] + s * sensor.origins[:, 0] + c * sensor.origins[:, 1]
    fan = np.linspace(-0.3, 0.3, 2001)
    want = distances(x[..., None], y[..., None], (poses[:, 2:] + sensor.bearings)[..., None] + fan).min(
        axis=-1
    )
    np.testing.assert_allclose(got, want, rtol=1e-2)  # rays 1 degree apart fill the cone
    assert (got >= want - 1e-9).all()


def winding() -> Trajectory:
    """Drive through the room for two minutes."""
    t = np.arange(0, 120, 0.02)
    poses = np.column_stack([2 + 1.2 * np.sin(0.21 * t), 1.5 + 0.8 * np.sin(0.13 * t), np.zeros_like(t)])
    heading = np.unwrap(np.arctan2(np.gradient(poses[:, 1]), np.gradient(poses[:, 0])))
    poses[:, 2] = np.angle(np.exp(1j * heading))
    twists = np.column_stack([np.hypot(*np.gradient(poses[:, :2], axis=0).T), np.gradient(heading)]) / 0.02
    return Trajectory(stamps=t, poses=poses, twists=twists, primitives=np.full(len(t), "arc"))


FRONT_AND_REAR = """
sensors:
  - {name: front, mount: [0.35, 0.1, 0.3], n_rays: 40, fov: 3.0}
  - {name: rear, mount: [-0.35, -0.1, 3.3], n_rays: 40, fov: 3.0}
sensor: {sigma: 0.005, resolution: 0.0, rate: 5.0}
pose: {sigma_xy: 0.0005, sigma_yaw: 0.0003}
"""


def test_faces_of_front_and_rear_laser_know_where_each_ray_starts(empty_room: Arena) -> None:
    run = sg.record(winding(), empty_room, parse_robot(FRONT_AND_REAR))
    graph = sg.build(run, calibrate=False)
    assert sg.evaluate(graph, run).all["median_m"] < 0.01  # one origin for all rays: 0.1 m
    poses = np.array([[2.0, 1.5, 0.4], [1.2, 1.1, 2.0]])
    want = cast(empty_room, poses, run.sensor).ranges
    found = graph.predict(poses)
    assert found.answered.mean() > 0.9
    np.testing.assert_allclose(found.ranges[found.answered], want[found.answered], atol=0.02)  # 4 sigma
    some = graph.predict(poses, rays=[3, 70])
    np.testing.assert_array_equal(some.ranges, found.ranges[:, [3, 70]])
    equations = re.findall(r"face \d+: r = \((.*?)\) / \((.*?)\)", graph.model.equation(3))
    x, y, phi = poses[0]
    at = {"": 1.0, "x": x, "y": y, "c": np.cos(phi), "s": np.sin(phi)}

    def value(text: str) -> float:
        return sum(
            float(number.replace(" ", "")) * at[symbol]
            for number, symbol in re.findall(r"([+-]? ?[\d.]+) ?([xycs]?)", text)
        )

    printed = [value(above) / value(below) for above, below in equations if value(below) < 0]
    assert min(r for r in printed if r > 0) == pytest.approx(want[0, 3], abs=0.02)


def test_a_recorded_ring_is_read_built_predicted_and_scored(tmp_path: Path, empty_room: Arena) -> None:
    drive = winding()
    robot = parse_robot((RING % 0.26).replace("sigma: 0.0", "sigma: 0.01"))
    run = sg.record(drive, empty_room, robot, path=tmp_path / "ring.mcap")
    again = sg.read(tmp_path / "ring.mcap")
    assert again.sensor.is_composite and again.ranges.shape == run.ranges.shape
    faces = sg.build(again)
    assert faces.model.faces.n_faces == 4 and sg.evaluate(faces, again).all["median_m"] < 0.01
    graph = sg.build(again, model="polynomial", degree=2, harmonics=2, n_terms=12)
    graph.save(tmp_path / "ring.sensorgraph")
    kept = sg.Sensorgraph.load(tmp_path / "ring.sensorgraph")
    np.testing.assert_array_equal(kept.sensor.origins, again.sensor.origins)
    np.testing.assert_array_equal(kept.sensor.cones, again.sensor.cones)
    assert sg.evaluate(kept, again).all["median_m"] < 0.3


@pytest.mark.parametrize("as_map", [False, *further(True)], ids=["against itself", "against the arena"])
@pytest.mark.parametrize("cause", [*CAUSES])
def test_two_lasers_that_are_mirrored_or_turned_together_are_told(
    empty_room: Arena, cause: str, as_map: bool
) -> None:
    robot = parse_robot(
        FRONT_AND_REAR.replace("0.35, 0.1", "0.35, 0.25").replace("-0.35, -0.1", "-0.35, 0.2")
    )
    run = sg.record(winding(), empty_room, robot)
    sign, turn = CAUSES[cause]

    told = sign * (run.sensor.bearings - turn)
    x, y = run.sensor.origins.T
    c, s = np.cos(-turn), np.sin(-turn)
    order = np.argsort(wrap(told), kind="stable")
    origins = np.stack([c * x - s * y, sign * (s * x + c * y)], axis=1)

    sensor = replace(run.sensor, bearings=wrap(told)[order], origins=origins[order])
    logged = replace(run, sensor=sensor, ranges=run.ranges[:, order])
    found = orientation(logged, empty_room if as_map else None)
    assert found is not None and found.best == cause
