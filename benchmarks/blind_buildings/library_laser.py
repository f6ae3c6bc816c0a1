"""Effects of the library: the laser itself, and its mounting and clock."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.blind_buildings.draws import DEGREE, rounded, sector, sign, size
from benchmarks.blind_buildings.effect import Effect, Mount
from benchmarks.blind_buildings.placing import dip
from benchmarks.blind_buildings.raycast import Booleans, Floats, meet_walls
from benchmarks.blind_buildings.scene import Rays, Scene

N_BEAM = 13
N_CONE = 41
"""Rays of a wide beam, and of a cone."""


class RangeBias(Effect):
    """All ranges are off by the same."""

    name = "range_bias"

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(b=sign(scene) * size(scene, 0.005))

    def ideal(self, rays: Rays) -> None:
        rays.ranges = rays.ranges + self.parameters["b"]


class RangeScale(Effect):
    """All ranges are off by the same share."""

    name = "range_scale"

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(s=sign(scene) * size(scene, 0.002))

    def ideal(self, rays: Rays) -> None:
        rays.ranges = rays.ranges * (1 + self.parameters["s"])


class RangeNoise(Effect):
    """Noise that grows with range."""

    name = "range_noise"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(k=size(scene, 0.0025))

    def noisy(self, rays: Rays, ranges: Floats) -> Floats:
        true = np.where(np.isfinite(rays.ranges), rays.ranges, 0)
        noise = self.parameters["k"] * true * rays.spare_noise
        return np.where(np.isfinite(ranges), ranges + noise, ranges)


class OfSector(Effect):
    """An effect of some bearings."""

    def hit(self, rays: Rays) -> Booleans:
        """Return which rays it acts on."""
        first, last = self.parameters["theta1"], self.parameters["theta2"]
        return np.asarray((rays.nominal >= first) & (rays.nominal <= last))


class SectorBias(OfSector):
    """Ranges of a sector are off."""

    name = "sector_bias"

    def draw(self, scene: Scene) -> None:
        first, last = sector(scene, scene.rng.uniform(18, 55) * DEGREE)
        self.parameters = rounded(theta1=first, theta2=last, b=sign(scene) * size(scene, 0.006))

    def ideal(self, rays: Rays) -> None:
        rays.ranges = rays.ranges + self.hit(rays) * self.parameters["b"]


class SelfOcclusion(OfSector):
    """A part of the robot stands in the way."""

    name = "self_occlusion"

    def draw(self, scene: Scene) -> None:
        width = max(2.2 * scene.robot.ray_step, scene.rng.uniform(4, 16) * DEGREE)
        first, last = sector(scene, width)
        nearest = scene.rng.uniform(scene.robot.range_min + 0.04, 0.32)
        self.parameters = rounded(theta1=first, theta2=last, r0=nearest)

    def ideal(self, rays: Rays) -> None:
        short = np.minimum(rays.ranges, self.parameters["r0"])
        rays.ranges = np.where(self.hit(rays), short, rays.ranges)


class MountYaw(Effect):
    """The laser is turned on the robot."""

    name = "mount_yaw"

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(delta=sign(scene) * size(scene, 0.00175))

    def mount(self, taken: Floats, mount: Mount) -> Mount:
        x, y, yaw = mount
        return x, y, yaw + self.parameters["delta"]


class MountXY(Effect):
    """The laser is shifted on the robot."""

    name = "mount_xy"

    def draw(self, scene: Scene) -> None:
        shift, angle = size(scene, 0.005), scene.rng.uniform(-math.pi, math.pi)
        self.parameters = rounded(dx=shift * math.cos(angle), dy=shift * math.sin(angle))

    def mount(self, taken: Floats, mount: Mount) -> Mount:
        x, y, yaw = mount
        return x + self.parameters["dx"], y + self.parameters["dy"], yaw


class Latency(Effect):
    """Scans are older than their stamps say."""

    name = "latency"

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(tau=size(scene, 0.005, 2.2))

    def times(self, taken: Floats) -> Floats:
        return np.asarray(taken - self.parameters["tau"])


class ScanSkew(Effect):
    """A sweep takes longer than stated."""

    name = "scan_skew"

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(T=size(scene, 0.01, 2.2))

    def times(self, taken: Floats) -> Floats:
        n = taken.shape[1]
        return np.asarray(taken + self.parameters["T"] * np.arange(n)[None] / n)


class MixedPixels(Effect):
    """A wide beam tells the mean of what it meets."""

    name = "mixed_pixels"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(gamma=size(scene, 0.00209, 2.2))

    def ideal(self, rays: Rays) -> None:
        met = [rays.ranges]
        for share in np.linspace(-1, 1, N_BEAM):
            if share:
                directions = rays.directions + share * self.parameters["gamma"]
                met.append(meet_walls(rays.starts, directions, rays.walls).ranges)
        rays.ranges = np.mean(met, 0)


class SonarCone(Effect):
    """A wide cone tells the nearest of what it meets not too obliquely."""

    name = "sonar_cone"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        gamma = scene.rng.uniform(6, 16) * DEGREE
        self.parameters = rounded(gamma=gamma, alpha_max=scene.rng.uniform(18, 45) * DEGREE)

    def ideal(self, rays: Rays) -> None:
        nearest = np.full(rays.ranges.shape, np.inf)
        for share in np.linspace(-1, 1, N_CONE):
            directions = rays.directions + share * self.parameters["gamma"]
            hits = meet_walls(rays.starts, directions, rays.walls)
            is_back = np.arccos(np.clip(hits.cosine, 0, 1)) <= self.parameters["alpha_max"]
            nearest = np.minimum(nearest, np.where(is_back, hits.ranges, np.inf))
        rays.ranges = nearest


class IncidenceDropout(Effect):
    """Nothing comes back from a surface that is met too obliquely."""

    name = "incidence_dropout"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        cosine = scene.hits.cosine[np.isfinite(scene.hits.ranges)]
        share = 1 - scene.rng.uniform(0.025, 0.2)
        self.parameters = rounded(alpha_max=np.quantile(np.arccos(np.clip(cosine, 0, 1)), share))

    def ideal(self, rays: Rays) -> None:
        is_lost = rays.incidence() > self.parameters["alpha_max"]
        rays.ranges = np.where(is_lost, np.inf, rays.ranges)


class MaxRange(Effect):
    """The laser does not see as far as stated."""

    name = "max_range"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        far = np.quantile(scene.hits.ranges, 1 - scene.rng.uniform(0.03, 0.3))
        self.parameters = rounded(R=min(0.95 * scene.robot.range_max, far))

    def noisy(self, rays: Rays, ranges: Floats) -> Floats:
        return np.where(ranges > self.parameters["R"], np.inf, ranges)


class MinRange(Effect):
    """The laser does not see as near as stated."""

    name = "min_range"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        near = np.quantile(scene.hits.ranges, scene.rng.uniform(0.02, 0.12))
        self.parameters = rounded(r_min=max(scene.robot.range_min + 0.08, near))
        self.told = scene.rng.choice([np.inf, -np.inf])

    def driver(self, rays: Rays, ranges: Floats) -> Floats:
        return np.where(ranges < self.parameters["r_min"], self.told, ranges)


class Quantisation(Effect):
    """Ranges come in coarse steps."""

    name = "quantisation"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(q=round(scene.rng.uniform(2.5, 7) * scene.robot.sigma, 3))

    def driver(self, rays: Rays, ranges: Floats) -> Floats:
        step = self.parameters["q"]
        return np.where(np.isfinite(ranges), np.round(ranges / step) * step, ranges)


class RangeDrift(Effect):
    """Ranges drift during the run, evenly or while the sensor warms up."""

    name = "range_drift"

    def draw(self, scene: Scene) -> None:
        drift = sign(scene) * size(scene, 0.006)
        tau = 0.0 if scene.rng.random() < 0.6 else scene.rng.uniform(8, 25)
        self.parameters = rounded(b1=drift, tau=tau)

    def ideal(self, rays: Rays) -> None:
        t = rays.taken - rays.scan_times[0]
        tau = self.parameters["tau"]
        share = 1 - np.exp(-t / tau) if tau else t / (rays.scan_times[-1] - rays.scan_times[0])
        rays.ranges = rays.ranges + self.parameters["b1"] * share


class Tilt(Effect):
    """The plane of the laser dips, and meets the floor."""

    name = "tilt"

    def draw(self, scene: Scene) -> None:
        far = np.quantile(scene.hits.ranges, scene.rng.uniform(0.6, 0.93))
        bearings = scene.robot.bearings
        self.parameters = rounded(
            beta=math.asin(min(0.3, scene.robot.height / far)),
            theta0=scene.rng.uniform(0.7 * bearings[0], 0.7 * bearings[-1]),
        )

    def meet(self, rays: Rays) -> None:
        dip(rays, self.parameters["beta"], self.parameters["theta0"], self.scene.robot.height)


class RandomOutliers(Effect):
    """Some readings are anything."""

    name = "random_outliers"
    is_deterministic = False

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(p=size(scene, 0.002, 2.5))

    def noisy(self, rays: Rays, ranges: Floats) -> Floats:
        is_out = rays.rng.random(ranges.shape) < self.parameters["p"]
        return np.where(is_out, rays.rng.random(ranges.shape) * self.scene.robot.range_max, ranges)
