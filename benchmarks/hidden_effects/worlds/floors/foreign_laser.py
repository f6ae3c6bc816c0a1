"""Effects outside the library: the laser, its mast, mirror, clock and receiver, and its driver."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from scipy import ndimage

from benchmarks.hidden_effects.log import Booleans, Floats
from benchmarks.hidden_effects.worlds.floors.effect import Effect, Mount, even, law, rounded, sign
from benchmarks.hidden_effects.worlds.floors.placing import dip
from benchmarks.hidden_effects.worlds.floors.scene import OMEGA, STEP, TIME, Rays, Scene, V


class Mast(Effect, name="g_mast"):
    """Laser on a flexible mast swings with the acceleration; near mount_xy/latency."""

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(
            f=even(scene, 1.0, 1.8),
            zeta=even(scene, 0.06, 0.14),
            gain=even(scene, 2.5, 4.0) * (1 if scene.robot.v > 0.4 else 1.8),
            twist=even(scene, 0.8, 1.6),
        )

    def mount(self, taken: Floats, mount: Mount) -> Mount:
        swing = self._swing()
        x, y, yaw = (np.interp(taken, self.scene.run[:, TIME], swing[:, k]) for k in range(3))
        self.parameters["rms"] = round(float(np.hypot(x, y).std()), 4)
        return mount[0] + x, mount[1] + y, mount[2] + np.clip(0.35 * yaw, -0.1, 0.1)

    def _swing(self) -> Floats:
        """Return how far the laser is off (n, 3) [m, m] and in yaw, every `STEP`."""
        run = self.scene.run
        along = np.gradient(run[:, V], STEP)
        across = run[:, V] * run[:, OMEGA]
        turning = np.gradient(run[:, OMEGA], STEP)
        driven = np.column_stack([along, across, turning * self.parameters["twist"]])
        w0 = 2 * math.pi * self.parameters["f"]
        zeta, gain = self.parameters["zeta"], self.parameters["gain"]
        swing = np.zeros((len(run), 3))
        off, speed = np.zeros(3), np.zeros(3)
        for i in range(len(run)):
            speed = speed + STEP * (-gain * driven[i] - 2 * zeta * w0 * speed - w0 * w0 * off)
            off = off + STEP * speed
            swing[i] = off
        return swing


def _finite(rays: Rays, otherwise: float = 0.0) -> Floats:
    return np.where(np.isfinite(rays.ranges), rays.ranges, otherwise)


law(
    "g_wrap",
    lambda scene: {"R": np.quantile(scene.hits.ranges, even(scene, 0.85, 0.95))},
    note="Phase-shift laser: ranges beyond the ambiguity read r - R; near max_range/random_outliers.",
    ideal=lambda p, rays: np.where(np.isfinite(rays.ranges), np.mod(_finite(rays), p["R"]), rays.ranges),
)


class Restart(Effect, name="g_restart"):
    """Sensor restarts: silence of 2-3 s, then another offset and angle zero; near range_bias/mount_yaw."""

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(
            t=even(scene, 0.35, 0.7) * scene.duration,
            b=sign(scene) * even(scene, 0.025, 0.05),
            yaw=sign(scene) * even(scene, 0.006, 0.015),
            dead=even(scene, 2, 3),
        )

    def ideal(self, rays: Rays) -> None:
        rays.ranges = rays.ranges + (rays.taken > self.parameters["t"]) * self.parameters["b"]

    def bearing(self, taken: Floats, bearings: Floats) -> Floats:
        return np.asarray(bearings + (taken > self.parameters["t"]) * self.parameters["yaw"])

    def outages(self, kept: Booleans) -> Booleans:
        t = np.arange(len(kept)) / self.scene.robot.scan_rate
        begins = self.parameters["t"] - 0.6
        return np.asarray(kept & ~((t > begins) & (t < begins + self.parameters["dead"])))


class EndStamp(Effect, name="g_endstamp"):
    """Scans are stamped when complete and the rotor speed wanders, so their age varies; near
    latency/scan_skew.
    """

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(
            mean=max(0.09, 1.1 * scene.robot.sweep_time),
            swing=even(scene, 0.4, 0.7),
            period=even(scene, 5, 14),
        )

    def times(self, taken: Floats) -> Floats:
        first = taken[:, :1]
        wander = np.sin(2 * np.pi * first / self.parameters["period"])
        age = self.parameters["mean"] * (1 + self.parameters["swing"] * wander)
        share = np.arange(taken.shape[1])[None] / taken.shape[1]
        return np.asarray(first - age * (1 - share))


law(
    "g_square",
    lambda scene: {
        "c": sign(scene) * even(scene, 3.5, 6) * scene.robot.sigma / np.quantile(scene.hits.ranges, 0.75) ** 2
    },
    note="Triangulating laser with a bent baseline: z = r + c r^2; near range_scale.",
    ideal=lambda p, rays: rays.ranges + p["c"] * _finite(rays) * _finite(rays),
)


class Facets(Effect, name="g_facets"):
    """Polygon mirror: each of its facets has its own range offset, scan by scan in turn; near range_noise."""

    def draw(self, scene: Scene) -> None:
        offsets = scene.rng.uniform(-1, 1, int(scene.rng.integers(3, 6)))
        offsets = (offsets - offsets.mean()) / offsets.std() * even(scene, 2.8, 4.5) * scene.robot.sigma
        self.offsets = offsets
        self.parameters = {f"b{i}": round(float(offset), 4) for i, offset in enumerate(offsets)}

    def ideal(self, rays: Rays) -> None:
        facet = np.arange(len(rays.ranges)) % len(self.offsets)
        rays.ranges = rays.ranges + self.offsets[facet][:, None]


law(
    "g_nearbias",
    lambda scene: {"A": even(scene, 0.08, 0.14), "L": np.quantile(scene.hits.ranges, even(scene, 0.25, 0.5))},
    note="Strong echoes of near walls trigger early (walk error): z = r - A exp(-r/L) cos; near range_bias/range_scale.",
    ideal=lambda p, rays: rays.ranges - p["A"] * np.exp(-_finite(rays, 99) / p["L"]) * rays.cosine,
)


def _draw_band(scene: Scene) -> Mapping[str, float]:
    share = even(scene, 0.3, 0.7)
    near, far = np.quantile(scene.hits.ranges, [share, share + even(scene, 0.05, 0.12)])
    return {"r1": near, "r2": far}


law(
    "g_blanking",
    _draw_band,
    note="The receiver is blind for a band of ranges: no returns between r1 and r2; near max_range/min_range/black_surface.",
    noisy=lambda p, rays, ranges: np.where((ranges > p["r1"]) & (ranges < p["r2"]), np.inf, ranges),
)


class Pitch(Effect, name="g_pitch"):
    """The soft robot nods with its acceleration: the plane meets the floor when it brakes; near
    tilt/people.
    """

    def draw(self, scene: Scene) -> None:
        gains = np.gradient(scene.run[:, V], STEP)
        self.softness = 1 / max(0.12, np.quantile(np.abs(gains), 0.93))
        far = np.quantile(scene.hits.ranges, 0.75)
        angle = even(scene, 1.2, 1.8) * math.asin(min(0.2, scene.robot.height / far))
        self.parameters = rounded(pitch=angle)

    def meet(self, rays: Rays) -> None:
        run = self.scene.run
        gains = ndimage.gaussian_filter1d(np.gradient(run[:, V], STEP), 40)
        angles = -gains * self.softness * self.parameters["pitch"]
        robot = self.scene.robot
        dip(rays, np.interp(rays.taken, run[:, TIME], angles), -robot.mount[2], robot.height)


class Interpolated(Effect, name="g_interp"):
    """Only every k-th ray is measured, the driver fills between by a line; near mixed_pixels."""

    def draw(self, scene: Scene) -> None:
        low, high = {720: (12, 18), 120: (4, 6)}.get(scene.robot.n_rays, (5, 8))
        self.parameters = rounded(k=int(scene.rng.integers(low, high)))

    def driver(self, rays: Rays, ranges: Floats) -> Floats:
        n = ranges.shape[1]
        measured = np.arange(0, n, int(self.parameters["k"]))
        if measured[-1] != n - 1:
            measured = np.append(measured, n - 1)
        told = ranges.copy()
        for row, line in zip(told, ranges[:, measured], strict=True):
            is_hit = np.isfinite(line)
            if is_hit.sum() > 2:
                row[:] = np.round(np.interp(np.arange(n), measured[is_hit], line[is_hit]), 3)
        return told


law(
    "g_median",
    lambda scene: {
        "window": {720: 41, 120: 9}.get(scene.robot.n_rays, 15) + 2 * int(scene.rng.integers(0, 3))
    },
    note="The driver puts a wide median over each scan: thin things vanish, corners are cut; near missing_obstacle/mixed_pixels.",
    driver=lambda p, rays, ranges: ndimage.median_filter(ranges, size=(1, int(p["window"])), mode="nearest"),
)


class Reversed(Effect, name="g_reversed"):
    """For parts of the run the driver hands over rays in reverse order; nothing near."""

    def draw(self, scene: Scene) -> None:
        begins = even(scene, 0.2, 0.6) * scene.duration
        self.parameters = rounded(t=begins, span=even(scene, 0.06, 0.15) * scene.duration)

    def driver(self, rays: Rays, ranges: Floats) -> Floats:
        begins, span = self.parameters["t"], self.parameters["span"]
        is_turned = (rays.scan_times > begins) & (rays.scan_times < begins + span)
        return np.where(is_turned[:, None], ranges[:, ::-1], ranges)


class Disparity(Effect, name="g_disparity"):
    """Triangulating laser: 1/r is in steps, so the lattice coarsens with the square of range; near
    quantisation/range_noise.
    """

    def draw(self, scene: Scene) -> None:
        middle = np.quantile(scene.hits.ranges, 0.6)
        self.parameters = {"step": round(5.0 * scene.robot.sigma / middle**2, 6)}

    def driver(self, rays: Rays, ranges: Floats) -> Floats:
        step = self.parameters["step"]
        is_hit = np.isfinite(ranges) & (ranges > 0)
        disparity = np.round(1 / np.where(is_hit, ranges, 1) / step)
        return np.where(is_hit, 1 / np.maximum(disparity, 0.5) / step, ranges)


class PacketShift(Effect, name="g_packetshift"):
    """A lost packet moves all later rays of that scan forward by its length; near mount_yaw."""

    def draw(self, scene: Scene) -> None:
        share = even(scene, 0.15, 0.35)
        length = max(4, scene.robot.n_rays // int(scene.rng.integers(12, 24)))
        self.parameters = rounded(share=share, rays=length)

    def driver(self, rays: Rays, ranges: Floats) -> Floats:
        told = ranges.copy()
        length, n = int(self.parameters["rays"]), ranges.shape[1]
        for before, after in zip(ranges, told, strict=True):
            if rays.rng.random() < self.parameters["share"]:
                i = int(rays.rng.integers(0, n - 2 * length))
                after[i : n - length] = before[i + length :]
                after[n - length :] = np.inf
        return told


class Average(Effect, name="g_average", a=(0.35, 0.55)):
    """The sensor averages each ray over the last scans; near latency/mixed_pixels."""

    def driver(self, rays: Rays, ranges: Floats) -> Floats:
        share = self.parameters["a"]
        told = ranges.copy()
        mean = ranges[0].copy()
        for n in range(1, len(ranges)):
            is_known = np.isfinite(ranges[n]) & np.isfinite(mean)
            old, new = np.where(is_known, mean, 0), np.where(is_known, ranges[n], 0)
            mean = np.where(is_known, (1 - share) * old + share * new, ranges[n])
            told[n] = np.round(mean, 3)
        return told
