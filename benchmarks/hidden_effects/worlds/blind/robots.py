"""Seven robots with a laser, wheels, a velocity interface and an overhead pose reference, and their robot.yaml."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from benchmarks.hidden_effects.robot import DataSheet
from benchmarks.hidden_effects.worlds.blind.rooms import LARGE


@dataclass(frozen=True, kw_only=True)
class Robot(DataSheet):
    """A robot, and what its data sheet does not state."""

    tick: float
    """[m] of the rim per encoder tick."""
    noise_v: float
    noise_omega: float
    """[m/s, rad/s] of the odometry beyond its ticks."""
    odometry_rate: float
    command_rate: float
    """[Hz]"""
    delay: float
    """[s] from a command to its effect."""

    @property
    def sigma_v(self) -> float:
        """Noise of the odometry's v [m/s]: the difference of two rounded readings, and what is stated."""
        return float(np.hypot(self.noise_v, self.tick * self.odometry_rate / np.sqrt(12)))

    @property
    def sigma_omega(self) -> float:
        """Noise of the odometry's omega [rad/s]."""
        rim = self.tick * self.odometry_rate / np.sqrt(3)
        return float(np.hypot(self.noise_omega, rim / self.wheel_base))


TOLERANCES = {
    "map": 0.0045, "mount_xy": 0.0018, "mount_yaw": 0.0006, "pose_xy": 0.0022, "pose_yaw": 0.0015, "stamp": 0.0035,
}  # fmt: skip
"""Of robot.yaml."""
# fmt: off
KINDS = ("burger", "sick", "hokuyo271", "hokuyo541", "carter", "mouse", "tug")


