"""Foreign effects of what a driver makes of the readings."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from benchmarks.blind_buildings.draws import even, rounded
from benchmarks.blind_buildings.effect import Effect
from benchmarks.blind_buildings.raycast import Floats
from benchmarks.blind_buildings.scene import Rays, Scene


class Interpolated(Effect):
    """Rays between every k-th are made up."""

    name = "g_interp"
    note = "only every k-th ray is measured, the driver fills between by a line; near mixed_pixels"
    is_deterministic = False

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


class Median(Effect):
    """A median over neighbouring rays."""

    name = "g_median"
    note = (
        "the driver puts a wide median over each scan: thin things vanish, corners are cut; "
        "near missing_obstacle/mixed_pixels"
    )
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        least = {720: 41, 120: 9}.get(scene.robot.n_rays, 15)
        self.parameters = rounded(window=least + 2 * int(scene.rng.integers(0, 3)))

    def driver(self, rays: Rays, ranges: Floats) -> Floats:
        window = int(self.parameters["window"])
        return np.asarray(ndimage.median_filter(ranges, size=(1, window), mode="nearest"))


class Reversed(Effect):
    """Some scans run the other way."""

    name = "g_reversed"
    note = "for parts of the run the driver hands over rays in reverse order; nothing near"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        begins = even(scene, 0.2, 0.6) * scene.duration
        self.parameters = rounded(t=begins, span=even(scene, 0.06, 0.15) * scene.duration)

    def driver(self, rays: Rays, ranges: Floats) -> Floats:
        begins, span = self.parameters["t"], self.parameters["span"]
        is_turned = (rays.scan_times > begins) & (rays.scan_times < begins + span)
        return np.where(is_turned[:, None], ranges[:, ::-1], ranges)


class Disparity(Effect):
    """The inverse of range comes in steps."""

    name = "g_disparity"
    note = (
        "triangulating laser: 1/r is in steps, so the lattice coarsens with the square of range; "
        "near quantisation/range_noise"
    )
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        middle = np.quantile(scene.hits.ranges, 0.6)
        self.parameters = {"step": round(5.0 * scene.robot.sigma / middle**2, 6)}

    def driver(self, rays: Rays, ranges: Floats) -> Floats:
        step = self.parameters["step"]
        is_hit = np.isfinite(ranges) & (ranges > 0)
        disparity = np.round(1 / np.where(is_hit, ranges, 1) / step)
        return np.where(is_hit, 1 / np.maximum(disparity, 0.5) / step, ranges)


class PacketShift(Effect):
    """Where rays are missing, those after them take their places."""

    name = "g_packetshift"
    note = "a lost packet moves all later rays of that scan forward by its length; near mount_yaw"
    is_deterministic = False

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


class Average(Effect):
    """Each ray is smoothed over the scans."""

    name = "g_average"
    note = "the sensor averages each ray over the last scans; near latency/mixed_pixels"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(a=even(scene, 0.35, 0.55))

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
