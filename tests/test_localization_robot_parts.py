"""Posts, cables and lids of the robot in the view of the laser; what also has constant ranges is kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from conftest import further
from localization_samples import CORRIDOR, ROOM, any_times, loop_poses, room_run

from logs.run import Run
from logs.transforms import compose, invert, wrap
from sensorgraph.localization.locate import locate
from sensorgraph.localization.robot_parts import without_robot_parts

LOOP = loop_poses(150)
NICHE = [(-2.0, 0.6, 0.6, 0.6), (1.4, 0.6, 9.0, 0.6)]
"""The wall of a corridor with a niche, between two places [m]."""


def with_part(run: Run, view: float, share: float = 1.0) -> tuple[Run, np.ndarray]:
    """Hide a share of the readings of the rays in a part of the view; return the run and which readings."""
    n, rng = run.sensor.n_rays, np.random.default_rng(7)
    rays = np.arange(n) < view * n
    hidden = rays & (rng.random(run.ranges.shape) < share)
    own = 0.3 + 0.05 * np.sin(np.arange(n) / 9) + 0.005 * rng.normal(size=run.ranges.shape)
    return replace(run, ranges=np.where(hidden, own, run.ranges)), hidden


def without_odometry(run: Run) -> Run:
    return replace(run, odom_stamps=np.zeros(0), odometry=np.zeros((0, 3)), odom_twists=np.zeros((0, 2)))


@any_times
@pytest.mark.parametrize("has_odometry", [False, *further(True)])
def test_a_lid_over_part_of_the_view_does_not_hold_the_robot_back(
    has_odometry: bool, times: Callable[[Run], Run]
) -> None:
    run, _ = with_part(times(room_run(LOOP, n_rays=180)), 0.6)
    found = locate(run if has_odometry else without_odometry(run))
    assert any("108 of 180 rays see the robot itself" in note for note in found.notes)
    off = compose(compose(LOOP[75], invert(found.poses[75])), found.poses) - LOOP
    assert set(found.status) == {"ok"}
    assert np.hypot(*off[:, :2].T).max() < 0.03  # [m] three times the noise of a range
    assert np.abs(wrap(off[:, 2])).max() < np.radians(1)
    assert not any("contradict" in note for note in found.notes)


@pytest.mark.parametrize("share", [1.0, *further(0.1, 0.5)])
def test_only_the_readings_of_the_part_are_left_out(share: float) -> None:
    run, hidden = with_part(room_run(LOOP, n_rays=180), 0.25, share)
    kept, notes = without_robot_parts(run)
    assert len(notes) == 1
    left_out = np.isnan(kept.ranges)
    assert (left_out & hidden).sum() > 0.9 * hidden.sum()
    assert (left_out & ~hidden).sum() < 0.01 * hidden.size


def corridor() -> Run:
    """Drive straight, 0.4 m from one smooth wall and 0.6 m from the other."""
    walls = [(x0, y0 * 0.5 + 0.1, x1, y1 * 0.5 + 0.1) for x0, y0, x1, y1 in CORRIDOR]
    x = np.linspace(0.0, 8.0, 160)
    return room_run(np.column_stack([x, 0 * x, 0 * x]), n_rays=180, walls=[*walls, (12.0, -2.0, 12.0, 2.0)])


def wall_with_a_niche() -> Run:
    """Drive along a wall 0.6 m away that has a niche; the other wall is far away."""
    x = np.linspace(-1.0, 6.0, 160)
    walls = [*NICHE, (0.6, 0.6, 0.6, 1.1), (0.6, 1.1, 1.4, 1.1), (1.4, 1.1, 1.4, 0.6), (-3.0, -4.0, 9.0, -3.0), (9.0, -3.0, 9.0, 0.6)]  # fmt: skip
    return room_run(np.column_stack([x, 0 * x, 0 * x]), n_rays=180, walls=walls)


def round_room() -> Run:
    """Turn in the middle of a round room with a door."""
    a = np.linspace(0.3, 2 * np.pi - 0.3, 90)
    ring = 0.8 * np.column_stack([np.cos(a), np.sin(a)])
    walls = [(*ring[k], *ring[k + 1]) for k in range(len(ring) - 1)]
    poses = np.column_stack([np.zeros((150, 2)), np.linspace(0.0, 9.0, 150)])
    outside = [(-2.0, -3.0, 4.0, -3.0), (4.0, -3.0, 3.5, 3.0), (3.5, 3.0, -2.0, 3.0)]
    return room_run(poses, n_rays=180, walls=[*walls, *outside])


def standing() -> Run:
    """Stand near a corner, and turn once."""
    turn = np.clip(np.arange(150) - 130, 0, None) * 0.1
    return room_run(np.column_stack([0.5 + 0 * turn, 0.6 + 0 * turn, turn]), n_rays=180, walls=ROOM)


def spinning_wheels() -> Run:
    """Stand in a room while the wheels drive ahead."""
    run, ahead = standing(), room_run(np.column_stack([0.05 * np.arange(150), np.zeros((150, 2))]))
    return replace(run, odometry=ahead.odometry)


@any_times
def test_a_part_is_found_where_only_the_odometry_shows_the_motion(times: Callable[[Run], Run]) -> None:
    """In a corridor, the part is the only thing that determines the place: the scans seem to stand."""
    x = np.linspace(0.0, 6.0, 150)
    truth = np.column_stack([x, 0 * x, 0 * x])
    run, _ = with_part(times(room_run(truth, n_rays=180, walls=CORRIDOR)), 0.25)
    found = locate(run)
    assert any("45 of 180 rays see the robot itself" in note for note in found.notes)
    off = compose(compose(truth[0], invert(found.poses[0])), found.poses) - truth
    assert np.hypot(*off[:, :2].T).max() < 0.1  # [m] exact odometry as a prior


DRIVES = [corridor, wall_with_a_niche, round_room, standing, spinning_wheels]


@pytest.mark.parametrize(
    ("drive", "has_odometry"),
    [
        *((drive, True) for drive in DRIVES),
        (corridor, False),
        *further(*((drive, False) for drive in DRIVES[1:])),
    ],
)
def test_walls_at_a_constant_range_are_kept(drive, has_odometry: bool) -> None:  # type: ignore[no-untyped-def]
    run = drive() if has_odometry else without_odometry(drive())
    ranges = np.minimum(run.ranges, run.sensor.range_max)
    middle = np.median(ranges, axis=0)
    same = (np.abs(ranges - middle) < 0.05).mean(axis=0)
    assert (same[middle < 1.0] > 0.8).any()
    assert without_robot_parts(run) == (run, ())
