"""plan.mcap opens in rosbags with the path and grids that went in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader

from logs.plan_file import thin, write_plan
from logs.run import OccupancyMap


def test_path_and_grids_are_read_back(tmp_path: Path) -> None:
    t = np.linspace(0, 60, 3001)
    poses = np.column_stack([np.cos(t / 10), np.sin(t / 10), np.arctan2(np.cos(t / 10), -np.sin(t / 10))])
    grid = OccupancyMap(
        data=np.array([[0, 50, 100], [-1, 25, 75]], dtype=np.int8),
        resolution=0.25,
        origin=np.array([1.0, 2, 0]),
    )
    write_plan(
        tmp_path / "plan.mcap", t, poses, epoch_ns=10**18, coverage=grid, attachments={"plan.json": b"{}"}
    )
    assert [p.name for p in tmp_path.iterdir()] == ["plan.mcap"]
    with AnyReader([tmp_path / "plan.mcap"]) as reader:
        messages = {
            c.topic: (stamp, reader.deserialize(raw, c.msgtype)) for c, stamp, raw in reader.messages()
        }
    stamp, path = messages["/plan"]
    assert stamp == 10**18
    assert path.header.frame_id == "map"
    assert len(path.poses) == 3001
    last = path.poses[-1]
    assert (last.pose.position.x, last.pose.position.y) == (poses[-1, 0], poses[-1, 1])
    assert last.header.stamp.sec == 10**9 + 60
    assert 2 * np.arctan2(last.pose.orientation.z, last.pose.orientation.w) == np.float64(poses[-1, 2])
    _, cover = messages["/coverage"]
    assert (cover.info.width, cover.info.height, cover.info.resolution) == (3, 2, 0.25)
    assert cover.data.tolist() == [0, 50, 100, -1, 25, 75]


def test_thinning_keeps_both_ends_and_even_steps() -> None:
    poses = np.column_stack([np.linspace(0, 100, 200_000), np.zeros(200_000), np.zeros(200_000)])
    chosen = thin(poses, 1000)
    assert len(chosen) <= 1001
    assert chosen[[0, -1]].tolist() == [0, 199_999]
    assert np.diff(poses[chosen, 0]).max() < 0.2
