"""Five robots, and what robot.yaml says of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from benchmarks.blind_buildings.raycast import Floats


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A robot of two driven wheels with a planar laser; SI units."""

    name: str
    radius: float
    """[m] of the footprint."""
    v: float
    omega: float
    a: float
    alpha: float
    """Limits [m/s, rad/s, m/s2, rad/s2]."""
    mount: tuple[float, float, float]
    """Of the laser [m, m, rad]."""
    n_rays: int
    fov: float
    """[rad]"""
    range_min: float
    range_max: float
    sigma: float
    resolution: float
    """[m]"""
    scan_rate: float
    """[1/s]"""
    sweep_time: float
    """[s] from the first ray of a scan to after its last."""
    height: float
    """[m] of the laser."""
    pose_rate: float
    """[1/s]"""
    sigma_xy: float
    sigma_yaw: float
    """[m, rad] of a pose."""
    wheel_radius: float
    track: float
    """[m]"""
    wheel_sigma: float
    """[m/s] of the rim speed of a wheel that turns, over one period of the odometry."""
    odom_rate: float
    """[1/s]"""
    tau: float
    delay: float
    """[s] of the motors, and before them."""
    command_rate: float
    """[1/s]"""
    tick: float
    """[m] at the rim that an encoder resolves."""
    duration: tuple[float, float]
    """[s] of the shortest and of the longest run."""

    @property
    def _sigma_rim(self) -> float:
        """[m/s] of a wheel's speed, with the rounding of its ticks."""
        return math.hypot(self.wheel_sigma, self.tick * self.odom_rate / math.sqrt(6))

    @property
    def sigma_v(self) -> float:
        """[m/s] of the odometry's speed."""
        return round(self._sigma_rim / math.sqrt(2), 5)

    @property
    def sigma_omega(self) -> float:
        """[rad/s] of the odometry's turn rate."""
        return round(self._sigma_rim * math.sqrt(2) / self.track, 5)

    @property
    def ray_step(self) -> float:
        """[rad] from ray to ray; a laser that looks all round does not repeat its first ray."""
        is_full = abs(self.fov - 2 * math.pi) < 1e-6
        return self.fov / (self.n_rays if is_full else self.n_rays - 1)

    @property
    def bearings(self) -> Floats:
        """(n_rays,) [rad] in the frame of the laser."""
        return np.asarray(-self.fov / 2 + self.ray_step * np.arange(self.n_rays))


ROBOTS = (
    Robot(
        name="tern", radius=0.25, v=0.6, omega=1.4, a=0.6, alpha=2.5, mount=(0.19, -0.03, 0.0),
        n_rays=720, fov=math.radians(270), range_min=0.06, range_max=12.0, sigma=0.012, resolution=0.001,
        scan_rate=1.25, sweep_time=0.075, height=0.25, pose_rate=50.0, sigma_xy=0.002, sigma_yaw=0.0012,
        wheel_radius=0.075, track=0.34, wheel_sigma=0.006, odom_rate=50.0, tau=0.09, delay=0.04,
        command_rate=20.0, tick=0.0004, duration=(64.0, 82.0),
    ),
    Robot(
        name="plover", radius=0.2, v=0.45, omega=1.6, a=0.5, alpha=3.0, mount=(-0.06, 0.0, 0.21),
        n_rays=120, fov=2 * math.pi, range_min=0.12, range_max=8.0, sigma=0.015, resolution=0.002,
        scan_rate=5.0, sweep_time=0.18, height=0.18, pose_rate=25.0, sigma_xy=0.003, sigma_yaw=0.002,
        wheel_radius=0.035, track=0.23, wheel_sigma=0.008, odom_rate=25.0, tau=0.06, delay=0.03,
        command_rate=10.0, tick=0.0008, duration=(60.0, 80.0),
    ),
    Robot(
        name="skua", radius=0.22, v=0.7, omega=1.5, a=0.8, alpha=3.0, mount=(0.15, 0.05, 0.0),
        n_rays=181, fov=math.pi, range_min=0.05, range_max=20.0, sigma=0.010, resolution=0.005,
        scan_rate=5.0, sweep_time=0.0333, height=0.31, pose_rate=100.0, sigma_xy=0.0015, sigma_yaw=0.001,
        wheel_radius=0.1, track=0.4, wheel_sigma=0.005, odom_rate=100.0, tau=0.12, delay=0.05,
        command_rate=20.0, tick=0.00015, duration=(60.0, 74.0),
    ),
    Robot(
        name="heron", radius=0.33, v=1.2, omega=1.3, a=0.9, alpha=2.2, mount=(-0.24, 0.0, math.pi),
        n_rays=240, fov=math.radians(300), range_min=0.1, range_max=15.0, sigma=0.014, resolution=0.001,
        scan_rate=4.0, sweep_time=0.1, height=0.4, pose_rate=10.0, sigma_xy=0.004, sigma_yaw=0.002,
        wheel_radius=0.125, track=0.6, wheel_sigma=0.007, odom_rate=40.0, tau=0.15, delay=0.06,
        command_rate=12.5, tick=0.0007, duration=(60.0, 72.0),
    ),
    Robot(
        name="dunlin", radius=0.13, v=0.22, omega=1.2, a=0.3, alpha=2.5, mount=(0.03, 0.02, -0.35),
        n_rays=200, fov=math.radians(210), range_min=0.04, range_max=6.0, sigma=0.008, resolution=0.002,
        scan_rate=3.0, sweep_time=0.12, height=0.12, pose_rate=40.0, sigma_xy=0.0015, sigma_yaw=0.002,
        wheel_radius=0.022, track=0.16, wheel_sigma=0.004, odom_rate=20.0, tau=0.05, delay=0.04,
        command_rate=10.0, tick=0.0006, duration=(90.0, 116.0),
    ),
)  # fmt: skip


def yaml_text(robot: Robot) -> str:
    """Return robot.yaml."""
    x, y, yaw = robot.mount
    return f"""name: {robot.name}
drive: diff
footprint_radius: {robot.radius}
limits:
  v: {robot.v}
  omega: {robot.omega}
  a: {robot.a}
  alpha: {robot.alpha}
  turning_radius: 0.0
sensor:
  mount:
  - {x}
  - {y}
  - {yaw:.9f}
  n_rays: {robot.n_rays}
  fov: {robot.fov:.9f}
  range_min: {robot.range_min}
  range_max: {robot.range_max}
  sigma: {robot.sigma}
  resolution: {robot.resolution}
  rate: {robot.scan_rate}
  sweep_time: {robot.sweep_time}
  height: {robot.height}
pose:
  rate: {robot.pose_rate}
  sigma_xy: {robot.sigma_xy}
  sigma_yaw: {robot.sigma_yaw}
wheels:
  radius: {robot.wheel_radius}
  base: {robot.track}
  sigma_v: {robot.sigma_v}
  sigma_omega: {robot.sigma_omega}
  rate: {robot.odom_rate}
actuators:
  tau: {robot.tau}
  delay: {robot.delay}
tolerances:
  map: 0.0045
  mount_xy: 0.0018
  mount_yaw: 0.0006
  pose_xy: {round(1.1 * robot.sigma_xy, 5)}
  pose_yaw: {robot.sigma_yaw}
  stamp: 0.0035
"""
