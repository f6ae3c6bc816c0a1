"""Five robots, and what a careful set-up has that robot.yaml states as a tolerance only."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from benchmarks.hidden_effects.robot import DataSheet


@dataclass(frozen=True, kw_only=True)
class Robot(DataSheet):
    """A robot, and what its data sheet does not state."""

    wheel_sigma: float
    """[m/s] of the rim speed of a wheel that turns, over one period of the odometry."""
    tick: float
    """[m] at the rim that an encoder resolves."""
    odometry_rate: float
    command_rate: float
    """[Hz]"""
    delay: float
    """[s] before the motors."""
    duration: tuple[float, float]
    """[s] of the shortest and of the longest run."""

    @property
    def _sigma_rim(self) -> float:
        """[m/s] of a wheel's speed, with the rounding of its ticks."""
        return math.hypot(self.wheel_sigma, self.tick * self.odometry_rate / math.sqrt(6))

    @property
    def sigma_v(self) -> float:
        """[m/s] of the odometry's speed."""
        return round(self._sigma_rim / math.sqrt(2), 5)

    @property
    def sigma_omega(self) -> float:
        """[rad/s] of the odometry's turn rate."""
        return round(self._sigma_rim * math.sqrt(2) / self.wheel_base, 5)

    def yaml(self) -> str:
        """Return robot.yaml."""
        return self.yaml_text(
            sigma_v=self.sigma_v,
            sigma_omega=self.sigma_omega,
            odometry_rate=self.odometry_rate,
            delay=self.delay,
            tolerances={
                "map": 0.0045,
                "mount_xy": 0.0018,
                "mount_yaw": 0.0006,
                "pose_xy": round(1.1 * self.sigma_xy, 5),
                "pose_yaw": self.sigma_yaw,
                "stamp": 0.0035,
            },
        )


ROBOTS = (
    Robot(
        name="tern", footprint=0.25, v=0.6, omega=1.4, a=0.6, alpha=2.5, mount=(0.19, -0.03, 0.0),
        n_rays=720, fov=math.radians(270), range_min=0.06, range_max=12.0, sigma=0.012, resolution=0.001,
        scan_rate=1.25, sweep_time=0.075, height=0.25, pose_rate=50.0, sigma_xy=0.002, sigma_yaw=0.0012,
        wheel_radius=0.075, wheel_base=0.34, wheel_sigma=0.006, odometry_rate=50.0, tau=0.09, delay=0.04,
        command_rate=20.0, tick=0.0004, duration=(64.0, 82.0),
    ),
    Robot(
        name="plover", footprint=0.2, v=0.45, omega=1.6, a=0.5, alpha=3.0, mount=(-0.06, 0.0, 0.21),
        n_rays=120, fov=2 * math.pi, range_min=0.12, range_max=8.0, sigma=0.015, resolution=0.002,
        scan_rate=5.0, sweep_time=0.18, height=0.18, pose_rate=25.0, sigma_xy=0.003, sigma_yaw=0.002,
        wheel_radius=0.035, wheel_base=0.23, wheel_sigma=0.008, odometry_rate=25.0, tau=0.06, delay=0.03,
        command_rate=10.0, tick=0.0008, duration=(60.0, 80.0),
    ),
    Robot(
        name="skua", footprint=0.22, v=0.7, omega=1.5, a=0.8, alpha=3.0, mount=(0.15, 0.05, 0.0),
        n_rays=181, fov=math.pi, range_min=0.05, range_max=20.0, sigma=0.010, resolution=0.005,
        scan_rate=5.0, sweep_time=0.0333, height=0.31, pose_rate=100.0, sigma_xy=0.0015, sigma_yaw=0.001,
        wheel_radius=0.1, wheel_base=0.4, wheel_sigma=0.005, odometry_rate=100.0, tau=0.12, delay=0.05,
        command_rate=20.0, tick=0.00015, duration=(60.0, 74.0),
    ),
    Robot(
        name="heron", footprint=0.33, v=1.2, omega=1.3, a=0.9, alpha=2.2, mount=(-0.24, 0.0, math.pi),
        n_rays=240, fov=math.radians(300), range_min=0.1, range_max=15.0, sigma=0.014, resolution=0.001,
        scan_rate=4.0, sweep_time=0.1, height=0.4, pose_rate=10.0, sigma_xy=0.004, sigma_yaw=0.002,
        wheel_radius=0.125, wheel_base=0.6, wheel_sigma=0.007, odometry_rate=40.0, tau=0.15, delay=0.06,
        command_rate=12.5, tick=0.0007, duration=(60.0, 72.0),
    ),
    Robot(
        name="dunlin", footprint=0.13, v=0.22, omega=1.2, a=0.3, alpha=2.5, mount=(0.03, 0.02, -0.35),
        n_rays=200, fov=math.radians(210), range_min=0.04, range_max=6.0, sigma=0.008, resolution=0.002,
        scan_rate=3.0, sweep_time=0.12, height=0.12, pose_rate=40.0, sigma_xy=0.0015, sigma_yaw=0.002,
        wheel_radius=0.022, wheel_base=0.16, wheel_sigma=0.004, odometry_rate=20.0, tau=0.05, delay=0.04,
        command_rate=10.0, tick=0.0006, duration=(90.0, 116.0),
    ),
)  # fmt: skip


