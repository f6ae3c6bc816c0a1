"""The data sheet of a robot: two driven wheels, a planar laser, a pose reference; and its robot.yaml."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import yaml

from benchmarks.hidden_effects.log import Floats


@dataclass(frozen=True, kw_only=True)
class DataSheet:
    """What the makers of a robot and of its sensors state; SI units."""

    name: str
    footprint: float
    """[m] radius."""
    v: float
    omega: float
    a: float
    alpha: float
    """Limits [m/s, rad/s, m/s2, rad/s2]."""
    mount: tuple[float, float, float]
    """[m, m, rad] of the laser on the base."""
    n_rays: int
    fov: float
    """[rad]"""
    range_min: float
    range_max: float
    sigma: float
    resolution: float
    """[m], as the three above."""
    scan_rate: float
    """[Hz]"""
    sweep_time: float
    """[s] from the first ray of a scan to after its last."""
    height: float
    """[m] of the laser over the floor."""
    pose_rate: float
    """[Hz]"""
    sigma_xy: float
    sigma_yaw: float
    """[m, rad] of the pose reference."""
    wheel_radius: float
    wheel_base: float
    """[m]"""
    tau: float
    """[s] of the motors."""
    angle_digits: ClassVar[int] = 9
    """Of mount and field of view in robot.yaml."""

    @property
    def ray_step(self) -> float:
        """Angle between neighbouring rays [rad]; a laser that looks all round does not repeat its first ray."""
        return self.fov / (self.n_rays if self.fov > 2 * math.pi - 1e-6 else self.n_rays - 1)

    @property
    def bearings(self) -> Floats:
        """(n_rays,) [rad] in the frame of the laser."""
        return np.asarray(-self.fov / 2 + self.ray_step * np.arange(self.n_rays))

    def yaml_text(
        self,
        *,
        sigma_v: float,
        sigma_omega: float,
        odometry_rate: float,
        delay: float,
        tolerances: dict[str, float],
    ) -> str:
        """Return robot.yaml.

        Parameters
        ----------
        sigma_v, sigma_omega : [m/s, rad/s] of the odometry
        delay : [s] from a command to its effect, as a bench test finds it
        """
        x, y, yaw = self.mount

        def stated(*names: str) -> dict[str, Any]:
            return {name: getattr(self, name) for name in names}

        facts: dict[str, Any] = {
            "name": self.name,
            "drive": "diff",
            "footprint_radius": self.footprint,
            "limits": {**stated("v", "omega", "a", "alpha"), "turning_radius": 0.0},
            "sensor": {
                "mount": [x, y, round(yaw, self.angle_digits)],
                "n_rays": self.n_rays,
                "fov": round(self.fov, self.angle_digits),
                **stated("range_min", "range_max", "sigma", "resolution"),
                "rate": self.scan_rate,
                **stated("sweep_time", "height"),
            },
            "pose": {"rate": self.pose_rate, **stated("sigma_xy", "sigma_yaw")},
            "wheels": {
                "radius": self.wheel_radius,
                "base": self.wheel_base,
                "sigma_v": float(round(sigma_v, 5)),
                "sigma_omega": float(round(sigma_omega, 5)),
                "rate": odometry_rate,
            },
            "actuators": {"tau": self.tau, "delay": float(round(delay, 4))},
            "tolerances": tolerances,
        }
        return yaml.safe_dump(facts, sort_keys=False)

    def of_log(self) -> dict[str, Any]:
        """Return what a `Log` contains of the data sheet."""
        return {
            "bearings": self.bearings,
            "range_limits": (self.range_min, self.range_max),
            "sweep_time": self.sweep_time,
            "scan_period": 1 / self.scan_rate,
            "mount": (*self.mount[:2], self.height, self.mount[2]),
        }
