"""Settings of calibration, with unit and meaning; the modules hold the constants of the algorithms.

The modules use the instance `CALIBRATION`. The values were set on random offices, by the distance of the faces to the
true readings of the laser. Perfect lasers must remain as specified. Both results are printed by

    python -m benchmarks.uncalibrated_laser
    python -m benchmarks.office_graph
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class CalibrationSettings:
    """Evidence that a calibration needs, and limits of plausible results."""

    min_gain: float = 20.0
    """[nats] Minimum gain of a calibration after complexity penalties."""
    min_gain_per_reading: float = 0.01
    """[nats] Minimum gain of ray terms per reading: a bias of 1/7 of the noise (rms), more than clutter imitates."""
    max_ray_bias: float = 0.3
    """[m] Largest bias of a ray: limit of the search for its face, and of a plausible constant."""
    max_slope: float = 0.1
    """[m/m] Largest plausible slope of a ray."""
    max_mount_offset: float = 0.5
    """[m] Largest plausible offset of the mount."""
    max_mount_turn: float = 0.35
    """[rad] Largest plausible yaw offset of the mount."""
    max_pose_noise: tuple[float, float] = (0.10, 0.10)
    """[m, rad] Pose noise above which the log is inconsistent (mirrored scan, other units) and is not refined."""
    sweep_rate: float = 15.0
    """[1/s] Corrections per second of a sweep; the error of a reference changes from one of its poses to the next."""


CALIBRATION = CalibrationSettings()
"""The settings that the modules use."""
