"""The code of the page on Nav2 drives a plan: Nav2's actions in order, and the tracking law to millimetres."""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import shapely
from conftest import without_pictures
from planners_samples import outlined

from planners.arena import wrap
from planners.maps import geojson
from planners.trajectory import read_csv
from planners.types import Floats
from sensorgraph.cli import run as cli

PAGE = Path(__file__).parent.parent / "docs" / "pages" / "how-to" / "nav2.md"
ACTIONS, TRACKER, NODE = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S)


@pytest.fixture(scope="module")
def plans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two plans of a small room: `stops` and `drift`."""
    folder = tmp_path_factory.mktemp("guide")
    (folder / "room.geojson").write_text(geojson.dumps(outlined(shapely.box(0, 0, 2, 1.5))))
    for name, planner in (("stops", "stop_and_spin"), ("drift", "coverage")):
        options = ["--planner", planner, "--cell", "0.5", "--headings", "8", "-o", str(folder / name)]
        with without_pictures():
            assert cli(["plan", str(folder / "room.geojson"), *options]) == 0
    return folder


def message() -> Any:
    """Return a message of whatever fields are asked of it."""
    point = SimpleNamespace(x=0.0, y=0.0, z=0.0)
    turned = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    header = SimpleNamespace(frame_id="")
    return SimpleNamespace(header=header, pose=SimpleNamespace(position=point, orientation=turned), poses=[])


class Navigator:
    """Does at once what Nav2's actions ask for."""

    def __init__(self, pose: Floats) -> None:
        self.pose, self.turned, self.off = pose.copy(), 0.0, [0.0]

    def followPath(self, path: Any) -> None:  # noqa: N802
        assert path.header.frame_id == "map"
        for at in path.poses:
            phi = 2 * math.atan2(at.pose.orientation.z, at.pose.orientation.w)
            self.off.append(abs(float(wrap(phi - self.pose[2]))))
        places = np.array([[at.pose.position.x, at.pose.position.y] for at in path.poses])
        assert np.hypot(*(places[0] - self.pose[:2])) < 1e-6
        assert np.hypot(*np.diff(places, axis=0).T).max() < 0.08
        self.pose[:2] = places[-1]

    def spin(self, spin_dist: float, time_allowance: int) -> None:
        assert isinstance(time_allowance, int) and time_allowance > abs(spin_dist)
        self.pose[2] += spin_dist
        self.turned += abs(spin_dist)

    def isTaskComplete(self) -> bool:  # noqa: N802
        return True

    def getResult(self) -> str:  # noqa: N802
        return "succeeded"


def test_the_actions_of_the_guide_bring_the_robot_through_the_plan(
    plans: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = {
        "geometry_msgs.msg": {"PoseStamped": message},
        "nav_msgs.msg": {"Path": message},
        "nav2_simple_commander.robot_navigator": {
            "BasicNavigator": Navigator,
            "TaskResult": SimpleNamespace(SUCCEEDED="succeeded"),
        },
    }
    for name, content in parts.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name.split(".")[0], ModuleType(name.split(".")[0]))
        monkeypatch.setitem(sys.modules, name, module)
    guide: dict[str, Any] = {}
    exec(compile(ACTIONS, str(PAGE), "exec"), guide)
    trajectory = read_csv(plans / "stops" / "trajectory.csv")
    robot = Navigator(trajectory.poses[0])
    assert guide["drive"](robot, str(plans / "stops")) is None
    np.testing.assert_allclose(robot.pose[:2], trajectory.poses[-1, :2], atol=0.02)
    assert abs(float(wrap(robot.pose[2] - trajectory.poses[-1, 2]))) < 0.1
    assert max(robot.off) < np.radians(4)  # after each spin the next line lies ahead, or behind
    turned = abs(wrap(np.diff(trajectory.poses[:, 2]))).sum()
    assert robot.turned == pytest.approx(turned, rel=0.01)


def test_the_tracker_of_the_guide_keeps_a_late_robot_on_the_plan(plans: Path) -> None:
    guide: dict[str, Any] = {}
    exec(compile(TRACKER, str(PAGE), "exec"), guide)
    tracker = guide["Tracker"](str(plans / "drift"), lead=0.125)
    trajectory = read_csv(plans / "drift" / "trajectory.csv")
    pose, twist, off = trajectory.poses[0] + [0.05, -0.05, 0.1], np.zeros(2), []
    step, period, lag = 0.01, 0.05, 0.1
    for k in range(int(min(tracker.duration, 60.0) / period)):
        said = np.array(tracker.command(k * period, *pose))
        for _ in range(round(period / step)):
            twist += (said - twist) * (1 - math.exp(-step / lag))
            pose += step * np.array([twist[0] * math.cos(pose[2]), twist[0] * math.sin(pose[2]), twist[1]])
        want, _ = trajectory.at(np.array([(k + 1) * period]))
        off.append([np.hypot(*(want[0, :2] - pose[:2])), abs(float(wrap(want[0, 2] - pose[2])))])
    late = np.array(off)[200:]  # ten seconds on, the 7 cm that it began off are forgotten
    assert late[:, 0].max() < 0.02
    assert late[:, 1].max() < np.radians(4)


def test_the_node_of_the_guide_is_python() -> None:
    compile(NODE, str(PAGE), "exec")
