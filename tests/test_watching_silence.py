"""Topics that stop while others go on, and next steps that can be pasted."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from localization_samples import loop_poses, room_run
from watching_samples import believing, graph

import sensorgraph as sg
from logs.expectations import deviations, expected_topics
from logs.inspection import Inspection, TopicInfo
from logs.run import RangeSensor, Run
from sensorgraph.errors import SensorgraphError
from sensorgraph.watching import watcher
from sensorgraph.watching.observation import observations
from sensorgraph.watching.policy import WatchPolicy, load_policy, save_policy
from sensorgraph.watching.pose import PoseStatement
from sensorgraph.watching.status import WatchStatus
from sensorgraph.watching.summary import WatchSummary


def topic(name: str, first: float, last: float) -> TopicInfo:
    return TopicInfo(
        name=name, type="T", n_messages=100, rate=10.0, frame="", first=first, last=last, offset=None, longest_gap=0.1,
    )  # fmt: skip


def log(*topics: TopicInfo) -> Inspection:
    return Inspection(
        path="a.mcap", format="mcap", n_bytes=1, topics=topics, transforms=(), attachments={}, usable=(), missing=(),
        warnings=(), pairing="", meta={}, use=(), ground=None, advice="", run=None,
    )  # fmt: skip


def test_a_topic_that_stops_or_begins_late_differs_from_the_good_logs() -> None:
    """Its rate and its longest gap are those of the time in which it was there."""
    good = log(topic("/scan", 0.0, 60.0), topic("/odom", 0.3, 59.9))
    expected = expected_topics([good])
    assert not deviations(good, expected)
    [stops] = deviations(log(topic("/scan", 0.0, 30.0), topic("/odom", 0.3, 59.9)), expected)
    assert stops.level == "error" and "/scan is silent for 29.90 s at the end" in stops.text
    [late] = deviations(log(topic("/scan", 0.0, 60.0), topic("/odom", 1.0, 59.9)), expected)
    assert late.level == "warning" and "/odom is silent for 1.00 s at the start" in late.text


@pytest.fixture
def run() -> Run:
    stamps = np.arange(0.0, 20.0, 0.1)
    way = np.column_stack([0.1 * stamps, 0 * stamps, 0 * stamps])
    sensor = RangeSensor(bearings=np.linspace(-1, 1, 11), range_min=0.1, range_max=8.0, mount=np.zeros(3))
    return Run(
        sensor=sensor, stamps=stamps, ranges=np.ones((200, 11)), odom_stamps=stamps, odometry=way,
        odom_twists=np.zeros((200, 2)), pose_stamps=stamps, poses=way,
    )  # fmt: skip


def test_odometry_that_stops_is_unknown_and_does_not_stand_still(run: Run) -> None:
    cut = replace(
        run, odom_stamps=run.odom_stamps[:100], odometry=run.odometry[:100], odom_twists=run.odom_twists[:100]
    )
    known = [one.stamp for one in observations(cut) if one.odometry is not None]
    assert max(known) == pytest.approx(10.9)
    assert all(one.odometry is not None for one in observations(run))


def test_numbers_that_are_not_finite_and_faults_that_repeat() -> None:
    """The clock may also jump by years, as one without a battery does."""
    poses = loop_poses(60)
    each = list(observations(believing(room_run(poses, seed=8), poses)))
    nan = np.full(3, np.nan)
    each[20:] = [replace(one, odometry=nan, believed=nan) for one in each[20:]]
    each[30:30] = [replace(each[25], stamp=each[29].stamp - 0.05)] * 3
    each[50:] = [replace(one, stamp=one.stamp + 1e9) for one in each[50:]]
    said = list(sg.watch(graph(), each))
    assert all(one.pose.pose is None or np.isfinite(one.pose.pose).all() for one in said)
    notes = [note for one in said for note in one.notes]
    assert sum("went back" in note and "3 times" in note for note in notes) == 1
    assert any("the odometry is not finite" in note for note in notes)
    assert any("the believed pose is not finite" in note for note in notes)
    assert said[-1].t > 1e9 and said[-1].pose.status == "ok"


def status(**values: Any) -> WatchStatus:
    pose = PoseStatement(
        status="ok", p=1.0, pose=np.zeros(3), deviations=np.zeros(3), offset=(0.0, 0.0), rivals=np.zeros((0, 3)),
        is_known_place=True, is_believed=True, p_wrong=0.0,
    )  # fmt: skip
    parts: dict[str, Any] = {
        "t": 0.0,
        "pose": pose,
        "changes": (),
        "share_predicted": 1.0,
        "doubts": (),
        "notes": (),
    }
    return WatchStatus(**{**parts, **values})


def test_a_status_prints_its_sentences() -> None:
    first, *sentences = repr(status(t=1.0)).splitlines()
    assert first == "WatchStatus at 1.0 s"
    assert [line.strip() for line in sentences] == [*status().sentences()]


def test_scans_that_stop_before_the_run_are_noted(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def said(*_: object, **__: object) -> Iterator[WatchStatus]:
        yield from (status(t=1.0), status(t=2.0, notes=("first",)))

    monkeypatch.setattr(watcher, "watch_scans", said)
    graph: Any = None
    cut = run.take_scans(slice(0, 100))
    assert [one.notes for one in watcher.watch_run(graph, cut)] == [
        (), ("first", "no scan in the last 10.0 s of the run"),
    ]  # fmt: skip
    assert [one.notes for one in watcher.watch_run(graph, run)] == [(), ("first",)]


def test_the_next_step_can_be_pasted(tmp_path: Path) -> None:
    change: Any = type("Lasting", (), {"p": 0.95})()
    fault: Any = type("Named", (), {"name": "range_bias"})()
    run_file, graph = tmp_path / "a run.mcap", tmp_path / "lab.sensorgraph"

    def step(summary: WatchSummary, **values: Any) -> str:
        summary.last = type("Last", (), {"changes": (), "faults": (), "pose": status().pose, **values})()  # type: ignore[assignment]
        return summary.next_step()

    words = shlex.split(step(WatchSummary(run_file, graph), changes=(change,)).partition(": ")[2])
    assert words == ["sensorgraph", "build", str(run_file), "--update", str(graph), "-o", str(tmp_path / "lab_updated.sensorgraph")]  # fmt: skip
    assert "build the graph again" in step(WatchSummary(run_file, graph, can_update=False), changes=(change,))
    words = shlex.split(step(WatchSummary(run_file, graph), faults=(fault,)).partition("by: ")[2])
    assert words == ["sensorgraph", "diagnose", str(run_file), "-o", "diagnosis"]
    assert "sensorgraph record --live -o run.mcap && " in step(WatchSummary(None, graph), faults=(fault,))


@pytest.mark.parametrize("value", [50, float("nan")])
def test_a_limit_that_can_never_be_met_is_refused(value: float, tmp_path: Path) -> None:
    path = tmp_path / "site.yaml"
    save_policy(path, WatchPolicy(share_predicted={"warning": value, "error": 0.3}))
    with pytest.raises(SensorgraphError, match="`share_predicted` of warning is"):
        load_policy(path)


def test_a_misspelt_fault_in_a_policy_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "site.yaml"
    save_policy(path, WatchPolicy())
    data = yaml.safe_load(path.read_text())
    data["robot"]["baseline"] = {"range_bais": {"value": 0.0, "tolerance": 0.01}}
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(SensorgraphError, match="no fault `range_bais`; did you mean `range_bias`"):
        load_policy(path)
