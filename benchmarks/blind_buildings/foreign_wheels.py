"""Foreign effects of wheels, floor and odometry."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from benchmarks.blind_buildings.draws import DEGREE, even, rounded, sign
from benchmarks.blind_buildings.effect import Effect
from benchmarks.blind_buildings.raycast import Floats
from benchmarks.blind_buildings.scene import STEP, BaseState, Odometry, Scene

BUMP_STEPS = 25
"""Steps of the base that a bump lasts."""
BUMP_SEED = 7


class Tyre(Effect):
    """One wheel shrinks steadily."""

    name = "g_tyre"
    channel = "odometry"
    note = "the left tyre loses pressure during the run; near wheel_radius_diff/wheel_radius"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(s=even(scene, 0.03, 0.06), side=sign(scene))

    def ground(self, state: BaseState, left: float, right: float) -> tuple[float, float]:
        size = 1 - self.parameters["s"] * state.t / state.setup.duration
        return (left * size, right) if self.parameters["side"] > 0 else (left, right * size)


class Payload(Effect):
    """Both wheels are smaller for a while."""

    name = "g_payload"
    channel = "odometry"
    note = "a load is taken on and put off: both tyres sag, one more, in between; near wheel_radius(_diff)"
    is_deterministic = False

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


class Joints(Effect):
    """Each line of a square lattice turns the body by a little, left or right."""

    name = "g_joints"
    channel = "odometry"
    note = (
        "bumps at joints of the floor kick the heading whenever one is crossed; "
        "near wheel_radius_diff/wheel_slip"
    )
    is_deterministic = False

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


class Scrub(Effect):
    """The body turns less, the less it drives ahead."""

    name = "g_scrub"
    channel = "odometry"
    note = "wide tyres scrub: the effective base is larger the tighter the turn; near wheel_base"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(k=even(scene, 0.1, 0.22))

    def body(self, state: BaseState, v: float, omega: float) -> tuple[float, float, float]:
        rim = abs(omega) * state.setup.robot.track / 2
        tight = rim / (rim + abs(v) + 1e-6)
        return v, 0.0, omega / (1 + self.parameters["k"] * tight**2)


class TurnAsymmetry(Effect):
    """Turns to the left are counted too large, those to the right too small."""

    name = "g_turnasym"
    channel = "odometry"
    note = (
        "a gyro with another scale to the left than to the right makes the heading; "
        "near wheel_base/wheel_radius_diff"
    )
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        left = even(scene, 0.02, 0.05)
        self.parameters = rounded(left=left, right=-even(scene, 0.5, 1.0) * left)

    def increments(self, way: Floats, turn: Floats) -> tuple[Floats, Floats]:
        left, right = 1 + self.parameters["left"], 1 + self.parameters["right"]
        return way, turn * np.where(turn > 0, left, right)


class Crab(Effect):
    """The body goes ahead and a little aside."""

    name = "g_crab"
    channel = "odometry"
    note = "the axle is askew in the frame, the robot goes slightly sideways; near none (mount_yaw with mount_xy)"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(angle=sign(scene) * even(scene, 3.0, 6.0) * DEGREE)

    def body(self, state: BaseState, v: float, omega: float) -> tuple[float, float, float]:
        angle = self.parameters["angle"]
        return v * math.cos(angle), v * math.sin(angle), omega


class Gaps(Effect):
    """Travel is lost every few seconds."""

    name = "g_gaps"
    channel = "odometry"
    note = "bursts of lost encoder packets: the way in between is never counted; near wheel_slip/wheel_radius"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(every=even(scene, 4, 7), span=even(scene, 0.25, 0.45))

    def encoders(self, t: Floats, travel: Floats) -> Floats:
        steps = np.diff(travel, axis=0, prepend=travel[:1])
        steps[np.mod(t, self.parameters["every"]) < self.parameters["span"]] = 0
        return np.asarray(travel[0] + np.cumsum(steps, axis=0))


class SlewedClock(Effect):
    """The age of odometry is a saw tooth."""

    name = "g_ntp"
    channel = "odometry"
    note = (
        "the base computer is slewed by NTP: its clock runs off and is pulled back, over and over; "
        "near pose_clock_offset"
    )
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(rate=even(scene, 0.004, 0.008), every=even(scene, 14, 25))

    def read_times(self, t: Floats) -> Floats:
        every = self.parameters["every"]
        share = np.mod(t, every) / every
        tooth = np.where(share < 0.75, share / 0.75, (1 - share) / 0.25)
        return np.asarray(t - tooth * self.parameters["rate"] * every)


class YawSteps(Effect):
    """The heading of the odometry comes in coarse steps."""

    name = "g_yawsteps"
    channel = "odometry"
    note = "the base adds up its way along a heading held in steps of several degrees; near wheel_radius_diff"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(step=even(scene, 7, 12) * DEGREE)

    def odometry(self, odometry: Odometry) -> Odometry:
        step = self.parameters["step"]
        heading = np.floor(odometry.poses[:, 2] / step) * step
        way = odometry.twists[:, 0] * (1 / self.scene.robot.odom_rate)
        x, y = np.cumsum(way * np.cos(heading)), np.cumsum(way * np.sin(heading))
        return dataclasses.replace(odometry, poses=np.column_stack([x, y, heading]))
