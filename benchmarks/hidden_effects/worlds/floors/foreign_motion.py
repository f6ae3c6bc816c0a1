"""Effects outside the library: wheels, floor and odometry, the pose reference, and what is between commands and motion."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np
from scipy import ndimage

from benchmarks.hidden_effects.log import Floats, Odometry
from benchmarks.hidden_effects.worlds.floors.base import follow
from benchmarks.hidden_effects.worlds.floors.effect import DEGREE, Effect, even, law, rounded, sign
from benchmarks.hidden_effects.worlds.floors.scene import OMEGA, STEP, TIME, BaseState, Scene, V, pose_at

BUMP_STEPS = 25
"""Steps of the base that a bump lasts."""
BUMP_SEED = 7


class Tyre(Effect, name="g_tyre", channel="odometry"):
    """The left tyre loses pressure during the run; near wheel_radius_diff/wheel_radius."""

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(s=even(scene, 0.03, 0.06), side=sign(scene))

    def ground(self, state: BaseState, left: float, right: float) -> tuple[float, float]:
        size = 1 - self.parameters["s"] * state.t / state.setup.duration
        return (left * size, right) if self.parameters["side"] > 0 else (left, right * size)


class Payload(Effect, name="g_payload", channel="odometry"):
    """A load is taken on and put off: both tyres sag, one more, in between; near wheel_radius(_diff)."""

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(
            t1=even(scene, 0.25, 0.4) * scene.duration,
            t2=even(scene, 0.6, 0.8) * scene.duration,
            left=even(scene, 0.02, 0.05),
            right=even(scene, 0.005, 0.015),
        )

    def ground(self, state: BaseState, left: float, right: float) -> tuple[float, float]:
        told = self.parameters
        if told["t1"] < state.t < told["t2"]:
            return left * (1 - told["left"]), right * (1 - told["right"])
        return left, right


class Joints(Effect, name="g_joints", channel="odometry"):
    """Bumps at joints of the floor kick the heading whenever one is crossed; near
    wheel_radius_diff/wheel_slip.
    """

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(step=even(scene, 0.9, 1.5), kick=even(scene, 2.0, 4.0) * DEGREE)
        self.tile: tuple[int, int] | None = None
        self.steps_left = 0
        self.turn = 0.0
        self.rng = np.random.default_rng(BUMP_SEED)

    def body(self, state: BaseState, v: float, omega: float) -> tuple[float, float, float]:
        step = self.parameters["step"]
        tile = (math.floor(state.x / step), math.floor(state.y / step))
        if self.tile is not None and tile != self.tile and abs(v) > 0.03:
            self.steps_left = BUMP_STEPS
            self.turn = self.rng.choice([-1, 1]) * self.parameters["kick"] / BUMP_STEPS / STEP
        self.tile = tile
        if self.steps_left > 0:
            self.steps_left -= 1
            return v, 0.0, omega + self.turn
        return v, 0.0, omega


def _scrubbed(p: Mapping[str, float], state: BaseState, v: float, omega: float) -> tuple[float, float, float]:
    rim = abs(omega) * state.setup.robot.wheel_base / 2
    return v, 0.0, omega / (1 + p["k"] * (rim / (rim + abs(v) + 1e-6)) ** 2)


law(
    "g_scrub",
    lambda scene: {"k": even(scene, 0.1, 0.22)},
    "odometry",
    note="Wide tyres scrub: the effective base is larger the tighter the turn; near wheel_base.",
    body=_scrubbed,
)


def _draw_scales(scene: Scene) -> Mapping[str, float]:
    left = even(scene, 0.02, 0.05)
    return {"left": left, "right": -even(scene, 0.5, 1.0) * left}


law(
    "g_turnasym",
    _draw_scales,
    "odometry",
    note="A gyro with another scale to the left than to the right makes the heading; near wheel_base/wheel_radius_diff.",
    increments=lambda p, way, turn: (way, turn * np.where(turn > 0, 1 + p["left"], 1 + p["right"])),
)


law(
    "g_crab",
    lambda scene: {"angle": sign(scene) * even(scene, 3.0, 6.0) * DEGREE},
    "odometry",
    note="The axle is askew in the frame, the robot goes slightly sideways; near none (mount_yaw with mount_xy).",
    body=lambda p, state, v, omega: (v * math.cos(p["angle"]), v * math.sin(p["angle"]), omega),
)


class Gaps(Effect, name="g_gaps", channel="odometry", every=(4, 7), span=(0.25, 0.45)):
    """Bursts of lost encoder packets: the way in between is never counted; near wheel_slip/wheel_radius."""

    def encoders(self, t: Floats, travel: Floats) -> Floats:
        steps = np.diff(travel, axis=0, prepend=travel[:1])
        steps[np.mod(t, self.parameters["every"]) < self.parameters["span"]] = 0
        return np.asarray(travel[0] + np.cumsum(steps, axis=0))


class SlewedClock(Effect, name="g_ntp", channel="odometry", rate=(0.004, 0.008), every=(14, 25)):
    """The base computer is slewed by NTP: its clock runs off and is pulled back, over and over; near
    pose_clock_offset.
    """

    def read_times(self, t: Floats) -> Floats:
        every = self.parameters["every"]
        share = np.mod(t, every) / every
        tooth = np.where(share < 0.75, share / 0.75, (1 - share) / 0.25)
        return np.asarray(t - tooth * self.parameters["rate"] * every)


class YawSteps(Effect, name="g_yawsteps", channel="odometry"):
    """The base adds up its way along a heading held in steps of several degrees; near wheel_radius_diff."""

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(step=even(scene, 7, 12) * DEGREE)

    def odometry(self, odometry: Odometry) -> Odometry:
        step = self.parameters["step"]
        heading = np.floor(odometry.poses[:, 2] / step) * step
        way = odometry.twists[:, 0] * (1 / self.scene.robot.odometry_rate)
        x, y = np.cumsum(way * np.cos(heading)), np.cumsum(way * np.sin(heading))
        return dataclasses.replace(odometry, poses=np.column_stack([x, y, heading]))


def episodes(rng: np.random.Generator, t: Floats, every: float, span: float) -> Floats:
    """Return how far each time [s] is into an episode [s], -1 outside; they come about every so often."""
    into = np.full(len(t), -1.0)
    begins = every * 0.5
    while begins < t[-1]:
        is_within = (t >= begins) & (t < begins + span)
        into[is_within] = t[is_within] - begins
        begins += every * rng.uniform(0.7, 1.3)
    return into


class Extrapolated(Effect, name="g_extrapolate", channel="pose"):
    """Tracking is lost at times and the pose goes on with its last speed; near latency/wheel_slip."""

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(every=even(scene, 6, 9), span=even(scene, 1.2, 2.0))
        self.seed = scene.rng.integers(1 << 30)

    def poses(self, t: Floats, poses: Floats, run: Floats) -> Floats:
        rng = np.random.default_rng(self.seed)
        into = episodes(rng, t, self.parameters["every"], self.parameters["span"])
        told = poses.copy()
        for i in np.flatnonzero(into >= 0):
            lost = t[i] - into[i]
            last, before = np.array(pose_at(run, lost)), np.array(pose_at(run, lost - 0.1))
            told[i] = last + (last - before) * into[i] / 0.1
        return told


class Lever(Effect, name="g_lever", channel="pose"):
    """The marker stands on a soft pole: it leans with acceleration, its place moves against the robot;
    near mount_xy/latency.
    """

    def draw(self, scene: Scene) -> None:
        softness = even(scene, 0.05, 0.09) * (0.6 / scene.robot.a) ** 0.7
        self.parameters = rounded(k=softness, tau=0.12)

    def poses(self, t: Floats, poses: Floats, run: Floats) -> Floats:
        width = int(0.08 / STEP)
        along = ndimage.gaussian_filter1d(np.gradient(run[:, V], STEP), width)
        across = ndimage.gaussian_filter1d(run[:, V] * run[:, OMEGA], width)
        ahead, aside = (-self.parameters["k"] * np.interp(t, run[:, TIME], one) for one in (along, across))
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        x = poses[:, 0] + c * ahead - s * aside
        y = poses[:, 1] + s * ahead + c * aside
        return np.column_stack([x, y, poses[:, 2]])


class MarkerSwap(Effect, name="g_markerswap", channel="pose"):
    """Two markers are confused at times: the pose jumps in the frame of the robot and turns; near
    mount_xy/mount_yaw.
    """

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(
            dx=even(scene, -0.12, 0.12),
            dy=sign(scene) * even(scene, 0.05, 0.12),
            yaw=sign(scene) * even(scene, 4, 12) * DEGREE,
            every=even(scene, 7, 12),
            span=even(scene, 0.8, 1.8),
        )
        self.seed = scene.rng.integers(1 << 30)

    def poses(self, t: Floats, poses: Floats, run: Floats) -> Floats:
        rng = np.random.default_rng(self.seed)
        is_off = episodes(rng, t, self.parameters["every"], self.parameters["span"]) >= 0
        dx, dy = self.parameters["dx"], self.parameters["dy"]
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        yaw = np.full(len(t), self.parameters["yaw"])
        shift = np.column_stack([c * dx - s * dy, s * dx + c * dy, yaw])
        return np.asarray(poses + is_off[:, None] * shift)


class Stale(Effect, name="g_stale", channel="pose"):
    """Under load the reference repeats old poses under new stamps for some frames; near
    latency/pose_clock_offset.
    """

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(share=even(scene, 0.3, 0.5), longest=even(scene, 0.25, 0.45))
        self.seed = scene.rng.integers(1 << 30)

    def poses(self, t: Floats, poses: Floats, run: Floats) -> Floats:
        rng = np.random.default_rng(self.seed)
        told = poses.copy()
        period = t[1] - t[0]
        i = 0
        while i < len(t):
            n = max(1, round(rng.uniform(0.3, 1) * self.parameters["longest"] / period))
            if rng.random() < self.parameters["share"]:
                told[i : i + n + 1] = poses[i]
            i += n + 1
        return told


def _to_grid(value: float, step: float) -> float:
    return math.copysign(math.floor(abs(value) / step + 0.2) * step, value)


law(
    "g_setsteps",
    lambda scene: {"v": scene.robot.v / even(scene, 5, 8), "omega": scene.robot.omega / even(scene, 6, 9)},
    "drive",
    note="The base rounds set points to a coarse grid towards zero; near speed_saturation.",
    target=lambda p, state, v, omega: (_to_grid(v, p["v"]), _to_grid(omega, p["omega"])),
)


class Resonance(Effect, name="g_resonance", channel="drive"):
    """The speed loop is ill tuned and rings after each change; near actuator_lag."""

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(f=even(scene, 0.9, 1.6), zeta=even(scene, 0.12, 0.25))
        self.left = self.right = 0.0

    def motors(self, state: BaseState, left: float, right: float) -> tuple[float, float]:
        w0 = 2 * math.pi * self.parameters["f"]
        zeta = self.parameters["zeta"]
        self.left += STEP * (w0 * w0 * (left - state.rim_left) - 2 * zeta * w0 * self.left)
        self.right += STEP * (w0 * w0 * (right - state.rim_right) - 2 * zeta * w0 * self.right)
        return state.rim_left + STEP * self.left, state.rim_right + STEP * self.right


class LagAsymmetry(Effect, name="g_lagasym", channel="drive"):
    """Gains speed slowly, brakes at once; near actuator_lag."""

    def draw(self, scene: Scene) -> None:
        tau = scene.robot.tau
        self.parameters = rounded(up=tau + even(scene, 0.15, 0.35), down=tau * 0.5)

    def motors(self, state: BaseState, left: float, right: float) -> tuple[float, float]:
        return self._after(state.rim_left, left), self._after(state.rim_right, right)

    def _after(self, rim: float, target: float) -> float:
        """Return the rim speed [m/s] after a step."""
        gains = abs(target) > abs(rim) and target * rim >= 0
        return rim + follow(self.parameters["up" if gains else "down"]) * (target - rim)


law(
    "g_bursts",
    lambda scene: {"every": even(scene, 4, 7), "span": even(scene, 0.5, 0.8)},
    "drive",
    note="Under load commands wait in a queue for half a second, then act at once; near dead_time.",
    command_age=lambda p, t: max(0.0, float(p["span"] - t % p["every"])),
)


law(
    "g_powershare",
    lambda scene: {"k": even(scene, 0.5, 0.8)},
    "drive",
    note="Wheels share the power: the faster the turn, the slower it drives; near speed_saturation.",
    target=lambda p, state, v, omega: (
        v * (1 - p["k"] * min(1, 1.5 * abs(omega) / state.setup.robot.omega)), omega,
    ),
)  # fmt: skip


law(
    "g_slope",
    lambda scene: {"k": even(scene, 0.12, 0.2) * scene.robot.v, "dir": even(scene, -3, 3)},
    "drive",
    note="The floor is inclined: downhill it runs faster than told, uphill slower, and rolls when stopped; near none.",
    target=lambda p, state, v, omega: (v + p["k"] * math.cos(state.phi - p["dir"]), omega),
)


class Windup(Effect, name="g_windup", channel="drive"):
    """Stiction: wheels stay until the integrator has wound up, then overshoot; near
    dead_time/actuator_lag.
    """

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(wait=even(scene, 0.25, 0.45), over=even(scene, 0.25, 0.5))
        self.waited = [0.0, 0.0]
        self.over = [0.0, 0.0]

    def motors(self, state: BaseState, left: float, right: float) -> tuple[float, float]:
        share = follow(state.setup.robot.tau)
        return (self._after(0, state.rim_left, left, share), self._after(1, state.rim_right, right, share))

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
