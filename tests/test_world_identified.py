"""The identified world: readings follow the graph's mixture, noise belongs to time and ray, not to who drives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from conftest import without_pictures

import logs
from logs.run import RangeSensor, Run
from planners import plan as make_plan
from planners.arena import Arena
from sensorgraph.building.build import build
from sensorgraph.cli import run as command
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.identification.behaviour import behaviour, lyapunov, table
from sensorgraph.models.faces.observed_space import ObservedSpace
from sensorgraph.models.residual_memory import ResidualMemory
from sensorgraph.planning.plan_folder import save
from sensorgraph.recording.identified_world import ArenaWorld, IdentifiedWorld
from sensorgraph.world.drive import ExecutedDrive
from sensorgraph.world.identified_arena import MIN_HALF_WIDTH, _free_space, arena_of
from sensorgraph.world.raycast import cast
from sensorgraph.world.robot import Robot, default_robot
from sensorgraph.world.simulate import simulate

pytestmark = pytest.mark.usefixtures("trusted_scans")


@pytest.fixture(scope="module")
def robot(sensor: RangeSensor) -> Robot:
    machine = default_robot()
    return replace(
        machine, sensor=sensor, text=machine.text.replace("n_rays: 181", f"n_rays: {sensor.n_rays}")
    )


@pytest.fixture(scope="module")
def graph(room: Arena, sensor: RangeSensor) -> Sensorgraph:
    """Return a graph of the room, from 1,500 exact poses and 1 cm of noise."""
    rng = np.random.default_rng(5)
    poses = rng.uniform([0.2, 0.2, -np.pi], [3.8, 2.8, np.pi], (4000, 3))
    poses = poses[room.contains(poses[:, :2])][:1500]
    ranges = cast(room, poses, sensor).ranges
    stamps = np.arange(len(poses)) / 10
    run = Run(
        sensor=sensor, stamps=stamps, ranges=ranges + 0.01 * rng.normal(size=ranges.shape),
        pose_stamps=stamps, poses=poses,
    )  # fmt: skip
    return build([run])


def test_readings_spread_about_the_prediction_as_it_says(graph: Sensorgraph, robot: Robot) -> None:
    pose = np.array([1.3, 1.4, 0.2])
    readings = IdentifiedWorld(graph, robot, seed=1).scans(0, np.tile(pose, (4000, 1)))
    said = graph.predict(pose[None])
    sure = said.answered[0] & (said.p_off[0] < 1e-4)
    assert sure.mean() > 0.8
    off = readings[:, sure] - said.mode[0, sure]
    assert np.abs(off.mean(axis=0)).max() < 5 * 0.01 / np.sqrt(4000)
    assert (np.abs(off) > 0.06).mean() < 1e-4  # a prediction leaves out what is less likely than 1e-3
    off = np.where(np.abs(off) < 0.06, off, 0.0)
    np.testing.assert_allclose(off.std(axis=0), said.sigma[0, sure], rtol=0.1)
    assert np.median(said.sigma[0, sure]) == pytest.approx(0.01, rel=0.05)


def test_no_return_is_drawn_as_often_as_it_is_said(graph: Sensorgraph, robot: Robot) -> None:
    model = graph.model
    faces = model.faces._replace(levels=np.where(model.faces.levels > 0.5, 0.7, model.faces.levels))
    thin = replace(graph, model=replace(model, faces=faces))
    pose = np.array([1.3, 1.4, 0.2])
    readings = IdentifiedWorld(thin, robot, seed=2).scans(0, np.tile(pose, (3000, 1)))
    said = thin.predict(pose[None]).p_no_return[0]
    seen = np.isinf(readings).mean(axis=0)
    assert said.max() > 0.05
    assert np.abs(seen - said).max() < 5 * 0.5 / np.sqrt(3000)


def test_a_drive_may_turn_many_times(graph: Sensorgraph, robot: Robot) -> None:
    turned = np.array([[1.3, 1.4, 0.2 + 64 * np.pi], [1.3, 1.4, 0.2]])  # 32 turns: a heading of 201 rad
    many, none = (IdentifiedWorld(graph, robot, seed=1).scans(0, pose[None]) for pose in turned)
    np.testing.assert_allclose(many, none, atol=1e-9)


def test_noise_belongs_to_seed_scan_and_ray(graph: Sensorgraph, robot: Robot) -> None:
    poses = np.tile([1.3, 1.4, 0.2], (600, 1))
    world, other = IdentifiedWorld(graph, robot, seed=1), IdentifiedWorld(graph, robot, seed=1)
    whole = world.scans(0, poses)
    np.testing.assert_array_equal(whole[250:270], other.scans(250, poses[:20]))
    np.testing.assert_array_equal(whole[511], other.scan(511, poses[0]))
    assert (IdentifiedWorld(graph, robot, seed=3).scans(0, poses) != whole).mean() > 0.5
    assert len(np.unique(whole[:, 30])) > 20  # other scans, other noise


def test_with_a_memory_a_place_stays_off_whoever_looks_and_scans_belong_to_their_number(
    graph: Sensorgraph, robot: Robot
) -> None:
    for_ever = ResidualMemory(
        sizes=np.array([0.2]),
        lifetimes=np.array([1.0]),
        events=np.array([[0.0, 0.5]]),
        noise=np.array([[0.0, 0.8]]),
    )
    keeping = replace(graph, memory=for_ever)
    poses = np.tile([1.3, 1.4, 0.2], (400, 1))
    poses[::2, 2] += 0.3
    world = IdentifiedWorld(keeping, robot, seed=3)
    readings = world.scans(0, poses)
    assert np.array_equal(IdentifiedWorld(keeping, robot, seed=3).scan(7, poses[7]), readings[7])
    said = keeping.predict(poses[:2])
    sure = said.answered & (said.p_off < 1e-4)
    off = (readings[1::2] - said.mode[1])[:, sure[1]]
    kept = np.var(off.mean(axis=0)) / np.mean(off**2)
    assert kept == pytest.approx(0.8, abs=0.2)
    assert np.sqrt(np.mean(off**2)) == pytest.approx(0.01, rel=0.3)  # as large as without
    each = np.broadcast_to(poses[:5, None], (5, keeping.sensor.n_rays, 3))
    swept = IdentifiedWorld(keeping, robot, seed=3).scans(0, each)
    np.testing.assert_allclose(swept, readings[:5], atol=1e-9)


def test_rays_without_an_answer_are_counted(graph: Sensorgraph, robot: Robot) -> None:
    world = IdentifiedWorld(graph, robot, seed=1)
    world.scans(0, np.array([[40.0, 40.0, 0.0], [1.3, 1.4, 0.2]]))
    assert world.n_rays == 2 * 61
    assert 61 <= world.unanswered < 70


def test_a_robot_with_another_sensor_is_refused(graph: Sensorgraph) -> None:
    with pytest.raises(SensorgraphError, match=r"181 rays from .*, expected 61"):
        IdentifiedWorld(graph, default_robot(), seed=0)


def test_behaviour_of_a_circle_is_known() -> None:
    stamps = np.arange(0, 600, 0.1)
    phi = 0.2 * stamps
    poses = np.column_stack([np.cos(phi), np.sin(phi), (phi + np.pi / 2 + np.pi) % (2 * np.pi) - np.pi])
    run = Run(
        sensor=RangeSensor(bearings=np.array([-0.1, 0.1])), stamps=stamps, pose_stamps=stamps, poses=poses,
        ranges=np.column_stack([np.full(6000, 0.5), np.full(6000, np.inf)]),
    )  # fmt: skip
    found = behaviour(run)
    assert found.speed_m_s == pytest.approx(0.2, rel=0.01)
    assert found.turn_rate_rad_s == pytest.approx(0.2, rel=0.01)
    assert found.clearance_mean_m == found.clearance_min_m == 0.5
    assert found.coverage is None and "–" in "\n".join(table({"a": found}))


def test_lyapunov_exponent_tells_chaos_from_a_circle() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(0, 900, 0.5)
    circle = np.stack([np.cos(0.2 * t), np.sin(0.2 * t)], axis=1)
    steady = lyapunov(t, circle + 1e-3 * rng.normal(size=circle.shape))
    x = np.empty(len(t))
    x[0] = 0.3
    for i in range(len(t) - 1):  # logistic map at r = 4: exponent ln 2 a step
        x[i + 1] = 4 * x[i] * (1 - x[i])
    chaotic = lyapunov(t, np.stack([x, np.zeros(len(t))], axis=1))
    assert steady is not None and chaotic is not None
    assert abs(steady) < 0.02 < chaotic
    assert lyapunov(t[:100], circle[:100]) is None


@pytest.fixture(scope="module")
def folder(graph: Sensorgraph, room: Arena, robot: Robot, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Hold a graph, a robot and a short plan."""
    folder = tmp_path_factory.mktemp("identified")
    graph.save(folder / "g.sensorgraph")
    (folder / "robot.yaml").write_text(
        "name: small\nsensor: {n_rays: 61, mount: [0.1, 0.02, 0.01]}\nfootprint_radius: 0.15\n"
    )
    made = make_plan(room, robot, planner="wall_following", duration=40, seed=0, rate=10.0)
    with without_pictures():
        save(made, folder / "plan", room, robot)
    return folder


