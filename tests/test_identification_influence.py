"""Sobol shares of what can be run: known functions, and a behaviour that by construction hangs on one factor only."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shapely.geometry import box

from logs.run import RangeSensor, Run
from planners.arena import Arena
from robotmodic_ident import Narmax, Terms
from robotmodic_ident.analysis.sampled_sobol import saltelli_points, sampled_sobol
from robotmodic_ident.errors import IdentError
from robotmodic_ident.prediction.recursion import UNLIMITED
from sensorgraph.building.build import build
from sensorgraph.cli import run as cli
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.identification.influence import QUANTITIES, Influence, influence, table
from sensorgraph.recording.controllers import PolynomialController
from sensorgraph.world.raycast import cast
from sensorgraph.world.robot import Robot, load_robot

pytestmark = pytest.mark.usefixtures("trusted_scans")

PLANTED = {"noise": (0.0, 0.03), "yaw": (-0.03, 0.03), "wheels": (0.9, 1.1)}


@pytest.fixture(scope="module")
def robot() -> Robot:
    shipped = load_robot()
    few = RangeSensor(bearings=np.radians(np.arange(-90.0, 91.0, 15.0)), sigma=0.01, range_max=8.0)
    return replace(shipped, sensor=replace(few, mount=shipped.sensor.mount))


@pytest.fixture(scope="module")
def graph(robot: Robot) -> Sensorgraph:
    corners = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 3.0], [0.0, 3.0]])
    walls = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    names = tuple(f"room/edge_{i}" for i in range(4))
    arena = Arena(free=box(0, 0, 3, 3), walls=walls, names=names, surfaces=("wall",) * 4)
    rng = np.random.default_rng(0)
    poses = np.column_stack([rng.uniform(0.3, 2.7, (300, 2)), rng.uniform(-3, 3, 300)])
    ranges = cast(arena, poses, robot.sensor).ranges + 0.01 * rng.normal(size=(300, robot.sensor.n_rays))
    stamps = np.arange(300.0)
    run = Run(sensor=robot.sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses)
    return build([run], calibrate=False)


def controller(
    robot: Robot, *names: str, theta: tuple[float, ...], limits: tuple[float, float] = UNLIMITED
) -> PolynomialController:
    """Return a turn rate in L0-30, the mean range to the right."""
    n = len(names)
    model = Narmax(
        output="cmd_omega", terms=Terms.parse(*names), theta=np.array(theta), covariance=np.zeros((n, n)),
        err=np.zeros(n), sigma=0.0, n_samples=0, limits=limits,
    )  # fmt: skip
    facts = {"signals": {"L0_30": "L0-30"}, "held": {"cmd_v": 0.2}, "period_s": 0.1}
    return PolynomialController(model, facts, robot, name="planted")


@pytest.fixture(scope="module")
def circle(graph: Sensorgraph, robot: Robot) -> Influence:
    """A robot that turns at an even rate whatever it sees: only its wheels decide how fast."""
    blind = controller(robot, "1", "L0_30(k)", theta=(0.5, 0.0))
    return influence(graph, blind, robot, (1.5, 1.1, 0.0), factors=PLANTED, rows=64, duration=16.0)


def test_shares_of_ishigami_are_those_in_closed_form() -> None:
    a, b = 7.0, 0.1
    points = np.pi * (2.0 * saltelli_points(2048, 3, np.random.default_rng(1)) - 1.0)
    x, y, z = np.moveaxis(points, -1, 0)
    found = sampled_sobol(
        (np.sin(x) + a * np.sin(y) ** 2 + b * z**4 * np.sin(x))[..., None], np.random.default_rng(2)
    )
    part = np.array([0.5 * (1 + b * np.pi**4 / 5) ** 2, a**2 / 8, 0.0])
    pair = b**2 * np.pi**8 * (1 / 18 - 1 / 50)
    variance = part.sum() + pair
    for share, interval, truth in (
        (found.first, found.first_interval, part / variance),
        (found.total, found.total_interval, (part + [pair, 0, pair]) / variance),
    ):
        np.testing.assert_allclose(share[:, 0], truth, atol=0.03)  # error of 2,048 quasi-random rows
        assert (interval[:, 0, 0] <= truth + 0.02).all() and (interval[:, 0, 1] >= truth - 0.02).all()


def test_what_does_not_vary_or_has_no_value_has_no_share() -> None:
    points = saltelli_points(16, 2, np.random.default_rng(3))
    lost = np.where(points[..., 0] > 0.1, np.nan, 1.0)
    found = sampled_sobol(np.stack([np.full(points.shape[:2], 3.0), lost], axis=-1), np.random.default_rng(4))
    assert np.isnan(found.first).all() and np.isnan(found.total).all()
    assert found.mean[0] == 3.0 and found.known[0] == 1.0 and found.known[1] < 0.5
    with pytest.raises(IdentError, match="n is 24"):
        saltelli_points(24, 2, np.random.default_rng(5))


def test_turn_rate_of_a_blind_robot_hangs_on_its_wheels_alone(circle: Influence) -> None:
    place = list(QUANTITIES).index("turn_rate_rms_rad_s")
    alone, whole = circle.shares.first[:, place], circle.shares.total[:, place]
    np.testing.assert_allclose(whole, [0.0, 0.0, 1.0], atol=0.15)  # 64 rows
    np.testing.assert_allclose(whole[:2], 0.0, atol=1e-12)  # what it cannot see changes nothing at all
    assert alone[2] > 0.8
    assert circle.undisturbed["turn_rate_rms_rad_s"] == pytest.approx(0.5, rel=0.03)  # it starts from rest
    lap = list(QUANTITIES).index("lap_s")
    assert circle.shares.mean[lap] == pytest.approx(2 * np.pi / 0.5, rel=0.1)
    assert circle.shares.sigma[lap] == pytest.approx(2 * np.pi / 0.5 * 0.2 / np.sqrt(12), rel=0.25)


def test_a_scale_of_the_ranges_moves_a_robot_that_keeps_a_range(graph: Sensorgraph, robot: Robot) -> None:
    """It keeps its reading, so with readings 10 % too long it keeps 10 % too near."""
    keeper = controller(robot, "1", "L0_30(k)", theta=(1.5, -2.0))
    spans = {"scale": (0.9, 1.1), "tau": (0.05, 0.1), "obstacle": (0.0, 0.1)}
    found = influence(graph, keeper, robot, (1.5, 0.75, 0.0), factors=spans, rows=16, duration=12.0)
    place = list(QUANTITIES).index("wall_distance_m")
    assert found.shares.total[0, place] > 0.8
    assert found.shares.total[1, place] < 0.1
    assert len(table(found)) == 2 + len(QUANTITIES)
    assert found.to_dict()["quantities"]["wall_distance_m"]["shares"]["scale"]["first"] > 0.5


def test_a_disc_is_seen_where_it_stands_and_stops_the_robot(graph: Sensorgraph, robot: Robot) -> None:
    straight = controller(robot, "1", "L0_30(k)", theta=(0.0, 0.0))
    spans = {"obstacle": (0.25, 0.45)}
    along = influence(graph, straight, robot, (0.6, 0.5, 0.0), factors=spans, rows=8, duration=8.0)
    contacts = list(QUANTITIES).index("contacts")
    assert along.undisturbed["contacts"] == 0
    assert along.shares.mean[contacts] > 0


def test_a_controller_turns_no_faster_than_the_limits_of_its_model(graph: Sensorgraph, robot: Robot) -> None:
    slow = controller(robot, "1", "L0_30(k)", theta=(0.8, 0.0), limits=(-0.3, 0.3))
    found = influence(
        graph, slow, robot, (1.5, 0.8, 0.0), factors={"noise": (0.0, 0.03)}, rows=8, duration=16.0
    )
    assert found.undisturbed["turn_rate_rms_rad_s"] == pytest.approx(0.3, rel=0.03)  # it starts from rest


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"factors": {"colour": (0.0, 1.0)}}, "factor is 'colour', expected one of noise, "),
        (
            {"factors": {"noise": (0.1, 0.0)}},
            "noise from 0.1 to 0 m: expected an increasing range of at least 0",
        ),
        ({"factors": {}}, "no factor varies"),
        ({"rows": 20}, "rows: n is 20, with 7 factors; expected a power of 2"),
        ({"rows": 4096}, "4096 rows need 36,864 drives, expected at most 20,000"),
        ({"duration": 0.0}, "duration is 0 s, expected 1 to 3600"),
        ({"start": (9.0, 9.0, 0.0)}, "start 9, 9, 0 is not in free space"),
    ],
)
def test_what_makes_no_sense_is_one_line(
    graph: Sensorgraph, robot: Robot, changes: dict[str, object], said: str
) -> None:
    given = {"start": (1.5, 1.1, 0.0), **changes}
    with pytest.raises(SensorgraphError, match=said):
        influence(graph, controller(robot, "L0_30(k)", theta=(0.1,)), robot, **given)  # type: ignore[arg-type]


def test_a_controller_with_memory_is_refused(graph: Sensorgraph, robot: Robot) -> None:
    lagged = controller(robot, "L0_30(k-1)", theta=(0.1,))
    with pytest.raises(SensorgraphError, match="expected a turn rate as a function of the current readings"):
        influence(graph, lagged, robot, (1.5, 1.1, 0.0))


@pytest.fixture(scope="module")
def files(graph: Sensorgraph, robot: Robot, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, ...]:
    folder = tmp_path_factory.mktemp("influence")
    graph.save(folder / "f.sensorgraph")
    steer = controller(robot, "1", "L0_30(k)", theta=(1.5, -2.0))
    facts = {"signals": {"L0_30": "L0-30"}, "held": {"cmd_v": 0.2}, "period_s": 0.1}
    (folder / "c.json").write_text(json.dumps(steer.model.to_dict() | facts))
    (folder / "robot.yaml").write_text("sensor: {n_rays: 13}\n")
    return str(folder / "f.sensorgraph"), str(folder / "c.json"), "--robot", str(folder / "robot.yaml")


def test_command_writes_shares_and_a_picture(
    files: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [
        "influence",
        *files,
        "--start",
        "1.5,0.75,0",
        "--vary",
        "noise=0:0.02",
        "-o",
        str(tmp_path / "i"),
    ]
    assert cli([*arguments, "--rows", "8", "--duration", "3"]) == 0
    assert "| wall distance, mean: " in capsys.readouterr().out
    written = json.loads((tmp_path / "i" / "influence.json").read_text())
    assert written["n_drives"] == 24 and written["factors"] == {"noise": [0.0, 0.02]}
    assert (tmp_path / "i" / "influence.png").stat().st_size > 5000


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--start", "1,2", "--start is '1,2', expected X,Y,PHI such as 1.0,2.0,0.5"),
        ("--vary", "noise", "--vary is noise, expected NAME=LOW:HIGH"),
        ("--vary", "noise=a:b", "--vary is noise=a:b, expected NAME=LOW:HIGH"),
        ("--rows", "7", "rows: n is 7"),
    ],
)
def test_command_refuses_in_one_line(
    files: tuple[str, ...],
    tmp_path: Path,
    option: str,
    value: str,
    said: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments = ["influence", *files, "--start", "1.5,0.75,0", "-o", str(tmp_path / "i")]
    assert cli([*arguments, option, value]) == 2
    err = capsys.readouterr().err
    assert said in err and err.count("\n") == 1
    assert not (tmp_path / "i").exists()
