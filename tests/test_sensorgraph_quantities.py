"""Lengths and angles with a unit, and degrees given for radians, wherever a user writes a pose or an effect."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import sensorgraph as sg
from logs.run import RangeSensor, Run
from planners.arena import Arena
from sensorgraph.building.build import build
from sensorgraph.cli.inputs import parse_pose
from sensorgraph.effects.effects_file import loads
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.loading import read_poses
from sensorgraph.quantities import ANGLE, LENGTH, quantity
from sensorgraph.world.raycast import cast

pytestmark = pytest.mark.usefixtures("trusted_scans")

YAW = "- name: mount_yaw\n  parameters: {{delta: {}}}\n"
PANE = "- name: glass\n  parameters: {{a: {}, b: 2, alpha_ret: {}, depth: 1}}\n  location: {{name: room/edge_0}}\n"


@pytest.fixture(scope="module")
def graph(room: Arena, sensor: RangeSensor) -> Sensorgraph:
    poses = np.random.default_rng(5).uniform([0.5, 0.5, -np.pi], [1.5, 1.5, np.pi], (30, 3))
    stamps = 0.1 * np.arange(30)
    ranges = cast(room, poses, sensor).ranges
    return build(
        [Run(sensor=sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses)],
        model="polynomial",
        degree=1,
        harmonics=1,
    )


@pytest.mark.parametrize(
    ("value", "dimension", "wanted"),
    [("120 mm", LENGTH, 0.12), ("1e-3", LENGTH, 1e-3), (-2, LENGTH, -2.0), ("1.5 deg", ANGLE, np.radians(1.5)),
     ("-90°", ANGLE, -np.pi / 2), ("360 deg", ANGLE, 2 * np.pi), (6.28, ANGLE, 6.28), ("3 rad", ANGLE, 3.0)],
)  # fmt: skip
def test_number_is_in_the_si_unit(value: object, dimension: object, wanted: float) -> None:
    assert quantity(value, "it", dimension) == pytest.approx(wanted, rel=1e-12)  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [90, -90.0, "3e2", 6.3])
def test_angle_beyond_a_turn_is_refused(value: object) -> None:
    with pytest.raises(
        SensorgraphError, match=r"^it is -?[\d.]+; radians expected, at most 6.28; write -?[\d.]+ deg"
    ):
        quantity(value, "it", ANGLE)


def test_start_takes_units_and_refuses_degrees_without_one() -> None:
    assert parse_pose("1.5, 120 mm,90 deg") == pytest.approx([1.5, 0.12, np.pi / 2])
    assert parse_pose("1.5,-2,-3.1") == pytest.approx([1.5, -2, -3.1])
    with pytest.raises(
        SensorgraphError, match=r"^--end: phi is 90; radians expected, at most 6.28; write 90 deg"
    ):
        parse_pose("1,2,90", "--end")
    for text in ("1,2", "1,2,3,4", "a,b,c", "1,2,nan", "1,,2"):
        with pytest.raises(SensorgraphError, match=r"expected X,Y,PHI such as 1.0,2.0,0.5 in m, m and rad"):
            parse_pose(text)
    with pytest.raises(
        SensorgraphError, match=r"--start: y is '2 deg', expected a number, in metres or with a unit \(m"
    ):
        parse_pose("1,2 deg,3")


def test_poses_file_takes_units_and_refuses_degrees_without_one(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text("x,y,phi\n1,120 mm,1.5 deg\n150 cm,2,-3.1\n")
    assert read_poses(path) == pytest.approx(np.array([[1, 0.12, np.radians(1.5)], [1.5, 2, -3.1]]))
    path.write_text("x,y,phi\n1,1,0.5\n1,1,45\n")
    wanted = f"{path}: line 3: phi is 45; radians expected, at most 6.28; write 45 deg"
    with pytest.raises(SensorgraphError, match=re.escape(wanted)):
        read_poses(path)
    path.write_text("x,y,phi\n1,1,north\n")
    with pytest.raises(SensorgraphError, match="line 2: expected numbers, found"):
        read_poses(path)


def test_effects_take_units_and_refuse_degrees_without_one() -> None:
    assert loads(YAW.format("1.5 deg"))[0]["delta"] == pytest.approx(np.radians(1.5))
    pane = loads(PANE.format("50 cm", "20 deg"))[0]
    assert (pane["a"], pane["alpha_ret"]) == pytest.approx((0.5, np.radians(20)))
    with pytest.raises(
        SensorgraphError, match=r"\(mount_yaw\): parameter `delta` is 90; radians expected, at most 6.28"
    ):
        loads(YAW.format(90))
    with pytest.raises(
        SensorgraphError, match="parameter `a` is '5 deg', expected a number, in metres or with a unit"
    ):
        loads(PANE.format("5 deg", 0.3))
    wide = loads(YAW.format(0.1) + "  stderr: {delta: 12.5}\n")[0]
    assert wide.stderr["delta"] == 12.5  # an angle that is hardly known: not degrees


@pytest.mark.parametrize("name", ["start", "end"])
def test_plan_refuses_degrees(name: str) -> None:
    with pytest.raises(SensorgraphError, match=f"`{name}`: phi is 90; radians expected"):
        sg.plan("square", **{name: [1.0, 1.0, 90]})


def test_predict_refuses_degrees_and_takes_unwrapped_headings(graph: Sensorgraph) -> None:
    for headings in ([90.0], [0.0, 45.0, 90.0], [100.5]):
        poses = np.array([[1.0, 1.0, phi] for phi in headings])
        with pytest.raises(SensorgraphError, match="radians expected"):
            graph.predict(poses)
    turns = np.array([[1.0, 1.0, 0.3], [1.0, 1.0, 0.3 + 10 * np.pi]])
    once, again = graph.predict(turns).mode
    assert again == pytest.approx(once, abs=1e-6)
