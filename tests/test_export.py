"""Exported worlds: what another simulator sees there is what our own sees, and a drive there is a run like any other."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import cast as cast_to
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely

import logs
from logs.run import Run, pair
from planners.arena import Arena
from planners.trajectory import Trajectory
from sensorgraph.cli import run as cli
from sensorgraph.diagnosis.motion.drive_channel import diagnose_drive
from sensorgraph.diagnosis.motion.odometry_channel import diagnose_odometry
from sensorgraph.effects import EFFECTS
from sensorgraph.errors import SensorgraphError
from sensorgraph.exporting.export import export
from sensorgraph.exporting.twin import Simulator, drive_twin
from sensorgraph.exporting.world import ExportedWorld
from sensorgraph.loading import load_arena
from sensorgraph.types import Floats
from sensorgraph.world.raycast import cast
from sensorgraph.world.robot import Robot, parse_robot

ROBOT = parse_robot("sensor: {n_rays: 61, rate: 5.0}\n")
SIMULATORS = ["mujoco", "irsim"]


@pytest.fixture(scope="module")
def world() -> ExportedWorld:
    return ExportedWorld.of(load_arena("square"), ROBOT, name="square")


def poses_in(arena: Arena, n: int) -> Floats:
    """Return poses (n, 3) at random in free space, a little off the walls."""
    rng = np.random.default_rng(3)
    x0, y0, x1, y1 = arena.bounds
    some = rng.uniform([x0, y0, -np.pi], [x1, y1, np.pi], (20 * n, 3))
    return some[shapely.contains_xy(arena.free.buffer(-0.05), some[:, 0], some[:, 1])][:n]


def residuals(run: Run, poses: Floats, arena: Arena) -> Floats:
    """Return measured less expected [m] of all rays that returned."""
    expected = cast(arena, poses, run.sensor).ranges
    both = np.isfinite(run.ranges) & np.isfinite(expected)
    return run.ranges[both] - expected[both]


def simulator(folder: Path, target: str) -> Simulator:
    """Open the world of an exported folder by its own drive.py; the simulator may be missing."""
    pytest.importorskip(target)
    spec = importlib.util.spec_from_file_location(f"drive_{target}", folder / "drive.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    name = {"mujoco": "MujocoWorld", "irsim": "IrsimWorld"}[target]
    return cast_to(Simulator, getattr(module, name)(folder))


def curve(t: Floats, v: Floats, omega: Floats, start: tuple[float, float]) -> Trajectory:
    """Return the drive with speeds v (n,) [m/s] and omega (n,) [rad/s], every 50 ms, from a place [m]."""
    phi = np.concatenate([[0.0], np.cumsum((omega[1:] + omega[:-1]) / 2 * 0.05)])
    xy = np.cumsum(np.stack([v * np.cos(phi), v * np.sin(phi)], axis=1) * 0.05, axis=0) + start
    return Trajectory(
        stamps=t,
        poses=np.column_stack([xy, phi]),
        twists=np.column_stack([v, omega]),
        primitives=np.full(len(t), "move"),
    )


def spin(arena: Arena, robot: Robot) -> Trajectory:
    """Return 14 s of a curve and turns near the roomiest place."""
    x, y, _ = ExportedWorld.of(arena, robot).start
    t = np.arange(0.0, 14.0, 0.05)
    omega = 0.8 * np.sin(0.45 * t) * np.minimum(t, 1.0)
    return curve(t, 0.12 * np.cos(0.7 * t) * np.minimum(t, 1.0), omega, (x, y))


@pytest.fixture(scope="module")
def square_tour() -> Trajectory:
    """Return half a minute round and round, with stops, fast straights and turns on the spot."""
    t = np.arange(0.0, 34.0, 0.05)
    phase = t % 7.5
    v = np.clip(np.minimum(phase, 4.0 - phase), 0.0, 1.0) * 0.38
    omega = np.where(phase > 4.2, np.clip(np.minimum(phase - 4.2, 7.3 - phase), 0.0, 1.0) * 0.75, 0.0)
    return curve(t, v, omega, (0.7, 0.9))


def test_boxes_stand_where_the_walls_are_and_leave_free_space_free(world: ExportedWorld) -> None:
    solid = shapely.union_all([box.outline for box in world.boxes])
    assert solid.intersection(world.arena.free).area < 2e-4  # [m²] the ends of boxes, a tenth of a millimetre
    for (a, b), box in zip(world.walls, world.boxes, strict=True):
        assert box.outline.buffer(1e-6).contains(shapely.LineString([a, b]))
    poses = poses_in(world.arena, 40)
    ours = cast(world.arena, poses, ROBOT.sensor).ranges
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    mount = ROBOT.sensor.mount
    at = poses[:, :2] + np.stack([c * mount[0] - s * mount[1], s * mount[0] + c * mount[1]], axis=1)
    for i in range(0, 40, 8):
        for k in range(0, 61, 12):
            angle = poses[i, 2] + mount[2] + ROBOT.sensor.bearings[k]
            ray = shapely.LineString([at[i], at[i] + 50 * np.array([np.cos(angle), np.sin(angle)])])
            assert shapely.Point(at[i]).distance(ray.intersection(solid)) == pytest.approx(
                ours[i, k], abs=1e-3
            )


@pytest.mark.parametrize("target", SIMULATORS)
def test_rays_of_the_other_simulator_go_as_far_as_ours(
    target: str, world: ExportedWorld, tmp_path: Path
) -> None:
    assert export(world, target, tmp_path) == []
    there = simulator(tmp_path, target)
    poses = poses_in(world.arena, 30)
    ours = cast(world.arena, poses, ROBOT.sensor).ranges
    phi = poses[:, 2:] + ROBOT.sensor.mount[2] + ROBOT.sensor.bearings
    c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    mx, my = ROBOT.sensor.mount[:2]
    ox = np.broadcast_to(poses[:, :1] + c * mx - s * my, phi.shape)
    oy = np.broadcast_to(poses[:, 1:2] + s * mx + c * my, phi.shape)
    ranges = there.cast(ox, oy, np.cos(phi), np.sin(phi))
    assert np.isfinite(ranges).all()  # a closed room
    off = np.abs(ranges - ours)[np.isfinite(ours)]  # ours are cut at the sensor's least range
    assert np.quantile(off, 0.995) < 1e-3  # a ray may pass a corner on either side


@pytest.mark.parametrize("target", SIMULATORS)
def test_a_drive_there_follows_the_plan_and_its_wheels_tell_of_it(
    target: str, world: ExportedWorld, tmp_path: Path
) -> None:
    export(world, target, tmp_path)
    plan = spin(world.arena, ROBOT)
    run = drive_twin(simulator(tmp_path, target), plan, world.arena, ROBOT)
    wanted, _ = plan.at(run.pose_stamps)
    assert np.hypot(*(run.poses[:, :2] - wanted[:, :2]).T).max() < 0.05
    driven = np.abs(np.diff(np.unwrap(run.odometry[:, 2]))).sum()
    assert driven == pytest.approx(np.abs(np.diff(plan.poses[:, 2])).sum(), rel=0.1)
    residual = residuals(run, pair(run).poses, world.arena)
    assert np.median(np.abs(residual)) == pytest.approx(0.67 * ROBOT.sensor.sigma, rel=0.2)
    assert run.meta["simulator"].startswith({"mujoco": "MuJoCo", "irsim": "ir-sim"}[target])


def test_wheels_do_not_touch_a_wall_that_the_disc_clears(world: ExportedWorld, tmp_path: Path) -> None:
    """A plan keeps the disc of 0.2 m clear; tyres of 0.4 m base turn 2 cm beyond it."""
    export(world, "mujoco", tmp_path)
    t = np.arange(0.0, 9.0, 0.05)
    plan = curve(t, np.zeros(len(t)), 0.8 * np.minimum(t, 1.0), (0.21, 2.0))
    run = drive_twin(simulator(tmp_path, "mujoco"), plan, world.arena, ROBOT)
    wanted, _ = plan.at(run.pose_stamps)
    assert np.hypot(*(run.poses[:, :2] - wanted[:, :2]).T).max() < 0.015  # noise of the reference: 2 mm
    for target in ("mujoco", "gazebo"):
        narrow = ExportedWorld.of(world.arena, parse_robot("footprint_radius: 0.15\n"))
        assert any(
            "outside the footprint of 0.3 m" in line for line in export(narrow, target, tmp_path / target)
        )


def test_effects_are_in_the_world_or_in_its_laser(world: ExportedWorld, tmp_path: Path) -> None:
    planted = [
        EFFECTS["range_bias"](b=0.05),
        EFFECTS["mount_yaw"](delta=0.1),
        EFFECTS["unmapped_obstacle"](x=1.0, y=3.2, r=0.2),
        EFFECTS["wheel_base"](s=0.1),
    ]
    changed = ExportedWorld.of(world.arena, ROBOT, planted)
    left = export(changed, "mujoco", tmp_path)
    assert [re.findall(r"\((\w+)\)", line)[0] for line in left] == ["range_bias", "wheel_base"]
    model = ElementTree.parse(tmp_path / "scene.xml")
    (disc,) = [
        geom for geom in model.iter("geom") if geom.get("type") == "cylinder" and geom.get("name") != "body"
    ]
    assert (disc.get("pos") or "").split()[:2] == ["1", "3.2"]
    plan = spin(world.arena, ROBOT)
    runs = [
        drive_twin(simulator(tmp_path, "mujoco"), plan, world.arena, ROBOT, effects, seed=1)
        for effects in ((), planted)
    ]
    turn = [np.abs(np.diff(np.unwrap(run.odometry[:, 2]))).sum() for run in runs]
    assert turn[1] / turn[0] == pytest.approx(1 / 1.1, rel=0.02)
    there = pair(runs[1]).poses + [0.0, 0.0, 0.1]
    assert np.median(residuals(runs[1], there, world.arena)) == pytest.approx(0.05, abs=0.01)


@pytest.mark.parametrize(
    ("name", "target", "drive"),
    [
        pytest.param("actuator_lag", "irsim", "diff", marks=pytest.mark.slow),
        ("wheel_slip", "mujoco", "diff"),
        pytest.param("wheel_slip", "irsim", "diff", marks=pytest.mark.slow),
        pytest.param("wheel_slip", "mujoco", "reeds_shepp", marks=pytest.mark.slow),
        pytest.param("actuator_lag", "mujoco", "diff", marks=pytest.mark.slow),
        pytest.param("actuator_lag", "mujoco", "reeds_shepp", marks=pytest.mark.slow),
    ],
)
def test_an_exported_effect_of_motors_and_wheels_is_found_again(
    name: str, target: str, drive: str, square_tour: Trajectory, tmp_path: Path
) -> None:
    arena = load_arena("square")
    robot = parse_robot(
        f"drive: {drive}\nlimits: {{turning_radius: 0.1}}\nsensor: {{n_rays: 2, rate: 1.0}}\n"
    )
    planted = {
        "actuator_lag": EFFECTS["actuator_lag"](tau=0.08),
        "wheel_slip": EFFECTS["wheel_slip"](s=0.3, x=1.2, y=0.9, r=0.4),
    }[name]
    export(ExportedWorld.of(arena, robot, [planted]), target, tmp_path)
    run = drive_twin(simulator(tmp_path, target), square_tour, arena, robot, [planted])
    channel = diagnose_odometry if name == "wheel_slip" else diagnose_drive
    result = channel(run, robot)
    assert [a.name for a in result.effects] == [name] and result.unknown is None
    key = {"actuator_lag": "tau", "wheel_slip": "s"}[name]
    found = result.effects[0]
    assert found[key] == pytest.approx(planted[key], abs=max(4 * found.stderr[key], 0.1 * planted[key]))


def test_a_wall_seen_from_both_sides_is_a_thin_sheet() -> None:
    free = shapely.box(0, 0, 4, 2)
    walls = np.array([[[0, 0], [4, 0]], [[2, 0.5], [2, 1.5]]], dtype=float)
    arena = Arena(free=free, walls=walls, names=("a/edge_0", "b/edge_0"), surfaces=("wall", "wall"))
    outer, inner = ExportedWorld.of(arena, ROBOT).boxes
    assert outer.y + outer.thickness / 2 == pytest.approx(0.0, abs=1e-9)
    assert (inner.x, inner.thickness) == (2.0, 0.002)


def test_no_box_reaches_through_another_wall_where_nobody_knows_what_is_free() -> None:
    """A wedge whose corner the free space of a graph keeps away from."""
    corner = np.array([[[2.0, 1.0], [3.0, 1.2]], [[2.0, 1.0], [3.0, 0.8]]])
    free = shapely.box(0, 0, 4, 2).difference(shapely.box(1.8, 0.7, 3.2, 1.3))
    seen = shapely.Polygon([(2.0, 1.01), (3.0, 1.21), (3.0, 1.4), (2.0, 1.4)])
    seen = seen.union(shapely.Polygon([(2.0, 0.99), (3.0, 0.79), (3.0, 0.6), (2.0, 0.6)]))
    arena = Arena(
        free=free.union(seen.buffer(0.0099)),
        walls=corner,
        names=("w/edge_0", "w/edge_1"),
        surfaces=("wall",) * 2,
    )
    wedge = shapely.Polygon([(2.0, 1.0), (3.0, 1.2), (3.0, 0.8)])
    for box in ExportedWorld.of(arena, ROBOT).boxes:
        assert box.outline.difference(wedge.buffer(0.006)).is_empty


def test_sdf_holds_walls_robot_and_laser(world: ExportedWorld, tmp_path: Path) -> None:
    export(world, "gazebo", tmp_path)
    root = ElementTree.parse(tmp_path / "world.sdf").getroot()
    assert root.get("version") == "1.9"
    assert len(root.findall(".//model[@name='walls']/link/collision")) == world.arena.n_walls
    assert root.findtext(".//sensor/lidar/scan/horizontal/samples") == "61"
    assert float(root.findtext(".//sensor/lidar/noise/stddev") or 0) == ROBOT.sensor.sigma
    assert float(root.findtext(".//plugin/wheel_separation") or 0) == ROBOT.wheels.base
    bits = {
        str(part.get("name")): int(part.findtext("surface/contact/collide_bitmask") or "0xffff", 16)
        for part in root.iter("collision")
    }
    walls = [value for name, value in bits.items() if "edge" in name]
    assert walls and all(
        bits["left_collision"] & value == 0 != bits["body_collision"] & value for value in walls
    )
    assert bits["left_collision"] & bits["collision"] != 0  # the floor
    names = [element.get("name") for element in root.iter() if element.get("name")]
    assert all("/" not in (name or "") for name in names)
    launch = (tmp_path / "bridge.launch.py").read_text()
    compile(launch, "bridge.launch.py", "exec")
    assert (
        'MOUNT = {"x": 0.1, "y": 0.0, "z": 0.3, "yaw": 0.0}' in launch
    )  # without it, /scan has no transform


@pytest.mark.parametrize(("target", "module"), [("mujoco", "mujoco"), ("irsim", "irsim")])
def test_a_script_without_its_simulator_is_one_line(
    target: str, module: str, world: ExportedWorld, tmp_path: Path
) -> None:
    export(world, target, tmp_path / "twin")
    (tmp_path / f"{module}.py").write_text("raise ImportError\n")
    made = subprocess.run(
        [sys.executable, str(tmp_path / "twin" / "drive.py"), "plan"], capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])},
    )  # fmt: skip
    assert made.returncode != 0 and made.stderr.count("\n") == 1
    assert made.stderr.startswith("error: drive.py needs") and "pip install" in made.stderr


@pytest.mark.slow
def test_the_command_writes_a_folder_whose_script_records_a_run(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    assert cli(["export", "square", "--to", "mujoco", "-o", str(tmp_path / "twin")]) == 0
    spin(load_arena("square"), ROBOT).write_csv(tmp_path / "trajectory.csv")
    command = [sys.executable, str(tmp_path / "twin" / "drive.py")]
    made = subprocess.run(
        [*command, str(tmp_path / "trajectory.csv"), "-o", str(tmp_path / "run.mcap")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    assert re.search(r"\d+ scans of 181 rays in 14 s, at most \d\.\d cm off the plan", made.stdout)
    run = logs.read(tmp_path / "run.mcap")
    assert {"arena.geojson", "robot.yaml"} <= set(run.attachments)
    bad = subprocess.run([*command, "nowhere"], capture_output=True, text=True, check=False)
    assert (bad.returncode, bad.stderr.count("\n")) == (2, 1)
    assert "nowhere does not exist" in bad.stderr


def test_a_second_export_leaves_nothing_of_the_first(world: ExportedWorld, tmp_path: Path) -> None:
    planted = ExportedWorld.of(world.arena, ROBOT, [EFFECTS["range_bias"](b=0.05)])
    export(planted, "mujoco", tmp_path)
    (tmp_path / "mine.txt").touch()
    export(world, "irsim", tmp_path)
    assert not (tmp_path / "effects.yaml").exists()  # it would be driven with
    assert not (tmp_path / "scene.xml").exists()
    assert (tmp_path / "mine.txt").exists()


def test_a_robot_too_large_for_the_arena_is_refused() -> None:
    with pytest.raises(SensorgraphError, match="fits nowhere in the arena"):
        ExportedWorld.of(load_arena("square"), parse_robot("footprint_radius: 3.0\n"))


@pytest.mark.slow
@pytest.mark.parametrize("target", SIMULATORS)
def test_the_diagnosis_finds_nothing_but_what_was_exported(
    target: str, world: ExportedWorld, tmp_path: Path, make_plan: Callable[[Path], Path]
) -> None:
    """A plan of the square, driven there: nothing material; with effects exported, those and no other."""
    from sensorgraph.diagnosis.diagnose import diagnose
    from sensorgraph.recording.drive_source import open_drive

    way = open_drive(make_plan(tmp_path / "plan")).way
    assert isinstance(way, Trajectory)
    planted = [EFFECTS["range_bias"](b=0.03), EFFECTS["wheel_base"](s=0.03)]
    for effects in ([], planted):
        folder = tmp_path / f"{len(effects)}"
        export(ExportedWorld.of(world.arena, ROBOT, effects), target, folder)
        run = drive_twin(simulator(folder, target), way, world.arena, ROBOT, effects)
        finding = diagnose(run, world.arena, ROBOT, plan_next=False)
        assert {a.name for a in finding.effects} == {a.name for a in effects}
        assert finding.unknown is None


@pytest.fixture
def make_plan() -> Callable[[Path], Path]:
    """Plan six views of the square."""

    def made(folder: Path) -> Path:
        assert cli(["plan", "square", "--views", "6", "-o", str(folder)]) == 0
        return folder

    return made
