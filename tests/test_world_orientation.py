"""A mirrored or reversed scan is noticed, with a map and without; a right one is left in peace."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from logs.run import RangeSensor, Run
from planners.arena import Arena
from sensorgraph.world.orientation import orientation
from sensorgraph.world.raycast import cast


@pytest.fixture(scope="module")
def run(room: Arena, sensor: RangeSensor) -> Run:
    rng = np.random.default_rng(0)
    poses = rng.uniform([0.4, 0.4, -np.pi], [2.2, 2.6, np.pi], (60, 3))
    stamps = 0.1 * np.arange(60)
    ranges = cast(room, poses, sensor).ranges + 0.01 * rng.normal(size=(60, sensor.n_rays))
    return Run(sensor=sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses)


def spoilt(run: Run, how: str) -> Run:
    if "mirrored" in how:
        run = replace(run, ranges=run.ranges[:, ::-1])
    if "180" in how:
        mount = run.sensor.mount + [0, 0, np.pi]
        run = replace(run, sensor=replace(run.sensor, mount=mount))
    return run


@pytest.mark.parametrize("with_map", [True, False])
@pytest.mark.parametrize("how", ["as logged", "mirrored", "turned 180°", "mirrored and turned 180°"])
def test_the_true_orientation_fits_best(run: Run, room: Arena, how: str, with_map: bool) -> None:
    found = orientation(spoilt(run, how), room if with_map else None)
    assert found is not None
    assert found.best == how
    assert any("WARNING" in line for line in found.lines()) == (how != "as logged")


def test_a_run_without_poses_has_no_verdict(run: Run, room: Arena) -> None:
    assert orientation(replace(run, pose_stamps=np.zeros(0), poses=np.zeros((0, 3))), room) is None


@pytest.mark.parametrize(
    ("source", "said"), [("/pose", "WARNING: the scan fits"), ("odometry /odom", "the poses are odometry")]
)
def test_only_reference_poses_accuse_the_map(run: Run, room: Arena, source: str, said: str) -> None:
    """Odometry begins at 0, wherever the robot is in the map."""
    elsewhere = replace(run, poses=run.poses + [0.4, 0.3, 0.0], meta={"pose_source": source})
    found = orientation(elsewhere, room)
    assert found is not None and found.best == "as logged"
    assert found.lines()[1].startswith(said)
