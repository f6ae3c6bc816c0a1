"""A robot that brakes during a slow sweep: scans alone do not show when, and the stated deviations say so."""

from __future__ import annotations

import numpy as np
import pytest

from sensorgraph.localization.dead_reckoning import with_sweep_motion
from tests.localization_samples import Floats

T = 1.0


def turning(n: int, stop: int) -> Floats:
    """Return poses (n, 3), a second apart, of a robot that turns by 0.4 rad/s and drives 0.2 m/s until scan `stop`."""
    k = np.minimum(np.arange(n), stop)
    phi = 0.4 * k
    return np.column_stack([0.5 * np.sin(phi), 0.5 * (1 - np.cos(phi)), phi])


def test_a_change_of_speed_within_a_sweep_is_uncertain_by_half_of_it() -> None:
    poses = turning(30, 15)
    none = np.zeros((30, 3, 3))
    sigma = np.sqrt(np.einsum("nii->ni", with_sweep_motion(none, np.arange(30.0), poses, T)))
    assert sigma[15, 2] == pytest.approx(0.4 * T / 2)
    # before, the robot turns evenly; afterwards it stands
    assert np.delete(sigma, 15, axis=0)[1:-1, 2].max() < 1e-9
    speed = 2 * 0.5 * np.sin(0.2)  # the chord of a second
    assert np.hypot(*sigma[15, :2]) == pytest.approx(speed * T / 2, rel=0.01)


def test_a_scan_at_one_instant_is_as_certain_as_before() -> None:
    before = np.broadcast_to(np.eye(3) * 1e-4, (30, 3, 3))
    assert (with_sweep_motion(before, np.arange(30.0), turning(30, 15), 0.0) == before).all()


def test_repeated_stamps_and_short_runs_are_finite() -> None:
    stamps = np.repeat(np.arange(15.0), 2)
    assert np.isfinite(with_sweep_motion(np.zeros((30, 3, 3)), stamps, turning(30, 15), T)).all()
    assert (with_sweep_motion(np.zeros((2, 3, 3)), np.arange(2.0), turning(2, 1), T) == 0).all()
