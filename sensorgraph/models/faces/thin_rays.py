"""Thin rays among faces: tables, mixtures and likelihoods of many rays, computed by the kernels of `prediction`."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sensorgraph.models.distribution import Mixture
from sensorgraph.models.faces.data import FacesData
from sensorgraph.models.faces.prediction import (
    LaserBeams,
    draw_rays,
    list_rays,
    log_likelihood_rays,
    new_candidates,
    predict_rays,
)
from sensorgraph.models.faces.ray_march import CANDIDATE_SLOTS, BucketGrid
from sensorgraph.models.faces.visibility import ReturnNoise
from sensorgraph.types import Bools, Floats, Ints


def thin_table(
    model: FacesData, buckets: BucketGrid, poses: Floats, rays: Ints, which: int
) -> tuple[Floats, Bools]:
    """Return summaries (n_poses, n_rays, 6) as `mixture.summarise` does, and whether the rays lie in observed space."""
    table = np.empty((len(poses), len(rays), 6))
    supported = np.empty((len(poses), len(rays)), dtype=np.bool_)
    observed = model.observed.origin, model.observed.cell, model.observed.distance_to_unobserved
    predict_rays(beams_of(model, buckets, poses, rays), new_candidates(), observed, which, table, supported)
    return table, supported


def thin_mixtures(model: FacesData, buckets: BucketGrid, poses: Floats, rays: Ints) -> Mixture:
    """Return the mixtures of rays (n_rays,) at poses (n_poses, 3)."""
    shape = (len(poses), len(rays), CANDIDATE_SLOTS)
    means, weights, widths = np.full(shape, np.inf), np.zeros(shape), np.ones(shape)
    sources, survival = np.full(shape, -1), np.empty(shape[:2])
    beams, (work, _) = beams_of(model, buckets, poses, rays), new_candidates()
    most = max(list_rays(beams, work, means, weights, widths, sources, survival), 1)
    return Mixture(
        means=means[..., :most],
        weights=weights[..., :most],
        widths=widths[..., :most],
        sources=sources[..., :most],
        p_no_return=survival,
    )


def thin_likelihoods(
    model: FacesData, buckets: BucketGrid, ranges: Floats, poses: Floats, rays: Ints
) -> tuple[Floats, Bools]:
    """Return log-likelihoods (n_poses, n_rays) of readings (n_poses or 1, n_rays) [m], and which rays were observed."""
    out, supported = np.empty((len(poses), len(rays))), np.empty((len(poses), len(rays)), dtype=np.bool_)
    observed = model.observed.origin, model.observed.cell, model.observed.distance_to_unobserved
    log_likelihood_rays(
        beams_of(model, buckets, poses, rays), new_candidates(), observed, np.ascontiguousarray(ranges), model.sensor.range_min,
        out, supported,
    )  # fmt: skip
    return out, supported


def beams_of(
    model: FacesData, buckets: BucketGrid, poses: Floats, rays: Ints | slice, noise: ReturnNoise | None = None
) -> LaserBeams:
    """Return the input of the kernels for rays at poses (n_poses, 3); the noise is by default that of the model."""
    bearings, terms = model.sensor.bearings[rays], model.calibration.terms
    return LaserBeams(
        *lasers(poses, model.mount), np.cos(bearings), np.sin(bearings), model.sensor.range_max, model.faces,
        buckets, (noise or model.noise).array, terms.constant[rays], terms.slope[rays], terms.incidence,
        not terms.is_none,
    )  # fmt: skip


def lasers(poses: Floats, mount: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return x, y, cos and sin (n_poses,) of the poses of a laser mounted at `mount` (3,)."""
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    mx, my, yaw = mount
    x, y = poses[:, 0] + cos * mx - sin * my, poses[:, 1] + sin * mx + cos * my
    c, s = math.cos(yaw), math.sin(yaw)
    return x, y, cos * c - sin * s, sin * c + cos * s


def noise_of_poses(model: FacesData, sigma_xy: float | None, sigma_yaw: float | None) -> ReturnNoise:
    """Return the noise of returns from uncertain poses [m, rad]; None: as uncertain as those of the model's logs."""
    fitted, calibrated = model.noise, model.calibration
    xy = math.hypot(fitted.sigma_xy, calibrated.sigma_xy) if sigma_xy is None else sigma_xy
    yaw = math.hypot(fitted.sigma_yaw, calibrated.sigma_yaw) if sigma_yaw is None else sigma_yaw
    return replace(fitted, sigma_xy=xy, sigma_yaw=yaw)


def draw_thin_rays(
    model: FacesData, buckets: BucketGrid, poses: Floats, uniform: Floats, normal: Floats, rays: Ints | slice
) -> Floats:
    """Return one reading (n_poses, n_rays) [m] of rays at poses (n_poses, 3), as `Faces.draw` describes it."""
    out = np.empty(uniform.shape)
    beams = beams_of(model, buckets, poses, rays, noise_of_poses(model, 0.0, 0.0))
    uniform, normal = map(np.ascontiguousarray, (uniform, normal))  # the kernel is compiled for this layout
    draw_rays(beams, new_candidates(), uniform, normal, out)
    return out
