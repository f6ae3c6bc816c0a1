"""What the scans that a log sets aside tell of a model of cells is recovered from planted errors."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from test_models_cells import BEARINGS, a_table, room, scans_of, some_poses

from sensorgraph.models.cells.distribution import NORMAL_TAILS, fit_tails
from sensorgraph.models.cells.evidence import CellEvidence
from sensorgraph.models.cells.grid import GridWindow
from sensorgraph.models.cells.learning import SetAside, is_set_aside, n_folds_of, training_samples
from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.cells.probability_calibration import KNOTS, calibrate_p_off, fit_spread
from sensorgraph.models.cells.ray_march import tabulate
from sensorgraph.models.cells.set_aside import shipped_visibility


def test_rays_that_leave_the_window_meet_cells_that_no_ray_crossed() -> None:
    """Set-aside scans are taken beyond the other ones: a window that covers their rays gives the same samples."""
    rng = np.random.default_rng(5)
    near, aside = (
        some_poses(rng, 20),
        np.array([[6.013, 2.027, 0.05], [2.017, 9.023, 1.51], [-5.011, -5.019, 0.71]]),
    )
    evidence = CellEvidence.of(near, np.minimum(room(near), 2.0), BEARINGS, cell=0.05, reach=3.0)
    around = GridWindow.around(np.vstack([near[:, :2], aside[:, :2]]), 3.0, 0.05)
    i, j = np.subtract(evidence.window.low, around.low)
    nx, ny = evidence.window.index.shape
    around.index[i : i + nx, j : j + ny] = evidence.window.index
    beta, spread = np.array(shipped_visibility()), (0.01, 0.0, 0.01)
    found = []
    for window in (evidence.window, around):
        kept = replace(evidence, window=window).widened()
        ranges = np.full((3, 91), np.inf)
        found.append(training_samples(kept, aside, ranges, BEARINGS, tabulate(kept, beta, spread)))
    for own, other in zip(*found, strict=True):
        assert len(own) > 10_000
        np.testing.assert_allclose(own, other, atol=1e-6)
    assert np.isfinite(found[0][0]).all()


def test_spread_about_faces_is_found() -> None:
    table = a_table()
    rng = np.random.default_rng(11)
    poses = some_poses(rng, 40)
    for planted in (0.015, 0.04):
        measured = room(poses) + rng.normal(0, planted, (40, 91))
        sigma, across, _ = fit_spread([SetAside(poses, measured, BEARINGS)], [table])
        assert sigma == pytest.approx(planted, rel=0.15)
        assert across < 0.5 * planted


def test_errors_of_poses_count_with_the_tangent_of_incidence() -> None:
    """Poses that are 2 cm off move a reading by 2 cm / cos(incidence): sigma² = across² = 2 cm²."""
    table = a_table()
    rng = np.random.default_rng(21)
    poses = some_poses(rng, 120)
    off = poses + rng.normal(size=poses.shape) * [0.02, 0.02, 0.0]
    sigma, across, _ = fit_spread([SetAside(off, room(poses), BEARINGS)], [table])
    assert sigma == pytest.approx(0.02, rel=0.2)
    assert across == pytest.approx(0.02, rel=0.3)


def heavy_tailed(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return errors [m]: 1 cm for 70 %, and 3 cm for the others."""
    return rng.normal(size=shape) * np.where(rng.random(shape) < 0.3, 0.03, 0.01)


def test_tails_of_errors_are_found_and_keep_the_variance() -> None:
    table = a_table()._replace(sigma=math.sqrt(0.7 * 0.01**2 + 0.3 * 0.03**2))
    rng = np.random.default_rng(22)
    poses = some_poses(rng, 80)
    far = room(poses)
    share, narrow, wide = fit_tails(
        [SetAside(poses, far + heavy_tailed(rng, far.shape), BEARINGS)], [table], KNOTS
    )
    assert share == pytest.approx(0.3, abs=0.08)  # EM comes slowly from 0.2
    assert wide / narrow == pytest.approx(3.0, rel=0.2)
    assert (1 - share) * narrow**2 + share * wide**2 == pytest.approx(1.0)
    normal = far + rng.normal(0, table.sigma, far.shape)
    share, narrow, wide = fit_tails([SetAside(poses, normal, BEARINGS)], [table], KNOTS)
    assert (
        3 * ((1 - share) * narrow**4 + share * wide**4) < 3.5
    )  # kurtosis; 3 is normal, 5.3 is planted above


@pytest.mark.slow
def test_intervals_and_draws_follow_heavy_tails_and_the_mode_does_not() -> None:
    """Normal errors of the same variance would put 61 % within the 50 % interval."""
    rng = np.random.default_rng(23)
    poses = some_poses(rng, 150)
    cells = CellModel.fit(scans_of(poses, room(poses) + heavy_tailed(rng, (150, 91))))
    normal = replace(cells, tails=NORMAL_TAILS)
    fresh = some_poses(rng, 60)
    measured = room(fresh) + heavy_tailed(rng, (60, 91))
    rays = np.arange(91)
    said, same = cells.predict(fresh, rays, "mode"), normal.predict(fresh, rays, "mode")
    np.testing.assert_array_equal(said.mode, same.mode)
    np.testing.assert_array_equal(said.p_off, same.p_off)
    drawn = cells.draw(fresh, rng.random(measured.shape), rng.normal(size=measured.shape))

    def within_half(model: CellModel, readings: np.ndarray) -> float:
        below = model.mixture(fresh, rays).cdf(readings)[said.answered]
        return float((np.abs(below - 0.5) < 0.25).mean())

    assert within_half(cells, measured) == pytest.approx(0.5, abs=0.04)
    assert within_half(normal, measured) > 0.55
    assert within_half(cells, drawn) == pytest.approx(0.5, abs=0.04)


def test_calibration_learns_a_planted_curve_and_keeps_what_is_said_without_data() -> None:
    rng = np.random.default_rng(12)
    said = rng.uniform(0, 1, (200, 300))
    summaries = np.zeros((3, 200, 300, 6))
    summaries[..., 5] = said
    off = rng.uniform(size=said.shape) < said**2
    ranges = np.where(off, 1.0, 0.0)
    found = calibrate_p_off(summaries, ranges, np.ones(said.shape, dtype=bool))
    np.testing.assert_allclose(found[0], KNOTS**2, atol=0.03)
    empty = calibrate_p_off(summaries, ranges, np.zeros(said.shape, dtype=bool))
    np.testing.assert_allclose(empty, np.tile(KNOTS, (3, 1)))


def test_set_aside_is_a_fifth_in_ten_stretches() -> None:
    aside = is_set_aside(1000)
    assert aside.sum() == 200 and (np.diff(aside.astype(int)) == 1).sum() == 10
    assert not (aside & is_set_aside(1000, fold=1)).any()


@pytest.mark.parametrize("n", [5, 12, 33, 60, 240, 1000])
def test_short_logs_set_aside_each_key_frame_at_most_once(n: int) -> None:
    masks = [is_set_aside(n, fold) for fold in range(n_folds_of(n))]
    count = np.sum(masks, axis=0)
    assert count.max() == 1 and all(mask.any() for mask in masks)
    assert count.sum() >= min(n, 50)
