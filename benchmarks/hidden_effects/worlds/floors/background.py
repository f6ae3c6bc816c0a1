"""What a careful set-up has and robot.yaml does not tell, or tells as a tolerance only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.hidden_effects.worlds.floors.robots import Robot

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