def test_walls_of_the_graph_are_those_of_the_room(graph: Sensorgraph, room: Arena) -> None:
    found = arena_of(graph)
    np.testing.assert_allclose(found.bounds, room.bounds, atol=0.15)


@pytest.mark.parametrize("seed", range(4))
def test_free_space_is_the_crossed_cells_made_wider_without_what_no_disc_fits_in(seed: int) -> None:
    """Cells that touch at corners only, holes and slivers included; told by distances, cell by cell."""
    rng = np.random.default_rng(seed)
    cell, half = 0.1, 0.05
    crossed = rng.random((30, 40)) < 0.6
    crossed[3:9, 5:12] = True  # a disc fits in here, and perhaps elsewhere
    space = ObservedSpace(
        origin=np.array([-1.23, 4.567]), cell=cell, counts=crossed.astype(np.uint8), free=crossed
    )
    wall = np.array([[[-0.9, 5.0], [-0.2, 5.0]]])
    found = _free_space(space, wall, np.array([[0.0, 1.0]]))
    boxes = [
        shapely.box(*(space.origin + cell * np.array(at)), *(space.origin + cell * (np.array(at) + 1)))
        for at in np.argwhere(crossed)
    ]
    wide = shapely.union_all(boxes).buffer(half, join_style="mitre")
    wide = wide.difference(shapely.box(-0.9, 4.95, -0.2, 5.0))
    parts = [p for p in shapely.get_parts(wide) if p.buffer(-MIN_HALF_WIDTH).area > 0]
    assert shapely.union_all(parts).symmetric_difference(found).area < 1e-9  # m²


