"""Walls that are displaced within the cells of a map move all poses of a place; the stated covariances contain this."""

from __future__ import annotations

import numpy as np
import pytest

from sensorgraph.localization.displaced_walls import (
    StraightWalls,
    displacement_errors,
    straight_walls_of_grid,
)
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.types import Floats

CELL = 0.05
WIDE = np.array([1e3, 1e3, 1e3])
"""[m, m, rad] A prior that adds nothing."""
SQUARE = np.array([[[0, 0], [4, 0]], [[4, 0], [4, 4]], [[4, 4], [0, 4]], [[0, 4], [0, 0]]], dtype=float)


def scan_of(points: Floats) -> ScanPoints:
    """Return one scan with points (n, 2) in base_link."""
    n = len(points)
    return ScanPoints(
        first=np.array([0, n]), points=points, normals=np.zeros((n, 2)), ranges=np.ones(n),
        starts=np.zeros((n, 2)), rays=np.arange(n),
    )  # fmt: skip


def of_grid(walls: Floats) -> StraightWalls:
    return straight_walls_of_grid(walls, np.zeros((len(walls), 2)), np.array([1.0, 0.0]), CELL)


def test_two_opposite_walls_halve_the_variance_and_one_alone_keeps_it() -> None:
    along = np.linspace(-1.5, 1.5, 30)
    left, right = (np.column_stack([np.full(30, x), along]) for x in (-2.0, 2.0))
    low, high = (np.column_stack([along, np.full(30, y)]) for y in (-2.0, 2.0))
    pose, noise = np.array([[2.0, 2.0, 0.0]]), np.array([0.01])
    both, scatter = displacement_errors(
        scan_of(np.vstack([left, right, low, high])), pose, noise, of_grid(SQUARE), WIDE
    )
    one, alone = displacement_errors(scan_of(np.vstack([left, low])), pose, noise, of_grid(SQUARE), WIDE)
    variance = CELL**2 / 12
    assert np.diag(both[0])[:2] == pytest.approx(variance / 2)
    assert np.diag(one[0])[:2] == pytest.approx(variance)
    # four displacements, two coordinates and no turn: half of the squares remain, and none where two walls fix both
    assert scatter[0] == pytest.approx(variance / 2, rel=1e-6) and alone[0] < 1e-9


def test_covariance_is_that_of_matches_to_drawn_displacements() -> None:
    rng = np.random.default_rng(0)
    walls = np.concatenate([SQUARE, [[[4.0, 1.0], [2.5, 1.0]], [[2.5, 1.0], [2.5, 0.0]]]])
    pose, place = np.array([1.0, 2.5, 0.4]), of_grid(walls)
    at = np.concatenate(
        [
            wall[0] + np.linspace(0.1, 0.9, n)[:, None] * (wall[1] - wall[0])
            for wall, n in zip(walls, (8, 5, 30, 60, 9, 4), strict=True)
        ]
    )
    owner = np.repeat(np.arange(6), (8, 5, 30, 60, 9, 4))
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    points = (at - pose[:2]) @ turn
    ahead = np.diff(walls, axis=1)[:, 0] / np.linalg.norm(np.diff(walls, axis=1)[:, 0], axis=1)[:, None]
    normal = np.column_stack([-ahead[:, 1], ahead[:, 0]])[owner]
    rows = np.column_stack(
        [normal, normal[:, 1] * (at - pose[:2])[:, 0] - normal[:, 0] * (at - pose[:2])[:, 1]]
    )
    drawn = rng.uniform(-CELL / 2, CELL / 2, (4000, 6))
    errors = np.linalg.lstsq(rows, drawn[:, owner].T, rcond=None)[0]
    stated, scatter = displacement_errors(scan_of(points), pose[None], np.array([0.01]), place, WIDE)
    assert stated[0] == pytest.approx(
        np.cov(errors), abs=0.08 * stated[0].max()
    )  # 4,000 draws: 2 % of a variance
    residuals = drawn[:, owner].T - rows @ errors
    assert scatter[0] == pytest.approx((residuals**2).mean(), rel=0.08)


def test_slanting_wall_is_known_better_and_parts_of_one_line_move_together() -> None:
    walls = np.array([[[0, 0], [1, 0]], [[2, 0], [3, 0]], [[0, 1], [1, 1]], [[0, 2], [1, 2.2]]], dtype=float)
    place = of_grid(walls)
    assert place.lines[0] == place.lines[1] and len(set(place.lines.tolist())) == 3
    assert place.deviations == pytest.approx(CELL / np.sqrt(12) * np.array([1, 1, 1, 1 / 5]))


def test_scan_without_a_match_has_the_errors_of_the_next_one() -> None:
    points = np.column_stack([np.full(10, -2.0), np.linspace(-1, 1, 10)])
    two = ScanPoints(
        first=np.array([0, 10, 20]), points=np.tile(points, (2, 1)), normals=np.zeros((20, 2)), ranges=np.ones(20),
        starts=np.zeros((20, 2)), rays=np.arange(20),
    )  # fmt: skip
    poses, prior = np.tile([2.0, 2.0, 0.0], (2, 1)), np.full(3, 0.05)
    covariances, _ = displacement_errors(two, poses, np.array([np.nan, 0.01]), of_grid(SQUARE), prior)
    np.testing.assert_array_equal(covariances[0], covariances[1])
    assert covariances[0, 0, 0] > 0
    none, _ = displacement_errors(two, poses, np.full(2, np.nan), of_grid(SQUARE), prior)
    assert not none.any()
