"""The robot: its file, and what stands between command and motor and between wheel and odometry."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.robot import DataSheet

COMMAND_PERIOD = 0.05
"""[s] of commands and odometry."""


@dataclass(frozen=True, kw_only=True)
class BaseLoop:
    """What every real base has between command and motor, and between wheel and odometry."""

    period: float
    """[s] of its control loop, as its maker states it: a command waits for the next tick."""
    slow: float
    """By which share the loop's timer runs slow, so that it beats with the commands'."""
    phase: float
    """[s] of the first tick."""
    transport: float
    """[s] mean time of a command on its way; each takes half to one and a half of it."""
    tick: float
    """[m] of an encoder, at the rim."""
    odom_rate: float
    """[Hz]"""
    integration: str
    """`rectangle`, `midpoint` or `exact`: how the driver adds up poses."""
    seed: int
    """Of the transport times."""

    @property
    def mean_delay(self) -> float:
        """[s] from a command to its tick, as a bench test finds it."""
        return self.transport + self.period / 2


def draw_base_loop(rng: np.random.Generator) -> BaseLoop:
    """Draw a base: loops of 10 to 50 Hz, ticks of 0.2 to 5 mm, odometry at 10 to 100 Hz."""
    period = float(rng.choice([0.02, 0.04, 0.1]))
    return BaseLoop(
        period=period,
        slow=float(rng.uniform(0.001, 0.004)),
        phase=float(rng.uniform(0, period)),
        transport=float(rng.uniform(0.002, 0.006)),
        tick=float(rng.choice([0.0002, 0.001, 0.002, 0.005])),
        odom_rate=float(rng.choice([10.0, 20.0, 50.0, 100.0])),
        integration=str(rng.choice(["rectangle", "midpoint", "exact"])),
        seed=int(rng.integers(2**62)),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotSpec(DataSheet):
    """What robot.yaml says; the defaults are those of the most common robot."""

    name: str = "radix"
    footprint: float = 0.20
    v: float = 0.4
    omega: float = 1.0
    a: float = 0.5
    alpha: float = 2.0
    mount: tuple[float, float, float] = (0.10, 0.0, 0.0)
    n_rays: int = 91
    fov: float = math.pi
    range_min: float = 0.05
    range_max: float = 8.0
    sigma: float = 0.01
    resolution: float = 0.001
    scan_rate: float = 10.0
    sweep_time: float = 0.0
    height: float = 0.30
    pose_rate: float = 30.0
    sigma_xy: float = 0.002
    sigma_yaw: float = 0.0015
    wheel_radius: float = 0.10
    wheel_base: float = 0.40
    tau: float = 0.10
    sigma_v: float = 0.004
    sigma_omega: float = 0.006
    base_loop: BaseLoop | None = None
    """Of a real base; None: commands act when they are sent, wheels are read without ticks."""
    angle_digits: ClassVar[int] = 16

    @property
    def bearings(self) -> Floats:
        """(n_rays,) [rad]; a full turn leaves out its last end."""
        if self.fov > 2 * math.pi - 1e-6:
            return -math.pi + 2 * math.pi * np.arange(self.n_rays) / self.n_rays
        return np.linspace(-self.fov / 2, self.fov / 2, self.n_rays)

    @property
    def odom_rate(self) -> float:
        """[Hz] of the odometry."""
        return 1 / COMMAND_PERIOD if self.base_loop is None else self.base_loop.odom_rate

    def yaml(self) -> str:
        """Return robot.yaml; tolerances stay at their defaults, except those of the base's loop, which its maker states."""
        loop = self.base_loop
        # one wheel's travel between two readings of an encoder is off by the difference of two uniform errors
        rim = 0.0 if loop is None else loop.tick / math.sqrt(6) * loop.odom_rate
        period, jitter = (0.0, 0.0) if loop is None else (loop.period, round(loop.transport / 2, 4))
        return self.yaml_text(
            sigma_v=math.hypot(self.sigma_v, rim / math.sqrt(2)),
            sigma_omega=math.hypot(self.sigma_omega, rim * math.sqrt(2) / self.wheel_base),
            odometry_rate=self.odom_rate,
            delay=0.0 if loop is None else loop.mean_delay,
            tolerances={"control_period": period, "transport_jitter": jitter},
        )


def make_robot(rng: np.random.Generator) -> RobotSpec:
    """Draw a robot: four of five are the default one, the others vary in a few ways."""
    robot = RobotSpec() if rng.random() < 0.6 else RobotSpec(n_rays=181, scan_rate=5.0)
    if rng.random() < 0.8:
        return robot
    choices = {
        "fov": {"fov": float(rng.choice([1.5 * math.pi, 2 * math.pi]))},
        "sigma": {"sigma": round(float(rng.uniform(0.005, 0.02)), 4)},
        "range_max": {"range_max": round(float(rng.uniform(5.0, 12.0)), 1)},
        "mount": {
            "mount": (
                round(float(rng.uniform(-0.12, 0.15)), 3),
                round(float(rng.uniform(-0.1, 0.1)), 3),
                round(float(rng.uniform(-0.5, 0.5)), 3),
            )
        },
        "backwards": {"mount": (-0.10, 0.0, math.pi)},
        "sweep": {"sweep_time": 0.05},
        "resolution": {"resolution": 0.0},
        "height": {"height": round(float(rng.uniform(0.15, 0.4)), 2)},
        "tau": {"tau": round(float(rng.uniform(0.05, 0.2)), 3)},
    }
    names = rng.choice(list(choices), size=int(rng.integers(1, 4)), replace=False)
    changes: dict[str, object] = {}
    for name in names:
        changes |= choices[name]
    return replace(robot, **changes)  # type: ignore[arg-type]
