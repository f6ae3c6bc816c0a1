"""Joint refinement of a map: steps too large to be linear, and the wheel parameters with their prior."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from conftest import further
from localization_samples import any_times, loop_poses, room_run, timed

from logs.run import Run
from logs.transforms import compose
from sensorgraph.localization import refinement
from sensorgraph.localization.front_end import track_part
from sensorgraph.localization.mapping import map_run
from sensorgraph.localization.odometry import odometry_at_scans, odometry_of
from sensorgraph.localization.refinement import ReducedSystem, conjugate_gradients
from sensorgraph.localization.settings import WHEELS
from sensorgraph.localization.wheel_edges import WheelSteps
from sensorgraph.localization.wheels import corrected_steps


@any_times
@pytest.mark.parametrize("seed", [0, *further(2, 3)])
def test_wheels_measured_by_few_returns_are_as_uncertain_as_the_poses(
    seed: int, times: Callable[[Run], Run]
) -> None:
    """With 24 returns of 1 cm, the scatter between stretches of the log states a seventh of the error."""
    wheels = map_run(times(room_run(loop_poses(160, laps=2), n_rays=24, seed=seed))).wheels
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
    sd = np.array([WHEELS.scale_sd, WHEELS.scale_sd, WHEELS.heading_bias_sd])
    assert off[0] == pytest.approx(0.05, abs=0.005)
    np.testing.assert_allclose(steps.at(moved).pull, off / sd**2)


def test_last_step_beyond_what_is_linear_is_shortened_and_is_part_of_the_errors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Scans that hardly determine a heading gave a step of 1123 m and 502 rad; others had not converged, and were stated as sure."""
    run = timed(room_run(loop_poses(80, laps=1)))
    calls: list[int] = []

    def solve(system: ReducedSystem, rhs: np.ndarray, *args: Any) -> np.ndarray:
        calls.append(len(rhs))
        if len(calls) != bad:
            return conjugate_gradients(system, rhs, *args)
        step = np.random.default_rng(0).normal(size=(len(rhs) // 3, 3)) * [500.0, 500.0, 300.0]
        return step.reshape(-1, 1)

    monkeypatch.setattr(refinement, "conjugate_gradients", solve)
    bad = 0
    usual = map_run(run)
    bad, calls[:] = len(calls), []
    odd = map_run(run)
    assert len(calls) == bad > 0
    np.testing.assert_allclose(odd.poses, usual.poses, atol=0.6)
    stated, before = (np.sqrt(np.einsum("nii->ni", found.covariances)) for found in (odd, usual))
    assert np.median(stated[:, 2]) > 10 * np.median(before[:, 2])
    assert (np.abs(odd.poses - usual.poses) < 3 * stated + 0.05).mean() > 0.9
