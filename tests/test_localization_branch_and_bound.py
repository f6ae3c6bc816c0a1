"""Branch and bound against plain exhaustive search, and what a likelihood field promises."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sensorgraph.localization.branch_and_bound import MaxPyramid, Modes, SearchWindow
from sensorgraph.localization.likelihood_field import LikelihoodField, field_of_points, points_on

Floats = NDArray[np.float64]


def walls(*corners: tuple[float, float]) -> Floats:
    ring = np.array(corners, dtype=float)
    return np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)


L_ROOM = walls((0, 0), (6, 0), (6, 2.5), (3, 2.5), (3, 5), (0, 5))
"""Fits itself in one way only."""


def field_of_segments(segments: Floats, *, resolution: float = 0.05, sigma: float = 0.07) -> LikelihoodField:
    """Return the field of straight surfaces (n, 2, 2) [m, map]."""
    return field_of_points(points_on(segments, 0.5 * resolution), resolution=resolution, sigma=sigma)


def seen_from(points: Floats, pose: tuple[float, float, float]) -> Floats:
    """Return map points as seen from a pose."""
    x, y, phi = pose
    turned = np.array([[np.cos(phi), -np.sin(phi)], [np.sin(phi), np.cos(phi)]])
    return (points - [x, y]) @ turned


def exhaustive(field: LikelihoodField, points: Floats, window: SearchWindow, step: float) -> Floats:
    """Score every offset and heading of a window, one by one; (n_headings, ny, nx)."""
    n_turns = int(window.half_phi / step + 1e-9)
    nx, ny = (int(half / field.resolution + 1e-9) for half in (window.half_x, window.half_y))
    scores = np.zeros((2 * n_turns + 1, 2 * ny + 1, 2 * nx + 1))
    for a in range(-n_turns, n_turns + 1):
        phi = window.phi + a * step
        turned = points @ np.array([[np.cos(phi), np.sin(phi)], [-np.sin(phi), np.cos(phi)]])
        for j in range(-ny, ny + 1):
            for i in range(-nx, nx + 1):
                at = [window.x + i * field.resolution, window.y + j * field.resolution]
                scores[a + n_turns, j + ny, i + nx] = field.at(turned + at).mean()
    return scores


@pytest.mark.parametrize("seed", range(4))
def test_best_place_is_that_of_exhaustive_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    field = field_of_segments(L_ROOM, resolution=0.1, sigma=0.1)
    truth = (rng.uniform(0.5, 2.5), rng.uniform(0.5, 4.5), rng.uniform(-2, 2))
    points = seen_from(points_on(L_ROOM, 0.4) + rng.normal(0, 0.05, (1, 2)), truth)
    window = SearchWindow(
        x=truth[0] + rng.uniform(-0.4, 0.4),
        y=truth[1] + rng.uniform(-0.4, 0.4),
        phi=truth[2] + 0.1,
        half_x=0.7,
        half_y=0.5,
        half_phi=0.3,
    )
    step = 0.05
    scores = exhaustive(field, points, window, step)
    found = MaxPyramid(field=field).search(points, window, heading_step=step, min_score=0.01, max_modes=1)
    assert found.scores[0] == pytest.approx(scores.max(), abs=1e-12)
    x, y, phi = found.poses[0]
    a, j, i = (round(v) for v in ((phi - window.phi) / step, (y - window.y) / 0.1, (x - window.x) / 0.1))
    assert scores[a + 6, j + 5, i + 7] == pytest.approx(scores.max(), abs=1e-12)


def test_all_modes_are_those_of_exhaustive_search_with_the_boxes_taken_out() -> None:
    rng = np.random.default_rng(3)
    field = field_of_points(rng.uniform(0, 3, (40, 2)), resolution=0.1, sigma=0.1)
    points = rng.uniform(-1, 1, (12, 2))
    window = SearchWindow(x=1.5, y=1.5, half_x=0.8, half_y=0.8, half_phi=0.4)
    found = MaxPyramid(field=field).search(
        points, window, heading_step=0.1, min_score=0.01, max_modes=5, rival_ratio=0.0, apart=(0.3, 0.1)
    )
    scores = exhaustive(field, points, window, 0.1)
    for pose, score in zip(found.poses, found.scores, strict=True):
        assert score == pytest.approx(scores.max(), abs=1e-12)
        a, j, i = (
            round(v) for v in ((pose[2] / 0.1) + 4, (pose[1] - 1.5) / 0.1 + 8, (pose[0] - 1.5) / 0.1 + 8)
        )
        assert scores[a, j, i] == pytest.approx(score, abs=1e-12)
        scores[max(a - 1, 0) : a + 2, max(j - 3, 0) : j + 4, max(i - 3, 0) : i + 4] = -1
    assert len(found.scores) == 5


@pytest.mark.parametrize("half", [0.0, 0.04, 0.4, 0.43])
def test_no_place_outside_the_window_is_returned(half: float) -> None:
    """The best fit lies 2 m away; leaves of a coarse block would reach it."""
    field = field_of_segments(L_ROOM)
    points = seen_from(points_on(L_ROOM, 0.2), (1.5, 1.5, 0.0))
    window = SearchWindow(x=3.5, y=1.5, half_x=half, half_y=half, half_phi=np.radians(2.0))
    found = MaxPyramid(field=field).search(points, window, min_score=0.0, max_modes=3, rival_ratio=0.0)
    assert len(found.scores)
    assert (np.abs(found.poses[:, :2] - [3.5, 1.5]) <= half + 1e-9).all()
    assert (np.abs(found.poses[:, 2]) <= np.radians(2.0) + 1e-9).all()


@pytest.mark.parametrize("truth", [(1.0, 1.0, 0.3), (4.5, 1.2, -2.9), (0.6, 4.1, np.pi)])
def test_pose_in_a_room_is_found_without_a_guess_and_has_no_rival(truth: tuple[float, float, float]) -> None:
    points = seen_from(points_on(L_ROOM, 0.1), truth)
    window = SearchWindow(x=3, y=2.5, half_x=4, half_y=4)
    found = MaxPyramid(field=field_of_segments(L_ROOM)).search(points, window)
    assert len(found.scores) == 1
    np.testing.assert_allclose(found.poses[0, :2], truth[:2], atol=0.06)  # a cell
    assert np.cos(found.poses[0, 2] - truth[2]) > np.cos(np.radians(0.6))  # a step of the headings


def test_square_room_has_four_equal_headings() -> None:
    square = walls((0, 0), (4, 0), (4, 4), (0, 4))
    points = seen_from(points_on(square, 0.1), (2.0, 2.0, 0.0))
    found = MaxPyramid(field=field_of_segments(square)).search(
        points, SearchWindow(x=2, y=2, half_x=3, half_y=3), heading_step=np.radians(1.0)
    )
    quarters = np.sort(np.round(found.poses[:, 2] / (np.pi / 2)) % 4)
    np.testing.assert_array_equal(quarters, [0, 1, 2, 3])
    assert found.rivalry > 0.97


def test_corridor_has_rivals_along_itself() -> None:
    corridor = np.array([[[0.0, 0.0], [20.0, 0.0]], [[0.0, 2.0], [20.0, 2.0]]])
    points = seen_from(points_on(corridor[:, :] * [0.2, 1] + [8.0, 0.0], 0.1), (10.0, 1.0, 0.0))
    window = SearchWindow(x=10, y=1, half_x=3, half_y=0.5, half_phi=0.1)
    found = MaxPyramid(field=field_of_segments(corridor)).search(points, window)
    assert found.rivalry > 0.99
    assert np.ptp(found.poses[:, 0]) > 3.5
    np.testing.assert_allclose(found.poses[:, 1], 1.0, atol=0.06)


def test_scan_that_fits_nowhere_gives_no_mode() -> None:
    far = np.array([[30.0, 30.0]])
    found = MaxPyramid(field=field_of_segments(L_ROOM)).search(far, SearchWindow(half_x=1, half_y=1))
    assert found.scores.shape == (0,) and found.poses.shape == (0, 3)
    assert found.rivalry == 0


def test_queue_grows_beyond_its_first_room() -> None:
    rng = np.random.default_rng(0)
    field = field_of_points(rng.uniform(0, 8, (300, 2)), resolution=0.1, sigma=0.1)
    points = rng.uniform(-3, 3, (30, 2))
    window = SearchWindow(x=4, y=4, half_x=4, half_y=4)
    found: Modes = MaxPyramid(field=field).search(
        points, window, min_score=0.0, heading_step=0.02, rival_ratio=0
    )
    assert len(found.scores) == 8
    assert (np.diff(found.scores) <= 0).all()


def test_field_falls_off_with_the_distance_to_the_nearest_surface() -> None:
    field = field_of_segments(np.array([[[0.0, 0.0], [2.0, 0.0]], [[0.0, 1.0], [2.0, 1.0]]]))
    y = np.array([-0.51, -0.11, 0.01, 0.04, 0.12, 0.52, 0.93, 1.01])  # none on the border of a cell
    centres = np.floor(y / 0.05) * 0.05 + 0.025
    distance = np.minimum(np.abs(centres), np.abs(centres - 1))
    expected = np.where(distance < 0.21, np.exp(-(distance**2) / (2 * 0.07**2)), 0)
    at = field.at(np.column_stack([np.full_like(y, 1.0), y]))
    np.testing.assert_allclose(at, expected, atol=0.01)  # in steps of 1/255, points half a cell apart
    assert field.at(np.array([100.0, -100.0])) == 0


def test_field_of_surfaces_far_apart_has_larger_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sensorgraph.localization.likelihood_field.MAX_CELLS", 1 << 14)
    field = field_of_points(np.array([[0.0, 0.0], [40.0, 30.0]]))
    assert field.values.size <= 1 << 14
    assert (field.at(np.array([[0.01, 0.01], [40.0, 30.0]])) > 0).all()


@pytest.mark.parametrize("bad", [np.zeros((0, 2)), np.zeros((3, 3)), np.array([[0.0, np.nan]])])
def test_field_and_search_refuse_what_is_no_point(bad: Floats) -> None:
    with pytest.raises(ValueError, match="points has shape"):
        field_of_points(bad)
    with pytest.raises(ValueError, match="points has shape"):
        MaxPyramid(field=field_of_segments(L_ROOM)).search(bad[:0], SearchWindow(half_x=1, half_y=1))
