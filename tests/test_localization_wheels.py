"""Wheel parameters of a map: their prior, and how well they are known."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import further
from localization_samples import loop_poses, room_run

from logs.transforms import compose
from sensorgraph.localization.front_end import track_part
from sensorgraph.localization.mapping import map_run
from sensorgraph.localization.odometry import odometry_at_scans, odometry_of
from sensorgraph.localization.settings import WHEELS
from sensorgraph.localization.wheel_edges import WheelSteps
from sensorgraph.localization.wheels import corrected_steps


@pytest.mark.parametrize("seed", [0, *further(2, 3)])
def test_wheels_measured_by_few_returns_are_as_uncertain_as_the_poses(seed: int) -> None:
    """With 24 returns of 1 cm, the scatter between stretches of the log states a seventh of the error."""
    wheels = map_run(room_run(loop_poses(160, laps=2), n_rays=24, seed=seed)).wheels
    assert wheels is not None
    assert abs(wheels.way_scale - 1.0) < 3 * wheels.way_scale_sd
    assert wheels.way_scale_sd < 0.01


def test_prior_pulls_wheel_parameters_back_to_wheels_without_error() -> None:
    """Poses that only follow the wheels measure nothing; without this gradient the parameters would walk away."""
    run = room_run(loop_poses(40, laps=1))
    motion = odometry_of(run)
    assert motion is not None
    _, tracked = track_part(run, slice(None), motion)
    odometry = odometry_at_scans(run, motion)
    steps = WheelSteps.of(odometry, tracked, run.stamps)
    moved = np.zeros((len(tracked.key_frames), 3))
    for k, step in enumerate(corrected_steps(steps.steps, 1.05, 1.0, 0.03)):
        moved[k + 1] = compose(moved[k], step)
    found = steps.parameters(moved)
    assert found is not None
    off = np.array([found.way_scale - 1.0, found.turn_scale - 1.0, found.heading_bias])
    sd = np.array([WHEELS.way_scale_sd, WHEELS.turn_scale_sd, WHEELS.heading_bias_sd])
    assert off[0] == pytest.approx(0.05, abs=0.005)
    np.testing.assert_allclose(steps.at(moved).pull, off / sd**2)
