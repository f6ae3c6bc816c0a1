"""Banded smoothing against the dense solution, and what it does with outliers."""

from __future__ import annotations

import numpy as np

from logs.transforms import compose, invert
from sensorgraph.localization.line_map import line_map
from sensorgraph.localization.mapping import _PlacedScans, _smoothed
from sensorgraph.localization.scan_track import ScanTrack
from sensorgraph.localization.smoothing import _banded, _inverse_blocks, smooth, steps_of
from sensorgraph.localization.wheels import WheelEstimate


def test_diagonal_blocks_of_the_inverse_are_those_of_the_dense_inverse() -> None:
    rng = np.random.default_rng(0)
    n = 7
    dense = np.zeros((3 * n, 3 * n))
    lower = rng.normal(size=(n - 1, 3, 3))
    diagonal = np.array([m @ m.T + 12 * np.eye(3) for m in rng.normal(size=(n, 3, 3))])
    for k in range(n):
        dense[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = diagonal[k]
    for k in range(n - 1):
        dense[3 * k + 3 : 3 * k + 6, 3 * k : 3 * k + 3] = lower[k]
        dense[3 * k : 3 * k + 3, 3 * k + 3 : 3 * k + 6] = lower[k].T
    inverse = np.linalg.inv(dense)
    blocks = _inverse_blocks(diagonal, lower)
    bands = _banded(diagonal, lower)
    for k in range(n):
        np.testing.assert_allclose(blocks[k], inverse[3 * k : 3 * k + 3, 3 * k : 3 * k + 3], atol=1e-12)
    for distance in range(6):
        np.testing.assert_array_equal(bands[distance, : 3 * n - distance], np.diagonal(dense, -distance))


def drive(n: int, rng: np.random.Generator) -> np.ndarray:
    poses = np.zeros((n, 3))
    for k in range(1, n):
        poses[k] = compose(poses[k - 1], np.array([0.1, 0.0, rng.normal(0, 0.2)]))
    return poses


def test_truth_lies_within_two_standard_errors_of_the_smoothed_poses() -> None:
    rng = np.random.default_rng(1)
    step_sd, place_sd = np.array([0.01, 0.01, 0.005]), np.array([0.03, 0.03, 0.02])
    inside = []
    for _ in range(40):
        truth = drive(60, rng)
        steps = compose(invert(truth[:-1]), truth[1:]) + rng.normal(size=(59, 3)) * step_sd
        places = truth + rng.normal(size=(60, 3)) * place_sd
        information = np.broadcast_to(np.diag(place_sd**-2.0), (60, 3, 3)).copy()
        information[20:30] = 0  # nothing seen there
        found = smooth(
            places, steps, np.broadcast_to(np.diag(step_sd**-2.0), (59, 3, 3)), places, information
        )
        off = found.poses - truth
        off[:, 2] = np.angle(np.exp(1j * off[:, 2]))
        sd = np.sqrt(np.diagonal(found.covariances, axis1=1, axis2=2))
        inside.append(np.abs(off) < 2 * sd)
        assert sd[25, 0] > sd[10, 0] and sd[25, 0] < 0.05
    assert 0.93 < np.mean(inside) < 0.97


def test_place_far_off_pulls_the_track_little() -> None:
    truth = drive(50, np.random.default_rng(2))
    steps = compose(invert(truth[:-1]), truth[1:])
    places = truth.copy()
    places[25] += [1.0, -1.0, 0.5]
    found = smooth(
        truth,
        steps,
        np.broadcast_to(np.diag([1e4, 1e4, 1e5]), (49, 3, 3)),
        places,
        np.broadcast_to(np.diag([1e3, 1e3, 1e4]), (50, 3, 3)),
    )
    assert np.abs(found.poses - truth)[:, :2].max() < 0.005


def test_steps_to_and_from_a_scan_that_the_odometry_placed_are_as_uncertain_as_the_odometry() -> None:
    truth = drive(5, np.random.default_rng(3))
    matched = np.array([True, True, False, True, True])
    none = np.zeros((4, 3))
    track = ScanTrack(
        poses=truth, matched=matched, is_continuous=np.ones(5, dtype=bool), key_frames=np.arange(5), piece=np.zeros(5, dtype=int),
        edge_information=np.zeros((4, 3, 3)), motion_deviations=none, is_carried=np.zeros(4, dtype=bool),
        projections=np.zeros((5, 3, 3)), jumps=(), noise=np.full(5, np.nan), wheels=WheelEstimate(),
    )  # fmt: skip
    _, information = steps_of(track)
    deviations = np.diagonal(information, axis1=1, axis2=2) ** -0.5
    steps = compose(invert(truth[:-1]), truth[1:])
    by_odometry = WheelEstimate().deviations(np.hypot(*steps[:, :2].T), steps[:, 2])
    np.testing.assert_allclose(deviations[1:3], by_odometry[1:3])
    assert (deviations[[0, 3]] < by_odometry[[0, 3]]).all()


def test_places_determine_the_motion_where_the_track_was_found_elsewhere() -> None:
    """The track is 9 cm off until scan 6, where it finds the map again; all scans but the first three fit the map."""
    n, at = 12, 6
    truth = np.column_stack([0.04 * np.arange(n), np.zeros(n), np.zeros(n)])
    tracked = truth.copy()
    tracked[:at, :2] += [0.08, 0.04]
    is_continuous = np.ones(n, dtype=bool)
    is_continuous[at] = False
    track = ScanTrack(
        poses=tracked, matched=np.ones(n, dtype=bool), is_continuous=is_continuous, key_frames=np.array([0, n - 1]),
        piece=np.zeros(2, dtype=int), edge_information=np.zeros((1, 3, 3)), motion_deviations=np.zeros((1, 3)),
        is_carried=np.zeros(1, dtype=bool), projections=np.zeros((2, 3, 3)), jumps=(), noise=np.full(n, np.nan),
        wheels=WheelEstimate(),
    )  # fmt: skip
    placed = _PlacedScans(
        poses=truth, shared=np.zeros((n, 3, 3)), own=np.tile(0.004**2 * np.eye(3), (n, 1, 1)), matched=np.arange(n) > 2,
        surfaces=line_map(np.zeros((1, 2)), np.array([[1.0, 0.0]]), side=0.5), missed=np.zeros(n, dtype=bool), wheels=np.zeros(3),
    )  # fmt: skip
    found = _smoothed(track, placed, has_odometry=True)
    assert np.hypot(*(found.poses - truth)[:, :2].T).max() < 0.002
