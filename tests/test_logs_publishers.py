"""Two publishers on one odometry topic are separated; one publisher that jumps, restarts or counts coarsely stays whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbag_samples import odometry, read, scan, transform

from logs.notes import assumptions_of
from logs.publishers import of_one_publisher
from logs.transforms import compose

Floats = np.ndarray
T = np.arange(400) / 50
PATH = np.column_stack([1.7 * np.sin(0.35 * T), 1.7 * (1 - np.cos(0.35 * T)), 0.35 * T])
"""(400, 3) an arc at 0.6 m/s and 0.35 rad/s, 50 times a second."""
LATER = 0.007
"""[s] by which the messages of the second publisher are later."""


def both(other: Floats, every: int = 2) -> tuple[Floats, Floats, Floats]:
    """Return stamps and poses of two publishers in order, and which are of the first."""
    stamps, poses = np.concatenate([T, T[::every] + LATER]), np.concatenate([PATH, other[::every]])
    order = np.argsort(stamps, kind="stable")
    return stamps[order], poses[order], order < len(T)


@pytest.mark.parametrize("start", [(1.0, 0.5, 0.6), (0.0, 0.15, 0.0), (30.0, -8.0, 3.0)])
def test_a_filter_that_begins_elsewhere_is_separated_from_the_wheels(start: tuple[float, ...]) -> None:
    stamps, poses, is_first = both(compose(np.array(start), PATH))
    found = of_one_publisher(stamps, poses)
    assert found is not None
    np.testing.assert_array_equal(found, np.flatnonzero(is_first))
    poses[[100, 200]] = [[np.nan] * 3, [1e300] * 3]
    found = of_one_publisher(stamps, poses)
    assert found is not None
    np.testing.assert_array_equal(found, np.setdiff1d(np.flatnonzero(is_first), [100, 200]))


def test_a_filter_that_drifts_away_is_separated_where_it_differs() -> None:
    stamps, poses, is_first = both(PATH * [1.2, 1.2, 1.0])
    found = of_one_publisher(stamps, poses)
    assert found is not None
    first = np.column_stack([np.interp(stamps, T, column) for column in PATH.T])
    off = np.hypot(*(poses - first)[:, :2].T)
    assert is_first[found].sum() > 350
    assert found[0] == 0 and np.diff(stamps[found]).max() < 0.03  # from the beginning, without a gap
    assert off[found].max() < 0.03  # 2 cm, in which a pose may be that of either, and 7 ms at 0.6 m/s


def test_a_publisher_of_zeros_is_not_the_odometry_however_often_it_publishes() -> None:
    stamps, poses, _ = both(np.zeros_like(PATH), every=1)
    stamps, poses = np.concatenate([stamps, T + 2 * LATER]), np.concatenate([poses, np.zeros_like(PATH)])
    order = np.argsort(stamps, kind="stable")
    found = of_one_publisher(stamps[order], poses[order])
    assert found is not None
    is_moving = np.abs(poses[order]).any(axis=1)
    assert np.isin(np.flatnonzero(is_moving), found).mean() > 0.95  # all but the first centimetres
    assert is_moving[found].mean() > 0.95


def test_a_publisher_that_restarts_is_one_publisher() -> None:
    again = PATH.copy()
    again[200:] = PATH[:200]
    assert of_one_publisher(T, again) is None
    stamps, poses, is_first = both(compose(np.array([9.0, 9.0, 0.0]), PATH))
    poses[is_first] = again
    found = of_one_publisher(stamps, poses)
    assert found is not None
    np.testing.assert_array_equal(found, np.flatnonzero(is_first))


def test_single_wrong_poses_and_coarse_ones_are_no_second_publisher() -> None:
    glitches = PATH.copy()
    glitches[np.arange(7, 400, 40)] += [2.0, -1.0, 0.0]
    assert of_one_publisher(T, glitches) is None
    assert of_one_publisher(T, np.round(PATH / 0.1) * 0.1) is None
    assert of_one_publisher(T, np.full_like(PATH, np.nan)) is None


@pytest.mark.parametrize("source", ["topic", "transforms"])
def test_the_odometry_of_a_log_is_that_of_one_publisher(source: str, tmp_path: Path) -> None:
    stamps, poses, _ = both(compose(np.array([0.5, -0.4, 0.3]), PATH))
    bag = [transform(0.0, "base_link", "laser", 0, 0, 0, static=True)]
    for t, (x, y, phi) in zip(stamps.tolist(), poses.tolist(), strict=True):
        is_topic = source == "topic"
        bag.append(
            odometry(t, x, y, phi, 0.595, omega=0.35)
            if is_topic
            else transform(t, "odom", "base_link", x, y, phi)
        )
    bag += [scan(t, [1, 2, 3]) for t in T[::5]]
    run = read(tmp_path, sorted(bag, key=lambda message: message[2]))
    np.testing.assert_allclose(run.odometry, PATH, atol=1e-6)
    np.testing.assert_allclose(run.odom_twists[1:-1], np.tile([0.595, 0.35], (398, 1)), atol=1e-3)
    assert any("two publishers, whose 400 and 200 poses alternate" in note for note in assumptions_of(run))
