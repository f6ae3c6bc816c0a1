"""Foreign effects of the pose reference."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from benchmarks.blind_buildings.draws import DEGREE, even, rounded, sign
from benchmarks.blind_buildings.effect import Effect
from benchmarks.blind_buildings.raycast import Floats
from benchmarks.blind_buildings.scene import OMEGA, STEP, TIME, Scene, V, pose_at


def episodes(rng: np.random.Generator, t: Floats, every: float, span: float) -> Floats:
    """Return how far each time [s] is into an episode [s], -1 outside; they come about every so often."""
    into = np.full(len(t), -1.0)
    begins = every * 0.5
    while begins < t[-1]:
        is_within = (t >= begins) & (t < begins + span)
        into[is_within] = t[is_within] - begins
        begins += every * rng.uniform(0.7, 1.3)
    return into


class Extrapolated(Effect):
    """Poses go on straight for a while."""

    name = "g_extrapolate"
    channel = "pose"
    note = "tracking is lost at times and the pose goes on with its last speed; near latency/wheel_slip"
    is_deterministic = False

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


class Lever(Effect):
    """Poses move against the acceleration."""

    name = "g_lever"
    channel = "pose"
    note = (
        "the marker stands on a soft pole: it leans with acceleration, its place moves against the robot; "
        "near mount_xy/latency"
    )
    is_deterministic = False

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


class MarkerSwap(Effect):
    """Poses jump by the same in the frame of the robot, for a while."""

    name = "g_markerswap"
    channel = "pose"
    note = (
        "two markers are confused at times: the pose jumps in the frame of the robot and turns; "
        "near mount_xy/mount_yaw"
    )
    is_deterministic = False

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


class Stale(Effect):
    """Poses stay for some frames."""

    name = "g_stale"
    channel = "pose"
    note = (
        "under load the reference repeats old poses under new stamps for some frames; "
        "near latency/pose_clock_offset"
    )
    is_deterministic = False

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