def test_cells_behind_walls_that_do_not_quite_meet_are_not_free() -> None:
    """In a corner, the end of a wall lies on its neighbour with the error of the fit, here 3 micrometres."""
    crossed = np.ones((24, 24), dtype=np.bool_)  # with two cells behind each wall
    space = ObservedSpace(
        origin=np.array([-0.2, -0.2]), cell=0.1, counts=crossed.astype(np.uint8), free=crossed
    )
    slit = 3e-6  # m
    walls = np.array(
        [
            [[-0.012, 0.0], [2.0, 0.0]],
            [[2.0, 0.0], [2.0, 2.0]],
            [[2.0, 2.0], [0.0, 2.0]],
            [[0.0, 2.0], [0.0, slit]],
        ]
    )
    inwards = np.array([[0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 0.0]])
    room = shapely.box(0.0, 0.0, 2.0, 2.0)
    assert room.symmetric_difference(_free_space(space, walls, inwards)).area < 1e-3  # m², beside the slit


def race(folder: Path, out: Path, *controllers: str, seed: int = 0) -> int:
    names = [word for name in controllers for word in ("--controller", name)]
    return command(
        ["record", str(folder / "plan"), "--graph", str(folder / "g.sensorgraph"), "--robot",
         str(folder / "robot.yaml"), *names, "--seed", str(seed), "-o", str(out)]
    )  # fmt: skip


