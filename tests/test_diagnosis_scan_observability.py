"""Laws of what a run could not have shown: what it did not do, it cannot tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planners.types import Floats
from sensorgraph.diagnosis.scan.fit import Fitted, fit, start_state
from sensorgraph.diagnosis.scan.intake import velocities
from sensorgraph.diagnosis.scan.observability import RunExposure, not_observable
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.effects import EFFECTS
from sensorgraph.world.robot import default_robot
from sensorgraph.world.scene import draw_readings
from tests.effects_samples import arena

STAMPS = np.arange(0.0, 60.0, 0.2)


def scan_data(poses: Floats, *, laser_frame: bool = False, stamps: Floats = STAMPS) -> ScanData:
    """Scan along poses (n, 3) at the stamps, with the noise of the default robot and nothing else."""
    robot = default_robot()
    sensor = replace(robot.sensor, bearings=robot.sensor.bearings[::3])
    track = np.arange(0.0, stamps[-1] + 0.05, 0.05)
    along = np.stack([np.interp(track, stamps, column) for column in poses.T], axis=1)
    found = ScanData(
        arena=arena(),
        sensor=sensor,
        tolerances=robot.tolerances,
        stamps=stamps,
        ranges=np.zeros((len(stamps), sensor.n_rays)),
        poses=poses,
        twists=velocities(track, along, stamps),
        track=(track, along),
        begin=0.0,
        span=float(stamps[-1]),
        laser_frame=laser_frame,
    )
    scene = found.scene()
    scene.run()
    return replace(found, ranges=draw_readings(scene, np.random.default_rng(0)), memo={})


def null(found: ScanData) -> Fitted:
    return fit(found, (), start_state(found, NoiseBounds()), NoiseBounds())


def standing(stamps: Floats = STAMPS) -> Floats:
    return np.tile([2.0, 2.5, 0.3], (len(stamps), 1))


def lively(stamps: Floats = STAMPS) -> Floats:
    """Drive figures at changing speeds, turning both ways."""
    t = stamps
    x, y = 2.2 + 1.6 * np.sin(0.23 * t), 2.2 + 1.7 * np.sin(0.31 * t + 0.5)
    return np.stack([x, y, 3.0 * np.sin(0.33 * t) + 0.12 * t], axis=1)


def straight(stamps: Floats = STAMPS) -> Floats:
    """Drive at one speed, and never turn."""
    return np.stack([1.0 + 2.5 * stamps / stamps[-1] * 1.0, np.full_like(stamps, 1.2), 0.0 * stamps], axis=1)


def test_standing_still_shows_no_latency_and_no_skew() -> None:
    found = scan_data(standing())
    hidden = not_observable(RunExposure(found, null(found)))
    assert {"latency", "scan_skew"} <= hidden.keys()
    assert "0.00 m/s" in hidden["latency"]


def test_a_lively_run_shows_what_moves_readings() -> None:
    found = scan_data(lively())
    hidden = not_observable(RunExposure(found, null(found)))
    assert not hidden.keys() & {
        "range_bias", "range_scale", "range_drift", "mount_yaw", "mount_xy", "latency", "scan_skew",
        "sector_bias", "range_noise", "people", "random_outliers", "quantisation", "moved_obstacle",
    }  # fmt: skip


def test_poses_of_the_laser_itself_hide_the_mount_and_the_clock() -> None:
    found = scan_data(lively(), laser_frame=True)
    hidden = not_observable(RunExposure(found, null(found)))
    assert {"mount_xy", "mount_yaw", "latency"} <= hidden.keys()
    own = scan_data(lively())
    assert not {"mount_xy", "mount_yaw", "latency"} & not_observable(RunExposure(own, null(own))).keys()


def test_poses_located_in_the_map_have_taken_along_what_moves_a_scan_as_a_whole_alone() -> None:
    """A drift moves walls on all sides towards the robot, which no pose can."""
    found = replace(scan_data(lively()), from_scans=True, memo={})
    hidden = not_observable(RunExposure(found, null(found)))
    assert {"mount_xy", "mount_yaw", "latency"} <= hidden.keys()
    assert not hidden.keys() & {"range_bias", "range_drift", "range_scale"}


def test_no_wall_near_or_far_leaves_the_limits_of_range_in_the_dark() -> None:
    found = scan_data(standing())
    hidden = not_observable(RunExposure(found, null(found)))
    assert "no return from nearer than" in hidden["min_range"]
    assert "of 8 m" in hidden["max_range"]


def test_a_coarse_log_hides_quantisation() -> None:
    found = scan_data(lively())
    found = replace(found, sensor=replace(found.sensor, resolution=0.01), memo={})
    assert "10 mm" in not_observable(RunExposure(found, null(found)))["quantisation"]


def test_what_was_never_looked_at_is_named() -> None:
    found = scan_data(np.tile([4.3, 2.4, -np.pi / 2], (len(STAMPS), 1)))
    hidden = not_observable(RunExposure(found, null(found)))
    assert "box" in hidden["missing_obstacle"]
    assert "box/edge_0" in hidden["glass"]
    assert "free space" in hidden["unmapped_obstacle"]


def test_effects_of_the_model_are_not_said_to_be_hidden() -> None:
    found = scan_data(standing())
    state = start_state(found, NoiseBounds())
    fitted = fit(found, (EFFECTS["latency"](tau=0.0),), state, NoiseBounds())
    assert "latency" not in not_observable(RunExposure(found, fitted))


@pytest.mark.parametrize("poses", [standing(), lively()], ids=["standing", "lively"])
def test_only_effects_of_the_scan_channel_are_spoken_of(poses: Floats) -> None:
    found = scan_data(poses)
    for name, why in not_observable(RunExposure(found, null(found))).items():
        assert EFFECTS[name].channel == "scan"
        assert why and not why.endswith(".")
