"""Against a run that is known to be good, what the site always shows is silent and what has changed is named."""

from __future__ import annotations

import sys
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from conftest import polygon_arena

from logs.run import RangeSensor, Run
from planners.arena import Arena, Floats
from sensorgraph.diagnose.commissioning import Commissioned, commission
from sensorgraph.diagnose.diagnose import Finding, diagnose
from sensorgraph.diagnose.evidence import gather
from sensorgraph.world import robot_file

ARENA = polygon_arena(
    [(0, 0), (6, 0), (6, 4), (3.5, 4), (3.5, 5), (0, 5)],
    [(4.0, 1.2), (4.6, 1.2), (4.6, 1.9), (4.0, 1.9)],
)
SENSOR = RangeSensor(bearings=np.linspace(-1.5, 1.5, 61), range_max=8.0, sigma=0.01, resolution=0.001)
ROBOT = replace(robot_file.default(), sensor=SENSOR)


def site_run(seed: int, *, bias: float = 0.0, turn: float = 0.0) -> Run:
    """Drive through a site that always shows the same: jittery laser poses, noise with the range, strays, passers-by."""
    rng = np.random.default_rng(seed)
    t = np.arange(160) * 0.2
    phase = rng.uniform(0, 2 * np.pi)
    poses = np.stack(
        [
            2.2 + 1.1 * np.sin(0.21 * t + phase),
            2.4 + 0.9 * np.cos(0.17 * t + phase),
            2.5 * np.sin(0.3 * t + phase),
        ],
        axis=1,
    )
    angle = poses[:, 2:] + SENSOR.bearings + turn
    exact = ranges_in(ARENA, poses[:, :2], angle)
    z = exact + bias + rng.normal(size=exact.shape) * np.hypot(0.01, 0.006 * exact)
    stray = rng.random(z.shape) < 0.04
    z = np.where(stray, rng.uniform(0.05, 8.0, z.shape), z)
    first = rng.integers(
        0, 50, len(t)
    )  # somebody in the way of a few neighbouring rays, in every fourth scan
    by = (np.abs(np.arange(61) - first[:, None]) < 3) & (rng.random(len(t)) < 0.25)[:, None]
    z = np.where(by, np.minimum(z, rng.uniform(0.5, 1.5, (len(t), 1))), z)
    z = np.where(rng.random(z.shape) < 0.02, np.inf, np.round(z, 3))
    said = poses + rng.normal(size=poses.shape) * [0.01, 0.01, 0.004]
    return Run(sensor=SENSOR, stamps=t, ranges=z, pose_stamps=t, poses=said, pose_frame="laser")


def ranges_in(arena: Arena, origins: Floats, angle: Floats) -> Floats:
    """Meet every ray with every wall; ranges like angle (n_scans, n_rays)."""
    a, d = arena.walls[:, 0], arena.walls[:, 1] - arena.walls[:, 0]
    ux, uy = np.cos(angle)[..., None], np.sin(angle)[..., None]
    x, y = a[:, 0] - origins[:, None, :1], a[:, 1] - origins[:, None, 1:]
    cross = ux * d[:, 1] - uy * d[:, 0]
    r = (x * d[:, 1] - y * d[:, 0]) / cross
    along = (x * uy - y * ux) / cross
    best = np.where((r > 0) & (along >= 0) & (along <= 1), r, np.inf).min(axis=-1)
    return np.asarray(best)


@pytest.fixture(scope="module")
def good() -> Commissioned:
    return commission(site_run(1), ARENA, ROBOT)


def against(good: Commissioned | None, run: Run) -> Finding:
    return diagnose(run, ARENA, ROBOT, commissioned=good, plan_next=False)


def names(finding: Finding) -> list[str]:
    return [a.name for a in finding.effects]


@pytest.mark.slow
def test_what_the_site_always_shows_is_silent_against_a_good_run(good: Commissioned) -> None:
    finding = against(good, site_run(2))
    assert names(finding) == []
    assert finding.unknown is None
    bare = against(None, site_run(2))
    assert names(bare) or bare.unknown is not None


@pytest.mark.slow
def test_a_bias_that_the_good_run_lacks_is_named_first_with_its_size(good: Commissioned) -> None:
    effect = against(good, site_run(3, bias=0.04)).effects[0]
    assert effect.name == "range_bias"
    assert effect["b"] == pytest.approx(0.04, abs=0.006)


@pytest.mark.slow
def test_a_turned_laser_is_named_though_the_poses_are_its_own(good: Commissioned) -> None:
    effect = against(good, site_run(4, turn=0.02)).effects[0]
    assert effect.name == "mount_yaw"
    assert effect["delta"] == pytest.approx(0.02, abs=0.004)
    bare, _ = gather(site_run(4), ARENA, ROBOT)
    assert bare.laser_frame
    assert not good.told(bare).laser_frame


def test_the_good_run_loosens_pose_tolerances_to_what_its_poses_deserve(good: Commissioned) -> None:
    t = good.robot.tolerances
    assert 0.006 < t.pose_xy < 0.02  # 10 mm planted
    assert 0.002 < t.pose_yaw < 0.008  # 4 mrad planted
    assert 0.01 < good.freedom.stray[1] < 0.2


@pytest.mark.slow
def test_real_log_is_silent_untouched_and_names_a_planted_bias(real_logs: Path) -> None:
    sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
    try:
        import planted_effects as planted
    finally:
        sys.path.pop(0)
    log = planted.read(real_logs / "ple-freiburg-079" / "freiburg-079-corrected.log.gz")
    _, _, other, window = islice(planted.windows(log), 4)
    told = planted.robot(log, 0.01)
    good = commission(planted.measurement(log, other.scans), other.arena, told)
    run = planted.measurement(log, window.scans)
    untouched = diagnose(run, window.arena, told, commissioned=good, plan_next=False)
    assert names(untouched) == []
    longer = planted.bias(run, log, window.scans, 0.03, np.random.default_rng(0))
    named = diagnose(longer, window.arena, told, commissioned=good, plan_next=False).effects[0]
    assert named.name == "range_bias"
    assert named["b"] == pytest.approx(0.03, abs=0.01)  # the map of scans has an offset of its own