@pytest.mark.slow
def test_controllers_are_compared_on_one_seed(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert race(folder, tmp_path / "a.mcap", "plan", "wall_following", "random_bounce") == 0
    said = capsys.readouterr().out
    assert "| mean turn rate |" in said and "does not answer" in said
    runs = [
        logs.read(tmp_path / name) for name in ("a.mcap", "a.wall_following.mcap", "a.random_bounce.mcap")
    ]
    assert [run.meta["controller"] for run in runs] == ["plan", "wall_following", "random_bounce"]
    assert len({run.n_scans for run in runs}) == 1
    start = [logs.pair(run).poses[0] for run in runs]
    np.testing.assert_allclose(start[1], start[0], atol=0.02)
    np.testing.assert_array_equal(runs[1].ranges[0], runs[0].ranges[0])  # same place, same noise
    assert all(int(run.meta["contacts"]) == 0 for run in runs[1:])
    assert (tmp_path / "a.png").is_file()
    assert race(folder, tmp_path / "b.mcap", "plan") == 0
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--graph", "{g}", "--controller", "dwa"], "expected plan, wall_following, random_bounce"),
        (["--graph", "{g}", "--controller", "plan", "--controller", "plan"], "at most once"),
        (["--graph", "{g}", "--start", "1,1,0"], "starts where the plan starts"),
        (
            ["--controller", "plan", "--controller", "wall_following", "--start", "1,1,0"],
            "leave out one of them",
        ),
        (["--controller", "wall_following", "--start", "9,9,0"], "from a wall of"),
        (["--controller", "wall_following", "--effects", "{e}"], "cannot be used with --controller"),
    ],
)
def test_mistakes_are_one_line(
    words: list[str], said: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [word.format(g=folder / "g.sensorgraph", e=folder / "effects.yaml") for word in words]
    assert command(["record", str(folder / "plan"), *words, "-o", str(tmp_path / "a.mcap")]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert said in line
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("no_pictures")
def test_the_robot_of_a_plan_gets_the_laser_of_the_graph(
    folder: Path, room: Arena, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shipped = default_robot()  # of 181 rays; the graph is of 61
    save(
        make_plan(room, shipped, planner="wall_following", duration=3, seed=0),
        tmp_path / "plan",
        room,
        shipped,
    )
    words = [
        "record",
        str(tmp_path / "plan"),
        "--graph",
        str(folder / "g.sensorgraph"),
        "-o",
        str(tmp_path / "a.mcap"),
    ]
    assert command(words) == 0
    assert "laser of the graph (61 rays)" in capsys.readouterr().out
    assert logs.read(tmp_path / "a.mcap").sensor.n_rays == 61
    (tmp_path / "robot.yaml").write_text("sensor: {n_rays: 181}\n")
    assert command([*words, "--robot", str(tmp_path / "robot.yaml")]) == 2  # what is given is not replaced
    assert "the rays of the robot differ" in capsys.readouterr().err


def test_a_controller_starts_where_it_is_told(folder: Path, tmp_path: Path) -> None:
    words = ["--controller", "wall_following", "--start", "1.5,1.25,90 deg", "-o", str(tmp_path / "a.mcap")]
    assert command(["record", str(folder / "plan"), *words]) == 0
    run = logs.pair(logs.read(tmp_path / "a.mcap"))
    np.testing.assert_allclose(run.poses[0], [1.5, 1.25, np.pi / 2], atol=0.03)  # within the first sweep


@pytest.mark.parametrize("world", ["graph", "arena"])
def test_each_ray_of_a_sweep_is_drawn_where_the_robot_was(
    graph: Sensorgraph, robot: Robot, room: Arena, world: str
) -> None:
    """On a robot that turns by a radian during the sweep, the last rays see what a turned robot sees."""
    quiet = replace(robot, sensor=replace(robot.sensor, sigma=0.0, resolution=0.0))
    drawn_in = IdentifiedWorld(graph, quiet, seed=1) if world == "graph" else ArenaWorld(room, quiet, 1)
    n_rays = robot.sensor.n_rays
    turned = np.column_stack([np.full(n_rays, 1.3), np.full(n_rays, 1.4), np.linspace(0.2, 1.2, n_rays)])
    readings = drawn_in.scans(0, np.tile(turned, (50, 1, 1)))
    want = np.diag(cast(room, turned, robot.sensor).ranges)  # ray i at pose i
    assert (np.abs(np.median(readings, axis=0) - want) < 0.02).mean() > 0.9  # not at edges in depth
    once = drawn_in.scans(0, np.tile(turned[0], (50, 1)))
    assert (np.abs(np.median(once, axis=0) - want) < 0.02).mean() < 0.5
    sweeping = replace(quiet, sensor=replace(quiet.sensor, sweep_time=0.1))
    asked = []

    def perceive(first: int, poses: np.ndarray) -> np.ndarray:
        asked.append(poses.shape)
        return np.ones(poses.shape[:2])

    t = np.linspace(0, 2, 101)
    drive = ExecutedDrive(
        stamps=t, poses=np.column_stack([1 + 0.1 * t, np.ones_like(t), np.zeros_like(t)]), twists=np.zeros((101, 2)),
        cmd_stamps=t[:1], commands=np.zeros((1, 2)), contacts=0,
    )  # fmt: skip
    simulate(drive, room, sweeping, rng=np.random.default_rng(0), perceive=perceive)
    assert asked[0][1:] == (n_rays, 3)
