"""The robot: its file, and what stands between command and motor and between wheel and odometry."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import yaml

from benchmarks.hidden_effects.world import Floats

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
class RobotSpec:
    """What robot.yaml says."""

    mount: tuple[float, float, float] = (0.10, 0.0, 0.0)
    n_rays: int = 91
    fov: float = math.pi
    range_min: float = 0.05
    range_max: float = 8.0
    sigma: float = 0.01
    resolution: float = 0.001
    rate: float = 10.0
    sweep_time: float = 0.0
    height: float = 0.30
    pose_rate: float = 30.0
    sigma_xy: float = 0.002
    sigma_yaw: float = 0.0015
    base: float = 0.40
    sigma_v: float = 0.004
    sigma_omega: float = 0.006
    base_loop: BaseLoop | None = None
    """Of a real base; None: commands act when they are sent, wheels are read without ticks."""
    tau: float = 0.10
    v: float = 0.4
    omega: float = 1.0
    a: float = 0.5
    alpha: float = 2.0

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
        sigma_v = math.hypot(self.sigma_v, rim / math.sqrt(2))
        sigma_omega = math.hypot(self.sigma_omega, rim * math.sqrt(2) / self.base)
        period, jitter = (0.0, 0.0) if loop is None else (loop.period, round(loop.transport / 2, 4))
        return yaml.safe_dump(
            {
                "name": "radix",
                "drive": "diff",
                "footprint_radius": 0.20,
                "limits": {
                    "v": self.v,
                    "omega": self.omega,
                    "a": self.a,
                    "alpha": self.alpha,
                    "turning_radius": 0.0,
                },
                "sensor": {
                    "mount": list(self.mount),
                    "n_rays": self.n_rays,
                    "fov": self.fov,
                    "range_min": self.range_min,
                    "range_max": self.range_max,
                    "sigma": self.sigma,
                    "resolution": self.resolution,
                    "rate": self.rate,
                    "sweep_time": self.sweep_time,
                    "height": self.height,
                },
                "pose": {"rate": self.pose_rate, "sigma_xy": self.sigma_xy, "sigma_yaw": self.sigma_yaw},
                "wheels": {
                    "radius": 0.10,
                    "base": self.base,
                    "sigma_v": round(sigma_v, 5),
                    "sigma_omega": round(sigma_omega, 5),
                    "rate": self.odom_rate,
                },
                "actuators": {"tau": self.tau, "delay": 0.0 if loop is None else round(loop.mean_delay, 4)},
                "tolerances": {"control_period": period, "transport_jitter": jitter},
            },
            sort_keys=False,
        )


def make_robot(rng: np.random.Generator) -> RobotSpec:
    """Draw a robot: four of five are the default one, the others vary in a few ways."""
    robot = RobotSpec() if rng.random() < 0.6 else RobotSpec(n_rays=181, rate=5.0)
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