N_NETWORK_DELAYS = 997


@dataclass(frozen=True, kw_only=True)
class Background:
    """Small flaws; all of them off at the defaults but the moment of the first scan."""

    is_dirty: bool = False
    phase: float
    """Of the first scan, 0 to 1."""
    tick: float = 0.0
    """[s] of the base's control loop, 0: it follows at once."""
    tick_phase: float = 0.0
    second_lag: float = 0.0
    """[s] of the motors, 0: none."""
    network_delays: tuple[float, ...] = (0.0,)
    """[s] of one command after the other."""
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """[m, m, rad] beyond robot.yaml."""
    stamp_jitter: float = 0.0
    """[s] of scans."""
    is_jitter_normal: bool = False
    """Otherwise it is even."""
    noise_growth: float = 0.0
    """[m/m] of the range noise."""
    wide_share: float = 0.0
    """Share of the readings with three times the noise."""
    lost_share: float = 0.0
    """Share of the readings that are lost."""
    pose_correlation: float = 0.0
    """Of the noise of one pose with that of the next."""
    pose_jitter: float = 0.0
    """[s] of the stamps of poses."""
    odometry_age: float = 0.0
    """[s] of what the encoders say."""
    odometry_jitter: float = 0.0
    """[s] of the stamps of odometry."""
    integration: str = "exact"
    """How the base adds up its way: rect (heading before the step), mid or exact (an arc)."""
    corners: float = 0.0
    """[m] by which corners of the true room differ from the map's."""


def draw_background(rng: np.random.Generator, is_dirty: bool, robot: Robot) -> Background:
    """Draw the flaws of a set-up; they keep within the tolerances of robot.yaml."""
    phase = rng.random()
    if not is_dirty:
        return Background(phase=phase)
    tick = min(float(rng.choice([0.01, 0.02, 0.025, 0.04])), robot.delay)
    x, y = np.clip(rng.normal(0, 0.0007, 2), -0.0015, 0.0015)
    return Background(
        is_dirty=True,
        phase=phase,
        tick=tick,
        tick_phase=rng.random(),
        second_lag=float(rng.uniform(0.003, 0.008)),
        network_delays=tuple(rng.exponential(0.0012, N_NETWORK_DELAYS).tolist()),
        mount=(x, y, float(np.clip(rng.normal(0, 0.0003), -0.0005, 0.0005))),
        stamp_jitter=float(rng.uniform(0.0008, 0.0016)),
        is_jitter_normal=bool(rng.integers(2)),
        noise_growth=float(rng.uniform(0, 0.0007)),
        wide_share=float(rng.uniform(0.004, 0.02)),
        lost_share=float(rng.uniform(0.001, 0.005)),
        pose_correlation=float(rng.uniform(0.3, 0.75)),
        pose_jitter=float(rng.uniform(0, 0.0005)),
        odometry_age=float(rng.uniform(0, 0.002)),
        odometry_jitter=float(rng.uniform(0, 0.0006)),
        integration=str(rng.choice(["rect", "mid", "exact"])),
        corners=float(rng.uniform(0.0015, 0.0022)),
    )
