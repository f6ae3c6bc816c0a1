"""Rays that end at the robot itself are no surfaces of the place; walls that the robot follows are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from logs.run import RangeSensor, Run, pair
from planners.arena import Arena
from sensorgraph.building.build import build
from sensorgraph.localization.robot_parts import robot_parts_at_poses
from sensorgraph.types import Bools, Floats
from sensorgraph.world.raycast import cast


def drive(room: Arena, sensor: RangeSensor, poses: Floats) -> Run:
    stamps, rng = np.arange(len(poses)) / 10, np.random.default_rng(2)
    ranges = cast(room, poses, sensor).ranges
    return Run(
        sensor=sensor, stamps=stamps, ranges=ranges + 0.005 * rng.normal(size=ranges.shape), pose_stamps=stamps, poses=poses,
    )  # fmt: skip


@pytest.fixture(scope="module")
def circling(room: Arena, sensor: RangeSensor) -> Run:
    t = np.arange(200) / 10
    return drive(
        room, sensor, np.column_stack([1.5 + 0.7 * np.cos(0.4 * t), 1.5 + 0.7 * np.sin(0.4 * t), 0.3 * t])
    )


def rays_on_robot(run: Run) -> Bools:
    return np.isfinite(robot_parts_at_poses(run, pair(run)))


def with_posts(run: Run) -> tuple[Run, Floats]:
    """Hide every fourth group of five rays behind a part of the robot."""
    hidden = np.arange(run.sensor.n_rays) // 5 % 4 == 1
    rng = np.random.default_rng(4)
    posts = 0.2 + 0.005 * rng.normal(size=run.ranges.shape)
    return replace(run, ranges=np.where(hidden, posts, run.ranges)), hidden


def test_rays_on_the_robot_are_found_where_it_moves(circling: Run) -> None:
    run, hidden = with_posts(circling)
    np.testing.assert_array_equal(rays_on_robot(run), hidden)
    assert not rays_on_robot(circling).any()
    still = replace(run, poses=np.tile(run.poses[:1], (len(run.poses), 1)))
    assert not rays_on_robot(still).any()


def test_a_part_that_hides_half_of_the_readings_is_found(circling: Run) -> None:
    run, hidden = with_posts(circling)
    some = np.random.default_rng(6).random(run.ranges.shape) < 0.5
    run = replace(run, ranges=np.where(some, run.ranges, circling.ranges))
    np.testing.assert_array_equal(rays_on_robot(run), hidden)


def test_a_wall_that_the_robot_follows_is_no_part_of_it(room: Arena, sensor: RangeSensor) -> None:
    along = np.column_stack([np.linspace(0.6, 2.2, 80), np.full(80, 0.5), np.zeros(80)])
    run = drive(room, sensor, along)
    same = np.ptp(run.ranges, axis=0) < 0.05
    assert same.any()  # rays to the wall beside it
    assert not rays_on_robot(run).any()


def test_a_graph_has_no_surfaces_of_the_robot(circling: Run) -> None:
    run, hidden = with_posts(circling)
    graph = build([run], calibrate=False)
    warnings = graph.origin["inputs"][0]["warnings"]
    assert any(f"{hidden.sum()} of {len(hidden)} rays see the robot itself" in text for text in warnings)
    answered = graph.predict(run.poses[::20]).answered
    assert answered[:, ~hidden].mean() > 0.9
