"""The mark that an effect leaves in a run, by the generator's own truth; an effect without one is drawn again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from benchmarks.hidden_effects.library import CHANNEL
from benchmarks.hidden_effects.log import Floats, Odometry
from benchmarks.hidden_effects.worlds.blind.base import OMEGA, PHI, SPEED_LEFT, SPEED_RIGHT, V, X, Y
from benchmarks.hidden_effects.worlds.blind.drive import Driven
from benchmarks.hidden_effects.worlds.blind.effects import CHANNELS, NOTES
from benchmarks.hidden_effects.worlds.blind.logged import Reference
from benchmarks.hidden_effects.worlds.blind.robots import Robot
from benchmarks.hidden_effects.worlds.blind.scans import Scans

WINDOWS = (0.5, 5.0)
"""[s] over which odometry is compared with the truth."""
LEAST_SHARE: Mapping[str, float] = {
    "glass": 0.01,
    "mirror": 0.01,
    "black_surface": 0.01,
    "missing_obstacle": 0.02,
    "unmapped_obstacle": 0.003,
    "moved_obstacle": 0.003,
    "people": 0.003,
    "mixed_pixels": 0.003,
    "tilt": 0.03,
}
"""Least share of changed rays of effects that are judged by it alone."""
LEAST_RMS: Mapping[str, float] = {"moved_wall": 0.25, "latency": 0.3, "scan_skew": 0.3, "mount_yaw": 0.3}
"""Least change over sigma (r.m.s.) of effects that are judged by it alone."""


@dataclass(frozen=True, kw_only=True)
class Mark:
    """What an effect changes."""

    changed_share: float
    """Of all rays, by more than three sigma or from or to a missing return."""
    rms_over_sigma: float
    """R.m.s. change over the noise, a ray counted as ten sigma at most; of the poses for pose kinds."""
    growth: float
    """Odometry and drive: what is left of a model without the effect, over what is left without it."""
    is_seen: bool


def scan_mark(name: str, robot: Robot, scans: Scans, plain: Scans) -> Mark:
    """Compare scans with those of the same drive and noise without the effect."""
    both = np.isfinite(scans.ranges) & np.isfinite(plain.ranges)
    relative = (np.where(both, scans.ranges, 0) - np.where(both, plain.ranges, 0)) / robot.sigma
    changed = (both & (np.abs(relative) > 3)) | (np.isfinite(scans.ranges) != np.isfinite(plain.ranges))
    share = float(round(changed.mean(), 5))
    rms = float(round(np.sqrt(np.mean(np.clip(relative[both], -10, 10) ** 2)), 4))
    if name in LEAST_SHARE:
        is_seen = share > LEAST_SHARE[name]
    elif name in LEAST_RMS:
        is_seen = rms > LEAST_RMS[name]
    elif name in NOTES:
        is_seen = rms > 0.8 or share > 0.01
    else:
        is_seen = rms > 0.3 or share > 0.003
    return Mark(changed_share=share, rms_over_sigma=rms, growth=1.0, is_seen=is_seen)


def pose_mark(robot: Robot, reference: Reference) -> Mark:
    """Compare what is hidden in the poses with their noise."""
    rms = max(reference.off_xy / robot.sigma_xy, reference.off_yaw / robot.sigma_yaw)
    return Mark(changed_share=0.0, rms_over_sigma=rms, growth=1.0, is_seen=rms > 3)


def odometry_mark(driven: Driven, odometry: Odometry, plain: Driven, plain_odometry: Odometry) -> Mark:
    """Compare the odometry's error with that of the drive without the effect."""
    return _grown(_odometry_errors(driven, odometry), _odometry_errors(plain, plain_odometry), least=1.25)


def drive_mark(robot: Robot, driven: Driven, plain: Driven, delay: float) -> Mark:
    """Compare what the motors of robot.yaml, with its delay [s], leave of the true speed."""
    return _grown(_drive_errors(robot, driven, delay), _drive_errors(robot, plain, delay), least=1.5)


def channel_of(name: str) -> str:
    """Return where an effect shows: scan, odometry, drive or pose."""
    return CHANNELS.get(name) or CHANNEL.get(name, "scan")


def _grown(errors: Floats, plain: Floats, least: float) -> Mark:
    growth = float(np.max(errors / np.maximum(plain, 1.0)))
    return Mark(changed_share=0.0, rms_over_sigma=growth, growth=growth, is_seen=growth > least)


def _moves(stamps: Floats, poses: Floats, window: float) -> Floats:
    """Return motions (3, n) [m, m, rad] over windows [s], in the frame of their start."""
    first = np.arange(stamps[0], stamps[-1] - window, window / 2)
    x0, y0, phi0 = (np.interp(first, stamps, poses[:, k]) for k in range(3))
    x1, y1, phi1 = (np.interp(first + window, stamps, poses[:, k]) for k in range(3))
    c, s, dx, dy = np.cos(phi0), np.sin(phi0), x1 - x0, y1 - y0
    return np.stack([c * dx + s * dy, -s * dx + c * dy, phi1 - phi0])


def _odometry_errors(driven: Driven, odometry: Odometry) -> Floats:
    """Return r.m.s. errors of way [mm] and turn [mrad] for each window."""
    true = np.column_stack([driven.at(odometry.stamps, column) for column in (X, Y, PHI)])
    out = []
    for window in WINDOWS:
        error = _moves(odometry.stamps, odometry.poses, window) - _moves(odometry.stamps, true, window)
        out += [np.sqrt(np.mean(error[0] ** 2 + error[1] ** 2)), np.sqrt(np.mean(error[2] ** 2))]
    return 1e3 * np.array(out)


def _drive_errors(robot: Robot, driven: Driven, delay: float) -> Floats:
    """Return r.m.s. errors of v [mm/s] and omega [mrad/s] of the wheels."""
    stamps, log = driven.stamps[::5], driven.log[::5]
    k = np.searchsorted(driven.command_stamps + delay, stamps + 1e-9, "right") - 1
    asked = np.where(k[:, None] >= 0, driven.commands[np.maximum(k, 0)], 0)
    a = 1 - np.exp(-0.005 / robot.tau)
    model = lfilter([a], [1, a - 1], asked, axis=0)
    right, left = log[:, SPEED_RIGHT], log[:, SPEED_LEFT]
    wheels = np.column_stack([0.5 * (right + left), (right - left) / robot.wheel_base])
    return np.asarray(1e3 * np.sqrt(np.mean((model - wheels) ** 2, axis=0)))


def travelled(driven: Driven) -> tuple[float, float, float, float]:
    """Return way [m], turns to the left and to the right [rad], and the share of the time turned in place."""
    v, omega, step = driven.log[:, V], driven.log[:, OMEGA], driven.stamps[0]
    in_place = float(((np.abs(v) < 0.02) & (np.abs(omega) > 0.2)).mean())
    left, right = np.clip(omega, 0, None).sum() * step, -np.clip(omega, None, 0).sum() * step
    return float(np.abs(v).sum() * step), float(left), float(right), in_place
