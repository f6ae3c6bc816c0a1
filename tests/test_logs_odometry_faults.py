"""Faults of odometry, planted in a drive on a circle: exactly the planted poses are found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbag_samples import odometry, read, scan, transform

from logs.motion import Motion
from logs.odometry_faults import _are_crowded, hung_poses, jumps, measured_poses, wrong_poses
from logs.transforms import compose, invert, wrap
from sensorgraph.localization.missing_odometry import without_corrections

T = np.arange(0.0, 20.0, 0.02)
PHI = 0.4 * T
DRIVE = np.column_stack([1.5 * np.sin(PHI), 1.5 * (1 - np.cos(PHI)), wrap(PHI)])
"""0.6 m/s on a circle of 1.5 m radius; the heading wraps."""


@pytest.mark.parametrize("every", [1, 5])
@pytest.mark.parametrize("length", [1, 2, 5])
@pytest.mark.parametrize(
    "off", [(0.0, 0.3, 0.0), (0.0, 0.0, 0.5), (0.0, 0.0, 3.0)], ids=["place", "heading", "turned"]
)
def test_a_few_poses_off_the_way_are_found(off: tuple[float, ...], length: int, every: int) -> None:
    stamps, poses = T[::every], DRIVE[::every].copy()
    planted = np.concatenate([first + np.arange(length) for first in (40, 90, 150)])
    poses[planted] = compose(poses[planted], np.broadcast_to(np.array(off), (len(planted), 3)))
    np.testing.assert_array_equal(np.flatnonzero(wrong_poses(stamps, poses)), planted)
    assert len(jumps(stamps, DRIVE[::every])) == 0


def test_poses_that_a_robot_can_have_are_left() -> None:
    rng = np.random.default_rng(4)
    noisy = DRIVE + rng.normal(scale=0.02, size=DRIVE.shape)
    coarse = np.round(DRIVE / 0.05) * 0.05
    stopped = np.where(T[:, None] < 10, DRIVE, DRIVE[500])  # against a wall, at once
    late = DRIVE[
        np.maximum.accumulate(np.arange(1000) - (20 * rng.random(1000) ** 4).astype(int)).clip(0)
    ]  # it hangs
    unknown = DRIVE.copy()
    unknown[300] = np.nan
    for poses in (DRIVE, noisy, coarse, stopped, late, unknown):
        assert not wrong_poses(T, poses).any()
        assert len(jumps(T, poses)) == 0
    assert not wrong_poses(T[:2], DRIVE[:2]).any() and len(jumps(T[:1], DRIVE[:1])) == 0


@pytest.mark.parametrize(
    ("groups", "crowded"),
    [
        ("_____x_x_____", False), ("___xx__xxx____", False), ("xxx___xxxx", False), ("xxx__xxx", True),
        ("____xxxx_xxxx_xx___", True), ("xx_xxx____", True), ("__________", False), ("__xx", False),
    ],
)  # fmt: skip
def test_groups_with_hardly_a_right_pose_between_them_are_no_single_faults(
    groups: str, crowded: bool
) -> None:
    """As of odometry that was integrated with headings in another unit; without them it would have a gap."""
    assert _are_crowded(np.array([one == "x" for one in groups])) is crowded


@pytest.mark.parametrize("jump", [(0.3, -0.4, 0.0), (0.0, 0.0, 0.5)], ids=["place", "heading"])
def test_a_filter_that_is_corrected_is_joined(jump: tuple[float, float, float]) -> None:
    poses = DRIVE.copy()
    for first in (300, 700):  # moved by the jump in the frame of the robot
        moved = compose(compose(poses[first], np.array(jump)), invert(poses[first]))
        poses[first:] = compose(np.broadcast_to(moved, poses[first:].shape), poses[first:])
    assert not wrong_poses(T, poses).any()
    np.testing.assert_array_equal(jumps(T, poses), [299, 699])
    unwrapped = np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])
    joined, notes = without_corrections(Motion(stamps=T, poses=unwrapped))
    assert np.abs(joined.poses[:, :2] - DRIVE[:, :2]).max() < 1e-3  # an arc is joined by its chord
    assert np.abs(wrap(joined.poses[:, 2] - DRIVE[:, 2])).max() < 1e-3
    assert len(notes) == 1 and "jumps 2 times" in notes[0]


def test_a_jump_that_may_be_another_place_stays() -> None:
    poses = DRIVE + np.where(T[:, None] < 10, 0.0, [3.0, 0.0, 0.0])
    motion = Motion(stamps=T, poses=np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])]))
    joined, notes = without_corrections(motion)
    assert joined is motion and notes == ()


def test_odometry_that_repeats_its_poses_keeps_the_measured_ones() -> None:
    held = DRIVE[np.arange(len(T)) // 10 * 10]
    np.testing.assert_array_equal(measured_poses(T, held), np.arange(0, 1000, 10))
    stands = held.copy()
    stands[300:500], stands[800:] = (
        stands[300],
        stands[800],
    )  # until 0.2 s before the next pose, and to the end
    expected = [*range(0, 300, 10), *range(300, 491), *range(500, 800, 10), *range(800, 1000)]
    np.testing.assert_array_equal(measured_poses(T, stands), expected)
    assert measured_poses(T, DRIVE) is None and measured_poses(T, np.zeros_like(DRIVE)) is None


def test_poses_of_a_driver_that_hangs_and_catches_up_are_found() -> None:
    hangs, stands, goes_on = DRIVE.copy(), DRIVE.copy(), DRIVE.copy()
    hangs[300:450] = hangs[300]  # 3 s, and then it is where the robot is
    np.testing.assert_array_equal(np.flatnonzero(hung_poses(T, hangs)), np.arange(301, 450))
    assert len(jumps(T, hangs)) == 0
    slowing = PHI[300] + 0.4 * (
        1 - np.exp(-(T[:300]))
    )  # it stops slowly, and is corrected by 0.5 m while it stands
    stands[300:600] = np.round(
        np.column_stack([1.5 * np.sin(slowing), 1.5 * (1 - np.cos(slowing)), slowing]), 3
    )
    stands[600:] = stands[599] + [0.5, 0.0, 0.0]
    stands[800:] = compose(stands[800], compose(invert(DRIVE[800]), DRIVE[800:]))
    goes_on[300:450] = goes_on[300]  # it lost this way
    goes_on[450:] = compose(goes_on[300], compose(invert(DRIVE[450]), DRIVE[450:]))
    for poses in (DRIVE, stands, goes_on, DRIVE[:3]):
        assert not hung_poses(T[: len(poses)], poses).any()


def test_a_log_is_read_without_wrong_and_repeated_poses(tmp_path: Path) -> None:
    mount = transform(0.0, "base_link", "laser", 0.2, 0.0, 0.0, static=True)
    scans = [scan(t, [1, 2, 3]) for t in T[::5]]
    wrong = DRIVE[:500].copy()
    wrong[[100, 200]] = 0.0
    for name, poses, kept in (
        ("wrong", wrong, np.delete(np.arange(500), [100, 200])),
        ("held", DRIVE[np.arange(500) // 10 * 10], np.arange(0, 500, 10)),
    ):
        (tmp_path / name).mkdir()
        wheels = [odometry(t, *pose) for t, pose in zip(T, poses, strict=False)]
        run = read(tmp_path / name, [mount, *sorted([*scans, *wheels], key=lambda one: one[2])])
        np.testing.assert_allclose(run.odom_stamps, T[kept], atol=1e-6)
        np.testing.assert_allclose(run.odometry[:, :2], poses[kept, :2], atol=1e-6)
        said = {"wrong": "2 of 500 poses contradict", "held": "450 poses that repeat the one before"}[name]
        assert said in run.meta["notes"]
