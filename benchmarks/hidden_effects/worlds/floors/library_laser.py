"""Effects of the library: the laser itself, and its mounting and clock."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from benchmarks.hidden_effects.log import Booleans, Floats
from benchmarks.hidden_effects.worlds.floors.effect import DEGREE, Effect, law, rounded, sector, signed, size
from benchmarks.hidden_effects.worlds.floors.placing import dip
from benchmarks.hidden_effects.worlds.floors.scene import Rays, Scene, meet_walls

N_BEAM = 13
N_CONE = 41
"""Rays of a wide beam, and of a cone."""
Parameters = Mapping[str, float]

law("range_bias", lambda scene: {"b": signed(scene, 0.005)}, ideal=lambda p, rays: rays.ranges + p["b"])
law(
    "range_scale", lambda scene: {"s": signed(scene, 0.002)}, ideal=lambda p, rays: rays.ranges * (1 + p["s"])
)


def _noisier(p: Parameters, rays: Rays, ranges: Floats) -> Floats:
    """Add noise that grows with range."""
    true = np.where(np.isfinite(rays.ranges), rays.ranges, 0)
    return np.where(np.isfinite(ranges), ranges + p["k"] * true * rays.spare_noise, ranges)


law("range_noise", lambda scene: {"k": size(scene, 0.0025)}, noisy=_noisier)


def _in_sector(p: Parameters, rays: Rays) -> Booleans:
    return np.asarray((rays.nominal >= p["theta1"]) & (rays.nominal <= p["theta2"]))


def _draw_bias(scene: Scene) -> Parameters:
    first, last = sector(scene, scene.rng.uniform(18, 55) * DEGREE)
    return {"theta1": first, "theta2": last, "b": signed(scene, 0.006)}


def _draw_occlusion(scene: Scene) -> Parameters:
    width = max(2.2 * scene.robot.ray_step, scene.rng.uniform(4, 16) * DEGREE)
    first, last = sector(scene, width)
    return {"theta1": first, "theta2": last, "r0": scene.rng.uniform(scene.robot.range_min + 0.04, 0.32)}


law("sector_bias", _draw_bias, ideal=lambda p, rays: rays.ranges + _in_sector(p, rays) * p["b"])
law(
    "self_occlusion",
    _draw_occlusion,
    ideal=lambda p, rays: np.where(_in_sector(p, rays), np.minimum(rays.ranges, p["r0"]), rays.ranges),
)


def _draw_shift(scene: Scene) -> Parameters:
    shift, angle = size(scene, 0.005), scene.rng.uniform(-math.pi, math.pi)
    return {"dx": shift * math.cos(angle), "dy": shift * math.sin(angle)}


law(
    "mount_yaw",
    lambda scene: {"delta": signed(scene, 0.00175)},
    mount=lambda p, taken, mount: (*mount[:2], mount[2] + p["delta"]),
)
law("mount_xy", _draw_shift, mount=lambda p, taken, mount: (mount[0] + p["dx"], mount[1] + p["dy"], mount[2]))
law("latency", lambda scene: {"tau": size(scene, 0.005, 2.2)}, times=lambda p, taken: taken - p["tau"])
law(
    "scan_skew",
    lambda scene: {"T": size(scene, 0.01, 2.2)},
    times=lambda p, taken: taken + p["T"] * np.arange(taken.shape[1])[None] / taken.shape[1],
)


def _mean_of_beam(p: Parameters, rays: Rays) -> Floats:
    """Return the mean of what a wide beam meets."""
    met = [rays.ranges]
    for share in np.linspace(-1, 1, N_BEAM):
        if share:
            met.append(meet_walls(rays.starts, rays.directions + share * p["gamma"], rays.walls).ranges)
    return np.asarray(np.mean(met, 0))


def _nearest_of_cone(p: Parameters, rays: Rays) -> Floats:
    """Return the nearest of what a wide cone meets not too obliquely."""
    nearest = np.full(rays.ranges.shape, np.inf)
    for share in np.linspace(-1, 1, N_CONE):
        hits = meet_walls(rays.starts, rays.directions + share * p["gamma"], rays.walls)
        is_back = np.arccos(np.clip(hits.cosine, 0, 1)) <= p["alpha_max"]
        nearest = np.minimum(nearest, np.where(is_back, hits.ranges, np.inf))
    return nearest


law("mixed_pixels", lambda scene: {"gamma": size(scene, 0.00209, 2.2)}, ideal=_mean_of_beam)
law(
    "sonar_cone",
    lambda scene: {
        "gamma": scene.rng.uniform(6, 16) * DEGREE,
        "alpha_max": scene.rng.uniform(18, 45) * DEGREE,
    },
    ideal=_nearest_of_cone,
)


def _draw_incidence(scene: Scene) -> Parameters:
    cosine = scene.hits.cosine[np.isfinite(scene.hits.ranges)]
    share = 1 - scene.rng.uniform(0.025, 0.2)
    return {"alpha_max": float(np.quantile(np.arccos(np.clip(cosine, 0, 1)), share))}


def _draw_farthest(scene: Scene) -> Parameters:
    far = np.quantile(scene.hits.ranges, 1 - scene.rng.uniform(0.03, 0.3))
    return {"R": min(0.95 * scene.robot.range_max, float(far))}


law(
    "incidence_dropout",
    _draw_incidence,
    ideal=lambda p, rays: np.where(rays.incidence() > p["alpha_max"], np.inf, rays.ranges),
)
law("max_range", _draw_farthest, noisy=lambda p, rays, ranges: np.where(ranges > p["R"], np.inf, ranges))


class MinRange(Effect, name="min_range"):
    """The laser does not see as near as stated."""

    def draw(self, scene: Scene) -> None:
        near = np.quantile(scene.hits.ranges, scene.rng.uniform(0.02, 0.12))
        self.parameters = rounded(r_min=max(scene.robot.range_min + 0.08, near))
        self.told = scene.rng.choice([np.inf, -np.inf])

    def driver(self, rays: Rays, ranges: Floats) -> Floats:
        return np.where(ranges < self.parameters["r_min"], self.told, ranges)


law(
    "quantisation",
    lambda scene: {"q": round(scene.rng.uniform(2.5, 7) * scene.robot.sigma, 3)},
    driver=lambda p, rays, ranges: np.where(np.isfinite(ranges), np.round(ranges / p["q"]) * p["q"], ranges),
)


def _draw_drift(scene: Scene) -> Parameters:
    drift = signed(scene, 0.006)
    return {"b1": drift, "tau": 0.0 if scene.rng.random() < 0.6 else scene.rng.uniform(8, 25)}


def _drifted(p: Parameters, rays: Rays) -> Floats:
    """Let ranges drift during the run, evenly or while the sensor warms up."""
    t, tau = rays.taken - rays.scan_times[0], p["tau"]
    share = 1 - np.exp(-t / tau) if tau else t / (rays.scan_times[-1] - rays.scan_times[0])
    return np.asarray(rays.ranges + p["b1"] * share)


law("range_drift", _draw_drift, ideal=_drifted)


class Tilt(Effect, name="tilt"):
    """The plane of the laser dips, and meets the floor."""

    def draw(self, scene: Scene) -> None:
        far = np.quantile(scene.hits.ranges, scene.rng.uniform(0.6, 0.93))
        bearings = scene.robot.bearings
        self.parameters = rounded(
            beta=math.asin(min(0.3, scene.robot.height / far)),
            theta0=scene.rng.uniform(0.7 * bearings[0], 0.7 * bearings[-1]),
        )

    def meet(self, rays: Rays) -> None:
        dip(rays, self.parameters["beta"], self.parameters["theta0"], self.scene.robot.height)


class RandomOutliers(Effect, name="random_outliers"):
    """Some readings are anything."""

    def draw(self, scene: Scene) -> None:
        self.parameters = rounded(p=size(scene, 0.002, 2.5))

    def noisy(self, rays: Rays, ranges: Floats) -> Floats:
        is_out = rays.rng.random(ranges.shape) < self.parameters["p"]
        return np.where(is_out, rays.rng.random(ranges.shape) * self.scene.robot.range_max, ranges)