def draw_robot(kind: str, rng: np.random.Generator) -> Robot:
    """Draw a robot of a kind: what varies are noise, sweep, resolution and the largest range of its laser."""
    def sigma(low: float, high: float) -> float:
        return float(round(rng.uniform(low, high), 3))

    def either(share: float, one: float, other: float) -> float:
        return one if rng.uniform() < share else other

    if kind == "burger":
        return Robot(
            name=kind, footprint=0.12, v=0.30, omega=1.6, a=0.6, alpha=3.2, mount=(-0.032, 0.0, 0.0), n_rays=360, fov=2 * math.pi,
            range_min=0.12, range_max=either(0.25, 3.5, 8.0), sigma=sigma(0.008, 0.015), resolution=0.001, scan_rate=5.0,
            sweep_time=either(0.5, 0.2, 0.0), height=0.18, wheel_radius=0.033, wheel_base=0.16, tick=0.0001, noise_v=0.002,
            noise_omega=0.004, odometry_rate=30.0, tau=0.06, delay=0.02, command_rate=20.0, pose_rate=30.0, sigma_xy=0.0015,
            sigma_yaw=0.002)
    if kind == "sick":
        return Robot(
            name=kind, footprint=0.24, v=0.5, omega=1.2, a=0.6, alpha=2.5, mount=(0.16, 0.0, 0.0), n_rays=181, fov=math.pi,
            range_min=0.05, range_max=20.0, sigma=sigma(0.005, 0.009), resolution=0.001, scan_rate=8.0,
            sweep_time=either(0.5, 0.0, 0.0067), height=0.28, wheel_radius=0.0975, wheel_base=0.38, tick=0.0004, noise_v=0.003,
            noise_omega=0.004, odometry_rate=20.0, tau=0.12, delay=0.0, command_rate=20.0, pose_rate=50.0, sigma_xy=0.001,
            sigma_yaw=0.001)
    if kind == "hokuyo271":
        return Robot(
            name=kind, footprint=0.2, v=0.45, omega=1.5, a=0.7, alpha=3.0, mount=(0.11, 0.02, 0.0), n_rays=271, fov=math.radians(270),
            range_min=0.06, range_max=10.0, sigma=sigma(0.008, 0.014), resolution=0.001, scan_rate=10.0, sweep_time=0.01875,
            height=0.22, wheel_radius=0.07, wheel_base=0.31, tick=0.0005, noise_v=0.003, noise_omega=0.005, odometry_rate=50.0,
            tau=0.08, delay=0.03, command_rate=25.0, pose_rate=40.0, sigma_xy=0.002, sigma_yaw=0.0015)
    if kind == "hokuyo541":
        return Robot(
            name=kind, footprint=0.22, v=0.4, omega=1.1, a=0.5, alpha=2.2, mount=(0.14, -0.03, 0.05), n_rays=541, fov=math.radians(270),
            range_min=0.05, range_max=15.0, sigma=sigma(0.006, 0.012), resolution=0.001, scan_rate=4.0, sweep_time=0.0,
            height=0.26, wheel_radius=0.08, wheel_base=0.35, tick=0.0003, noise_v=0.0025, noise_omega=0.004, odometry_rate=25.0,
            tau=0.15, delay=0.0, command_rate=10.0, pose_rate=25.0, sigma_xy=0.002, sigma_yaw=0.0012)
    if kind == "carter":
        return Robot(
            name=kind, footprint=0.34, v=0.8, omega=0.9, a=0.8, alpha=1.8, mount=(0.27, 0.05, -0.1), n_rays=241, fov=math.radians(240),
            range_min=0.1, range_max=25.0, sigma=sigma(0.01, 0.018), resolution=0.002, scan_rate=7.0, sweep_time=0.0,
            height=0.35, wheel_radius=0.125, wheel_base=0.52, tick=0.001, noise_v=0.005, noise_omega=0.004, odometry_rate=40.0,
            tau=0.2, delay=0.04, command_rate=50.0, pose_rate=30.0, sigma_xy=0.003, sigma_yaw=0.0015)
    if kind == "mouse":
        return Robot(
            name=kind, footprint=0.11, v=0.25, omega=1.8, a=0.5, alpha=3.6, mount=(0.03, 0.0, 0.0), n_rays=121, fov=math.radians(240),
            range_min=0.06, range_max=4.5, sigma=sigma(0.014, 0.02), resolution=either(0.5, 0.001, 0.005), scan_rate=10.0,
            sweep_time=either(0.5, 0.0, 0.0667), height=0.12, wheel_radius=0.03, wheel_base=0.14, tick=0.00015, noise_v=0.002,
            noise_omega=0.006, odometry_rate=50.0, tau=0.05, delay=0.02, command_rate=20.0, pose_rate=60.0, sigma_xy=0.0015,
            sigma_yaw=0.002)
    return Robot(
        name=kind, footprint=0.26, v=0.6, omega=1.3, a=0.8, alpha=2.6, mount=(-0.12, 0.0, 3.0), n_rays=240, fov=2 * math.pi,
        range_min=0.1, range_max=12.0, sigma=sigma(0.009, 0.016), resolution=0.001, scan_rate=6.0,
        sweep_time=either(0.6, 0.0, 0.12), height=0.3, wheel_radius=0.09, wheel_base=0.42, tick=0.0006, noise_v=0.003,
        noise_omega=0.004, odometry_rate=20.0, tau=0.1, delay=0.05, command_rate=20.0, pose_rate=20.0, sigma_xy=0.002,
        sigma_yaw=0.0015)
# fmt: on


def robots_for(room: str, *, needs_gap: bool) -> list[str]:
    """Return the kinds of robot that fit into a room; `needs_gap`: whose laser does not look all round."""
    kinds = [
        kind
        for kind in KINDS
        if not (kind == "carter" and room not in LARGE)
        and not (kind == "tug" and room in ("tworooms", "flat"))
        and not (kind in ("sick", "hokuyo541") and room == "flat")
    ]
    if needs_gap:
        kinds = [kind for kind in kinds if kind not in ("burger", "tug")]
    if room == "hall":
        kinds = [kind for kind in kinds if kind != "mouse"]
    return kinds
