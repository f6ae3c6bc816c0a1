"""Errors that residuals share: planted, and recovered."""

from __future__ import annotations

import numpy as np
import pytest

from sensorgraph.localization.covariances import long_run_variance, without_rigid_motion
from sensorgraph.localization.point_rows import MeanResiduals
from sensorgraph.localization.surface_errors import SurfaceErrors, surface_errors

RNG = np.random.default_rng(0)


def autoregression(rho: float, n: int) -> np.ndarray:
    out = RNG.normal(size=(n, 3))
    for k in range(1, n):
        out[k] += rho * out[k - 1]
    return out


def test_long_run_variance_is_that_of_a_sum() -> None:
    assert long_run_variance(RNG.normal(size=(4000, 3))) == pytest.approx(np.ones(3), abs=0.25)
    rho = 0.5
    expected = (1 + rho) / (1 - rho)
    assert long_run_variance(autoregression(rho, 4000)) == pytest.approx(np.full(3, expected), rel=0.25)
    assert (long_run_variance(autoregression(-0.5, 4000)) == 1.0).all()
    assert (long_run_variance(np.zeros((0, 3))) == 1.0).all()


def residuals(errors: SurfaceErrors | None, n_frames: int = 60, n_patches: int = 80) -> MeanResiduals:
    """Return residuals of frames on patches of a wall, 0.25 m apart, with white noise and perhaps shared errors."""
    frame, patch = (one.ravel() for one in np.indices((n_frames, n_patches)))
    middle = np.column_stack([0.25 * patch, np.zeros(len(patch))])
    count = np.full(len(frame), 4)
    residual = RNG.normal(size=len(frame)) / np.sqrt(count)
    if errors is not None:
        residual = residual + errors.draw(middle, frame, RNG, 1)[:, 0]
    facing = np.tile([0.0, 1.0], (len(frame), 1))
    return MeanResiduals(
        frame=frame, patch=patch, count=count, middle=middle, facing=facing, residual=residual
    )


def test_planted_surface_errors_are_recovered() -> None:
    planted = SurfaceErrors(length=2.0, frames=8.0, ratio=0.5, white=0.0)
    found = surface_errors(residuals(planted), lambda errors: errors, RNG)
    assert found.ratio == pytest.approx(planted.ratio, rel=0.3)
    assert found.length in (1.0, 2.0, 4.0) and found.frames in (4.0, 8.0, 16.0)


def test_white_noise_has_no_shared_errors() -> None:
    assert surface_errors(residuals(None), lambda errors: errors, RNG).ratio < 0.02
    few = residuals(None, 1, 5)
    assert surface_errors(few, lambda errors: errors, RNG).ratio == 0.0


def test_rigid_motion_of_all_poses_is_no_deviation() -> None:
    poses = np.column_stack([RNG.normal(size=(30, 2)), np.zeros(30)])
    turned = np.column_stack([-poses[:, 1], poses[:, 0], np.ones(30)]) * 0.01 + [0.3, -0.2, 0.0]
    assert np.abs(without_rigid_motion(turned[:, :, None], poses)).max() < 1e-9
    single = without_rigid_motion(np.ones((1, 3, 1)), poses[:1])
    assert np.abs(single).max() < 1e-9
