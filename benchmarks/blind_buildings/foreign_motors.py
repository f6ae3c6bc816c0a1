"""Foreign effects between commands and motion."""

from __future__ import annotations

import math

from benchmarks.blind_buildings.base import follow
from benchmarks.blind_buildings.draws import even, rounded
from benchmarks.blind_buildings.effect import Effect
from benchmarks.blind_buildings.scene import STEP, BaseState, Scene


class SetSteps(Effect):
    """Set points come in steps."""

    name = "g_setsteps"
    channel = "drive"
    note = "the base rounds set points to a coarse grid towards zero; near speed_saturation"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        robot = scene.robot
        self.parameters = rounded(v=robot.v / even(scene, 5, 8), omega=robot.omega / even(scene, 6, 9))

    def target(self, state: BaseState, v: float, omega: float) -> tuple[float, float]:
        step_v, step_omega = self.parameters["v"], self.parameters["omega"]
        return (
            math.copysign(math.floor(abs(v) / step_v + 0.2) * step_v, v),
            math.copysign(math.floor(abs(omega) / step_omega + 0.2) * step_omega, omega),
        )


class Resonance(Effect):
    """Wheels follow as a spring and a damper."""

    name = "g_resonance"
    channel = "drive"
    note = "the speed loop is ill tuned and rings after each change; near actuator_lag"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(f=even(scene, 0.9, 1.6), zeta=even(scene, 0.12, 0.25))
        self.left = self.right = 0.0

    def motors(self, state: BaseState, left: float, right: float) -> tuple[float, float]:
        w0 = 2 * math.pi * self.parameters["f"]
        zeta = self.parameters["zeta"]
        self.left += STEP * (w0 * w0 * (left - state.rim_left) - 2 * zeta * w0 * self.left)
        self.right += STEP * (w0 * w0 * (right - state.rim_right) - 2 * zeta * w0 * self.right)
        return state.rim_left + STEP * self.left, state.rim_right + STEP * self.right


class LagAsymmetry(Effect):
    """The lag of gaining speed is not that of losing it."""

    name = "g_lagasym"
    channel = "drive"
    note = "gains speed slowly, brakes at once; near actuator_lag"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        tau = scene.robot.tau
        self.parameters = rounded(up=tau + even(scene, 0.15, 0.35), down=tau * 0.5)

    def motors(self, state: BaseState, left: float, right: float) -> tuple[float, float]:
        return self._after(state.rim_left, left), self._after(state.rim_right, right)

    def _after(self, rim: float, target: float) -> float:
        """Return the rim speed [m/s] after a step."""
        gains = abs(target) > abs(rim) and target * rim >= 0
        return rim + follow(self.parameters["up" if gains else "down"]) * (target - rim)


class Bursts(Effect):
    """Commands of a while act together at its end."""

    name = "g_bursts"
    channel = "drive"
    note = "under load commands wait in a queue for half a second, then act at once; near dead_time"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(every=even(scene, 4, 7), span=even(scene, 0.5, 0.8))

    def command_age(self, t: float) -> float:
        return max(0.0, float(self.parameters["span"] - t % self.parameters["every"]))


class PowerShare(Effect):
    """Speed falls with the turn rate."""

    name = "g_powershare"
    channel = "drive"
    note = "wheels share the power: the faster the turn, the slower it drives; near speed_saturation"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(k=even(scene, 0.5, 0.8))

    def target(self, state: BaseState, v: float, omega: float) -> tuple[float, float]:
        share = min(1, 1.5 * abs(omega) / state.setup.robot.omega)
        return v * (1 - self.parameters["k"] * share), omega


class Slope(Effect):
    """Speed has a part that depends on the heading."""

    name = "g_slope"
    channel = "drive"
    note = (
        "the floor is inclined: downhill it runs faster than told, uphill slower, "
        "and rolls when stopped; near none"
    )
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        speed = even(scene, 0.12, 0.2) * scene.robot.v
        self.parameters = rounded(k=speed, dir=even(scene, -3, 3))

    def target(self, state: BaseState, v: float, omega: float) -> tuple[float, float]:
        return v + self.parameters["k"] * math.cos(state.phi - self.parameters["dir"]), omega


class Windup(Effect):
    """A wheel that stands stays for a while, then runs too fast for another."""

    name = "g_windup"
    channel = "drive"
    note = (
        "stiction: wheels stay until the integrator has wound up, then overshoot; near dead_time/actuator_lag"
    )
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(wait=even(scene, 0.25, 0.45), over=even(scene, 0.25, 0.5))
        self.waited = [0.0, 0.0]
        self.over = [0.0, 0.0]

    def motors(self, state: BaseState, left: float, right: float) -> tuple[float, float]:
        share = follow(state.setup.robot.tau)
        return (
            self._after(0, state.rim_left, left, share),
            self._after(1, state.rim_right, right, share),
        )

    def _after(self, wheel: int, rim: float, target: float, share: float) -> float:
        """Return the rim speed [m/s] of a wheel after a step."""
        stands = abs(rim) < 0.004
        if stands and abs(target) > 0.01:
            self.waited[wheel] += STEP
        if abs(target) < 0.01:
            self.waited[wheel] = 0.0
        if stands and 0 < self.waited[wheel] < self.parameters["wait"]:
            return rim * 0.9
        if self.waited[wheel] >= self.parameters["wait"]:
            self.over[wheel] = self.parameters["over"]
            self.waited[wheel] = 0.0
        self.over[wheel] *= math.exp(-STEP / 0.5)
        return rim + share * (target * (1 + self.over[wheel]) - rim)
