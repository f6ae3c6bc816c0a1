"""Fit of faces to readings of cones: search among unexplained readings, refine all stretches, repeat."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from logs.run import RangeSensor
from planners.groups import members
from sensorgraph.models.cones.kernels import END_BLUR
from sensorgraph.models.cones.readings import ConeReadings
from sensorgraph.models.cones.refine import Refiner
from sensorgraph.models.cones.search import search
from sensorgraph.models.cones.settings import CONES
from sensorgraph.models.faces.observed_space import ObservedSpace
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.reduction import RaySample
from sensorgraph.models.faces.settings import FACES
from sensorgraph.models.faces.visibility import FIT_SIGMAS, PRIOR_CROSSINGS, PRIOR_STOPS, ReturnNoise
from sensorgraph.robust import robust_sigma
from sensorgraph.types import Floats, Progress

logger = logging.getLogger(__name__)

MAX_READINGS = 100_000
"""Maximum number of readings used by the fit; of more readings, every n-th is used."""
ROUNDS = 3
"""Rounds of searching among unexplained readings and refining all stretches."""
READINGS_AT_A_TIME = 1 << 17
"""Number of readings whose cones are sampled with rays at a time."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedCones:
    """Result of `fit_cones`."""

    faces: FaceSet
    """Faces with one stretch each."""
    noise: ReturnNoise
    hits: Floats
    """(n_faces,) number of returns that each face explains, of `n_readings`."""
    n_readings: int
    observed: ObservedSpace


def readings_of_cones(sample: RaySample, sensor: RangeSensor, mount: Floats) -> ConeReadings:
    """Return the readings of a sample from sensors mounted at `mount` (3,)."""
    rays = sample.rays(sensor, mount)
    return ConeReadings(
        origins=rays.origins,
        directions=rays.directions,
        halves=0.5 * sensor.cones[sample.beams],
        ranges=rays.ranges,
        range_max=rays.range_max,
    )


def fit_cones(readings: ConeReadings, *, progress: Progress | None = None) -> FittedCones:
    """Fit faces to readings of cones."""
    observed = observed_by_cones(readings)
    step = -(-len(readings) // MAX_READINGS)
    readings = readings.take(slice(None, None, step + 1 - step % 2)) if step > 1 else readings
    sigma = FACES.first_sigma
    work = Refiner(readings, [], sigma)
    n_stages = 2 * ROUNDS + 1
    for i in range(ROUNDS):
        found = search(readings, ~work.is_explained(), sigma, progress=_part(progress, 2 * i, n_stages))
        work = Refiner(readings, work.stretches + found, sigma)
        work.sweep(_part(progress, 2 * i + 1, n_stages))
        sigma = work.sigma = _sigma(readings, work.nearest())
        logger.info("%d stretches, noise %.4f m", len(work.stretches), sigma)
    work.sweep(_part(progress, n_stages - 1, n_stages))
    faces, noise, hits = _to_faces(readings, work, sigma)
    return FittedCones(faces=faces, noise=noise, hits=hits, n_readings=len(readings), observed=observed)


def _part(progress: Progress | None, stage: int, n_stages: int) -> Progress | None:
    """Return a progress function for one of several stages, in percent of all stages."""
    if progress is None:
        return None
    report = progress
    return lambda done, total: report(int(100 * (stage + done / max(total, 1)) / n_stages), 100)


def _sigma(readings: ConeReadings, nearest: Floats) -> float:
    """Estimate the noise [m] of the readings that a stretch explains, from the median absolute deviation."""
    with np.errstate(invalid="ignore"):
        e = np.abs(readings.ranges - nearest)
    e = e[np.isfinite(e) & (e < FIT_SIGMAS * CONES.max_sigma)]
    return float(np.clip(robust_sigma(e), 1e-4, CONES.max_sigma)) if len(e) else FACES.first_sigma


def _to_faces(readings: ConeReadings, work: Refiner, sigma: float) -> tuple[FaceSet, ReturnNoise, Floats]:
    """Count hits and passes of each stretch, and return the stretches as faces in the order of their hits."""
    n = len(work.stretches)
    nearest = work.nearest()
    owner = work.ranges.argmin(axis=0) if n else np.zeros(len(readings), dtype=np.intp)
    is_there = np.isfinite(nearest)
    e = np.where(is_there, readings.reach - np.where(is_there, nearest, 0.0), -np.inf)
    tolerance = FIT_SIGMAS * sigma
    hit, passed = (np.abs(e) <= tolerance) & readings.returned, e > tolerance
    hits = np.bincount(owner[hit], minlength=n).astype(np.float64)
    passes = np.bincount(owner[passed & is_there], minlength=n)
    levels = (hits + PRIOR_STOPS) / (hits + passes + PRIOR_CROSSINGS)
    order = np.argsort(-hits, kind="stable")
    lines = np.array(work.stretches, dtype=np.float64).reshape(n, 4)[order]
    edges = lines[:, 2:].ravel()
    faces = FaceSet(
        normals=np.stack([np.cos(lines[:, 0]), np.sin(lines[:, 0])], axis=1), offsets=lines[:, 1].copy(),
        first=2 * np.arange(n + 1, dtype=np.intp), edges=edges,
        levels=np.stack([levels[order], np.zeros(n)], axis=1).ravel(), blur=np.full(2 * n, END_BLUR),
        neighbour=np.full(2 * n, -1, dtype=np.intp),
    )  # fmt: skip
    stray = int((readings.returned & ~hit).sum()) / max(float(readings.reach.sum()), 1e-9)
    return faces, ReturnNoise(sigma=sigma, stray=stray), hits[order]


def observed_by_cones(readings: ConeReadings) -> ObservedSpace:
    """Return the space in which cones were clear; each cone is sampled with rays at most a cell apart at its end."""
    total: ObservedSpace | None = None
    for start in range(0, len(readings), READINGS_AT_A_TIME):
        some = readings.take(slice(start, start + READINGS_AT_A_TIME))
        reach = some.reach
        n_rays = 1 + np.ceil(2 * some.halves * reach / FACES.observed_cell).astype(np.intp)
        owner, rank = members(n_rays)
        turn = some.halves[owner] * (2 * rank / np.maximum(n_rays[owner] - 1, 1) - 1)
        ux, uy = some.directions[owner].T
        cos, sin = np.cos(turn), np.sin(turn)
        directions = np.stack([ux * cos - uy * sin, uy * cos + ux * sin], axis=1)
        part = ObservedSpace.of(np.ascontiguousarray(some.origins[owner]), directions, reach[owner])
        total = part if total is None else total.merge(part)
    assert total is not None
    return total
