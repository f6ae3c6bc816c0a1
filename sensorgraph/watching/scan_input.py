"""Scans as the tracker takes them: returns in base_link, deskewed, and joined views of several scans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from logs.motion import Motion
from logs.resampling import resample
from logs.run import RangeSensor, Run
from logs.transforms import compose, invert, wrap
from sensorgraph.localization.global_search import LocalView, local_view
from sensorgraph.localization.scans import ScanPoints, scan_points
from sensorgraph.types import Floats, Ints
from sensorgraph.watching.observation import Observation
from sensorgraph.watching.settings import TrackingPriors


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanInput:
    """One scan that is used for an update."""

    observation: Observation
    scan: ScanPoints
    drift: Floats
    """(3,) base_link in the frame of the dead reckoning."""
    weight: float
    """Share of new evidence, 0 to 1: scans from one place see the same surfaces."""
    changed: float = 0.0
    """Share of readings that differ from the last scan that was used."""
    fits: bool = True
    """Whether its readings have about the usual evidence at the most probable mode."""


def points_of(sensor: RangeSensor, observation: Observation, velocity: Floats) -> ScanPoints:
    """Return the returns of a scan in base_link at its stamp, deskewed for a velocity (3,) [m/s, m/s, rad/s]."""
    run = Run(sensor=sensor, stamps=np.zeros(1), ranges=observation.ranges[None])
    motion = None
    if sensor.has_ray_delays and velocity.any():
        times = np.array([-1.0, 0.0, 1.0])
        poses = times[:, None] * velocity  # straight in the short time of a sweep
        motion = Motion(stamps=times, poses=poses)
    return scan_points(run, motion)


def at_stamp(sensor: RangeSensor, observation: Observation, velocity: Floats) -> Observation:
    """Return a scan with the ranges that its rays would have at its stamp, for a velocity (3,) [m/s, m/s, rad/s].

    The ends of the rays are seen from the laser at the stamp and resampled to its bearings. A missing return only turns.
    """
    if not sensor.has_ray_delays or sensor.is_composite or not velocity.any():
        return observation
    lasers = compose(sensor.ray_delays[:, None] * velocity, sensor.mount)
    moved = compose(invert(sensor.mount), lasers)
    bearings, ranges = sensor.bearings + moved[:, 2], np.array(observation.ranges)
    is_end = np.isfinite(ranges)
    x = moved[is_end, 0] + ranges[is_end] * np.cos(bearings[is_end])
    y = moved[is_end, 1] + ranges[is_end] * np.sin(bearings[is_end])
    ranges[is_end] = np.hypot(x, y)
    bearings[is_end] += wrap(np.arctan2(y, x) - bearings[is_end])
    bearings, first = np.unique(bearings, return_index=True)
    return replace(observation, ranges=resample(ranges[None, first], bearings, sensor.bearings)[0])


def view_of(kept: Sequence[ScanInput]) -> LocalView:
    """Join scans into a view in the frame of the last one."""
    counts = np.array([len(one.scan.points) for one in kept])
    scans = ScanPoints(
        first=np.concatenate([[0], np.cumsum(counts)]).astype(np.intp),
        **{
            name: np.concatenate([getattr(one.scan, name) for one in kept])
            for name in ("points", "normals", "ranges", "starts", "rays")
        },
    )
    chosen: Ints = np.arange(len(kept), dtype=np.intp)
    return local_view(scans, chosen, np.array([one.drift for one in kept]))


def moved_covariance(covariance: Floats, pose: Floats, step: Floats, deviations: Floats) -> Floats:
    """Return the covariance (3, 3) in map after a step (3,) from a pose, whose errors in base_link are `deviations`."""
    dx, dy = compose(pose, step)[:2] - pose[:2]
    jacobian = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(jacobian @ covariance @ jacobian.T + (turn * deviations**2) @ turn.T)


def odometry_step(
    last: Observation | None, now: Observation, velocity: Floats, priors: TrackingPriors
) -> tuple[float, Floats, Floats, bool]:
    """Return time [s], motion (3,) and its standard deviations (3,) between two scans, and whether the odometry jumps.

    Parameters
    ----------
    velocity : (3,) [m/s, m/s, rad/s] Velocity at the last scan, with which a robot without odometry drives on.
    """
    if last is None:
        return 0.0, np.zeros(3), np.zeros(3), False
    dt = max(now.stamp - last.stamp, 0.0)
    if now.odometry is None or last.odometry is None:
        return dt, driven_on(velocity, dt, priors), unknown_deviations(dt, priors), False
    step = compose(invert(last.odometry), now.odometry)
    way = float(np.hypot(step[0], step[1]))
    if not way <= priors.max_speed * max(dt, 0.2):  # also if it is not finite
        return dt, np.zeros(3), np.asarray(priors.odometry_floor) + 1.0, True
    return dt, step, odometry_deviations(step, priors), False


def odometry_deviations(step: Floats, priors: TrackingPriors) -> Floats:
    """Return the standard deviations (3,) [m, m, rad] of a step (3,) of the odometry."""
    way, turn = float(np.hypot(step[0], step[1])), float(abs(step[2]))
    scale = way * np.asarray(priors.odometry_per_metre) + turn * np.asarray(priors.odometry_per_turn)
    return np.asarray(priors.odometry_floor) + scale


def unknown_deviations(dt: float, priors: TrackingPriors) -> Floats:
    """Return the standard deviations (3,) [m, m, rad] of a motion without odometry in a time [s]."""
    return np.asarray(priors.odometry_floor) + dt * np.asarray(priors.unknown_speed)


def driven_on(velocity: Floats, dt: float, priors: TrackingPriors) -> Floats:
    """Return the motion (3,) [m, m, rad] at a constant velocity (3,); after `update_period` it is unknown."""
    half = 0.5 * velocity[2] * (t := min(max(dt, 0.0), priors.update_period))
    c, s = np.cos(half), np.sin(half)  # along the chord of the arc
    x, y = velocity[:2] * t
    return np.array([c * x - s * y, s * x + c * y, 2 * half])


def changed_share(before: Floats, now: Floats, least: float) -> float:
    """Return the share of readings (n_rays,) [m] that differ from the scan before by at least a distance [m]."""
    both = ~(np.isnan(before) | np.isnan(now))
    with np.errstate(invalid="ignore"):
        same = (np.abs(before - now) < least) | (before == now)
    return float((both & ~same).sum() / max(both.sum(), 1))


def new_share(step: Floats, slip: Floats, dt: float, priors: TrackingPriors) -> float:
    """Return the share of new evidence in a scan after a step and slip (3,) [m, m, rad] in a time [s]; 0 to 1."""
    way = float(np.hypot(*step[:2]) + np.hypot(*slip[:2])) / priors.independent_distance
    turn = float(abs(step[2]) + slip[2]) / priors.independent_turn
    return min(way + turn + dt / priors.independent_period, 1.0)


def apart(a: Floats, b: Floats) -> tuple[float, float]:
    """Return the distance [m] and the turn [rad] between two poses (3,)."""
    return float(np.hypot(*(a - b)[:2])), float(abs(wrap(a[2] - b[2])))
