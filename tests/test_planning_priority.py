"""Doubt is highest where a sensorgraph was never fed, and the planner goes there first."""

from __future__ import annotations

import numpy as np
import pytest

from logs.run import RangeSensor, Run
from planners import plan
from planners.arena import Arena
from planners.coverage import Coverage
from planners.vehicle import Vehicle
from sensorgraph.building.build import build
from sensorgraph.graph import Sensorgraph
from sensorgraph.planning.priority import uncertainty
from sensorgraph.world.raycast import cast

pytestmark = pytest.mark.usefixtures("trusted_scans", "narrow_search")


@pytest.fixture(scope="module")
def left(room: Arena, sensor: RangeSensor) -> Sensorgraph:
    """Build from scans of the left half of the room only."""
    rng = np.random.default_rng(0)
    poses = rng.uniform([0.3, 0.3, -np.pi], [1.9, 2.7, np.pi], (1500, 3))
    stamps = 0.1 * np.arange(len(poses))
    ranges = cast(room, poses, sensor).ranges + 0.01 * rng.normal(size=(len(poses), sensor.n_rays))
    run = Run(sensor=sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses)
    return build([run], model="polynomial", degree=2, harmonics=3)


def test_doubt_is_one_where_nothing_is_answered_and_lower_elsewhere(left: Sensorgraph) -> None:
    cells = np.ones((16, 12), dtype=np.bool_)
    cells[0, 0] = False
    grid = Coverage.empty(origin=np.zeros(2), cell=0.25, cells=cells, headings=8)
    score = uncertainty(left, grid)
    assert score.shape == (16, 12, 8)
    assert score[0, 0].max() == 0.0
    assert score[12:, 2:-2].min() == 1.0
    assert score[2:6, 3:9].max() <= 0.5
    few = uncertainty(left, grid, max_rays=12)  # of 61: those between see much the same
    assert np.abs(few - score).max() < 0.1
    assert not np.array_equal(few, score)


def test_the_planner_goes_first_where_the_graph_knows_least(left: Sensorgraph, room: Arena) -> None:
    made = plan(room, Vehicle(), headings=4, priority=lambda grid: uncertainty(left, grid))
    x = made.trajectory.poses[:, 0]
    half = len(x) // 2
    assert x[:half].mean() > x[half:].mean() + 0.8
    assert made.report["coverage"] == 1.0
