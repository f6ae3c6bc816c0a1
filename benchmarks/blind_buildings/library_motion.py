"""Effects of the library: wheels, clock of the odometry, and motors."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.blind_buildings.base import follow, lagged
from benchmarks.blind_buildings.draws import rounded, sign, size
from benchmarks.blind_buildings.effect import Effect
from benchmarks.blind_buildings.raycast import Floats
from benchmarks.blind_buildings.scene import PHI, BaseState, Scene, V, X


class WheelRadius(Effect):
    """Both wheels are of another radius."""

    name = "wheel_radius"
    channel = "odometry"

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(s=sign(scene) * size(scene, 0.005))

    def ground(self, state: BaseState, left: float, right: float) -> tuple[float, float]:
        scale = 1 + self.parameters["s"]
        return left / scale, right / scale


class WheelRadiusDiff(Effect):
    """One wheel is larger than the other."""

    name = "wheel_radius_diff"
    channel = "odometry"

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(s=sign(scene) * size(scene, 0.003))

    def ground(self, state: BaseState, left: float, right: float) -> tuple[float, float]:
        half = self.parameters["s"] / 2
        return left / (1 - half), right / (1 + half)


class WheelBase(Effect):
    """The wheels act closer together or farther apart."""

    name = "wheel_base"
    channel = "odometry"

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(s=sign(scene) * size(scene, 0.006))

    def true_track(self, track: float) -> float:
        return float(track / (1 + self.parameters["s"]))


class WheelSlip(Effect):
    """Each wheel slips where it stands on a slippery patch."""

    name = "wheel_slip"
    channel = "odometry"

    def draw(self, scene: Scene) -> None:
        radius = scene.rng.uniform(0.45, 0.9)
        track = scene.run[::50]
        track = track[np.abs(track[:, V]) > 0.15 * scene.robot.v][:, X:PHI]
        n_near = np.array([(np.hypot(*(track - place).T) < radius).sum() for place in track])
        x, y = track[scene.rng.choice(np.flatnonzero(n_near >= np.quantile(n_near, 0.6)))]
        self.parameters = rounded(s=size(scene, 0.05), x=x, y=y, r=radius)
        self.location = {"name": None, "xy": [self.parameters["x"], self.parameters["y"]]}

    def ground(self, state: BaseState, left: float, right: float) -> tuple[float, float]:
        half = state.setup.robot.track / 2
        grip = 1 - self.parameters["s"]
        return (
            left * (grip if self._is_on(state, half) else 1),
            right * (grip if self._is_on(state, -half) else 1),
        )

    def _is_on(self, state: BaseState, off: float) -> bool:
        """Return whether a wheel [m] left of the middle stands on the patch."""
        dx = state.x - math.sin(state.phi) * off - self.parameters["x"]
        dy = state.y + math.cos(state.phi) * off - self.parameters["y"]
        return bool(math.hypot(dx, dy) < self.parameters["r"])


class PoseClockOffset(Effect):
    """Odometry is older or newer than its stamps say."""

    name = "pose_clock_offset"
    channel = "odometry"

    def draw(self, scene: Scene) -> None:
        late = 1 if scene.rng.random() < 0.8 else -1
        self.parameters = rounded(tau=late * size(scene, 0.005, 2.5))

    def read_times(self, t: Floats) -> Floats:
        return np.asarray(np.clip(t - self.parameters["tau"], 0, None))


class ActuatorLag(Effect):
    """Motors follow more slowly."""

    name = "actuator_lag"
    channel = "drive"

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(tau=size(scene, 0.015, 2.5))
        second = scene.background.second_lag
        self.lags = (
            follow(scene.robot.tau + self.parameters["tau"]),
            follow(second) if second else 1.0,
        )

    def motors(self, state: BaseState, left: float, right: float) -> tuple[float, float]:
        return lagged(state, left, right, self.lags)


class DeadTime(Effect):
    """Commands act later."""

    name = "dead_time"
    channel = "drive"

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(L=size(scene, 0.02, 2.2))

    def command_age(self, t: float) -> float:
        return float(self.parameters["L"])


class SpeedSaturation(Effect):
    """The base does not get as fast as it is told."""

    name = "speed_saturation"
    channel = "drive"

    def draw(self, scene: Scene) -> None:
        fastest = np.abs(scene.commands[:, 1]).max()
        limit = min(fastest - 0.034, fastest * scene.rng.uniform(0.6, 0.88))
        self.parameters = rounded(v_max=limit)

    def target(self, state: BaseState, v: float, omega: float) -> tuple[float, float]:
        limit = self.parameters["v_max"]
        return max(-limit, min(limit, v)), omega
