"""Matching of readings to faces: the face of each return, and its residual given the current ray terms."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from logs.run import RangeSensor
from planners.kernel import outer_kernel
from sensorgraph.models.calibration.ray_terms import (
    MAX_OPTIC_RANGE,
    N_INCIDENCE,
    RayTerms,
    incidence_bias,
    incidence_terms,
)
from sensorgraph.models.calibration.settings import CALIBRATION
from sensorgraph.models.faces.ray_march import FaceSet, bucket_grid, crossed_faces, new_march
from sensorgraph.models.faces.reduction import RaySample
from sensorgraph.models.faces.visibility import FIT_GATE, GATE, MIN_COSINE, RayArrays, ReturnNoise, variance
from sensorgraph.types import Bools, Floats, Ints

MAX_RAY_BIAS = CALIBRATION.max_ray_bias
MIN_SHIFT_COSINE = 0.02
"""|n·u| below which a shift of the face does not change the range of a return."""
MIN_RANGE = 1e-3
"""[m] Lower limit of a corrected reading."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Readings:
    """Valid readings of scans, in the order of the log."""

    scan: Ints
    """(n,) index of the scan."""
    pose: Ints
    """(n,) index of the pose: one per scan, or one per reading for a sweeping laser."""
    ray: Ints
    """(n,) index of the ray."""
    ranges: Floats
    """(n,) [m] measured ranges; +inf: no return."""
    bearings: Floats
    """(n_rays,) [rad]"""
    range_max: float

    def __len__(self) -> int:
        return len(self.ranges)

    def take(self, index: Ints | slice | Bools) -> Readings:
        """Return some of the readings."""
        some = {name: getattr(self, name)[index] for name in ("scan", "pose", "ray", "ranges")}
        return replace(self, **some)


def readings_of(sample: RaySample, sensor: RangeSensor) -> tuple[Readings, Floats]:
    """Assign the rays of a sample to scans; return readings and their poses (n_poses, 3).

    There is one pose per scan, or one per ray for a sweeping laser. A slow sweep is divided into several scans
    (`CalibrationSettings.sweep_rate`).
    """
    new = np.ones(len(sample), dtype=np.bool_)
    new[1:] = (sample.poses[1:] != sample.poses[:-1]).any(axis=1)
    sweeps = sample.ray_poses is not None
    if sweeps:
        n_parts = max(1, round(abs(sensor.sweep_time) * CALIBRATION.sweep_rate))
        new[1:] |= np.diff(sample.beams * n_parts // sensor.n_rays) != 0
    scan = np.cumsum(new) - 1
    readings = Readings(
        scan=scan,
        pose=np.arange(len(sample)) if sweeps else scan,
        ray=sample.beams.astype(np.intp),
        ranges=sample.ranges,
        bearings=sensor.bearings,
        range_max=sensor.range_max,
    )
    return readings, sample.poses_of_rays if sweeps else sample.poses[new]


@dataclass(frozen=True, kw_only=True, eq=False)
class Matches:
    """The face of each reading, and the corrected ranges."""

    ranges: Floats
    """(n,) [m] corrected ranges; +inf: no return."""
    face: Ints
    """(n,) index of the face; -1: none."""
    rho: Floats
    """(n,) [m] range to that face."""
    den: Floats
    """(n,) n·u of the face's normal n and the ray's direction u."""
    along: Floats
    """(n,) t·u of the face's tangent t."""
    at: Floats
    """(n,) [m] abscissa of the end point on the face."""
    probability: Floats
    """(n,) probability that the return is from this face."""
    weight: Floats
    """(n,) [1/m²] weight of the residual; 0 where it is not used."""

    @property
    def residual(self) -> Floats:
        """(n,) [m] corrected range minus range to the face; 0 where it is not used."""
        with np.errstate(invalid="ignore"):
            return np.where(self.weight > 0, self.ranges - self.rho, 0.0)


def directions_of(readings: Readings, lasers: Floats) -> tuple[Floats, Floats]:
    """Return origins and directions (n, 2) of readings taken from lasers (n_poses, 3)."""
    theta = lasers[readings.pose, 2] + readings.bearings[readings.ray]
    return lasers[readings.pose, :2], np.stack([np.cos(theta), np.sin(theta)], axis=1)


def match_readings(
    readings: Readings, lasers: Floats, terms: RayTerms, faces: FaceSet, noise: ReturnNoise, mean_bias: float
) -> Matches:
    """Find the face of every reading and correct its range; `mean_bias` is S [m] for readings without a face."""
    rays = RayArrays(*directions_of(readings, lasers), readings.ranges, readings.range_max, np.zeros(0))
    n = len(readings)
    values = np.zeros((7, n))
    values[0] = readings.ranges
    face = np.full(n, -1, dtype=np.intp)
    _match_readings(
        rays, readings.ray, faces, bucket_grid(faces), noise.array, (terms.constant, terms.slope, terms.incidence),
        mean_bias, new_march(), face, values,
    )  # fmt: skip
    ranges, rho, den, along, at, probability, weight = values
    return Matches(
        ranges=ranges, face=face, rho=rho, den=den, along=along, at=at, probability=probability, weight=weight
    )


def mean_incidence(matches: Matches, terms: RayTerms) -> float:
    """Return the mean of S [m] over the returns that match a face."""
    known = matches.weight > 0
    if not known.any() or not terms.has_incidence:
        return 0.0
    v, q = 1 - np.abs(matches.den[known]), np.minimum(matches.rho[known], MAX_OPTIC_RANGE) / MAX_OPTIC_RANGE
    basis = np.empty((N_INCIDENCE, len(v)))
    incidence_terms(v, q, basis)
    return float((terms.incidence @ basis).mean())


def range_change(matches: Matches, shift: float) -> Floats:
    """Return the change of range (n,) [m] if all faces move along their normals by `shift` [m]; 0 without a face."""
    return np.where(
        (matches.face >= 0) & (matches.den < -MIN_SHIFT_COSINE),
        shift / np.where(matches.den < 0, matches.den, -1.0),
        0.0,
    )


@outer_kernel
def _match_readings(
    rays: Any, ray: Any, faces: Any, buckets: Any, noise: Any, terms: Any, mean_bias: Any, march: Any, face: Any,
    values: Any,
) -> Any:  # fmt: skip
    """Fill face (n,) and values (7, n), the other fields of `Matches`: the face m that most probably stopped each ray.

    p_m = S_m alpha_m N(e_m; 0, var_m) as in `faces.visibility`, with the residual of the corrected range
    e_m = (z - c_0 - S(v_m, q_m)) / (1 + c_1) - r_m. Its probability is p_m / (sum_i p_i + before * stray).
    """
    normals, _, first, _, levels, _, _ = faces
    origins, directions, ranges, range_max, _ = rays
    constant, slope, s = terms
    r, k, j, t = march
    for i in range(len(ranges)):
        z = ranges[i]
        if z > 1e300:
            continue
        ux, uy = directions[i, 0], directions[i, 1]
        gain = 1.0 + slope[ray[i]]
        base = (z - constant[ray[i]]) / gain
        n = crossed_faces(
            origins[i, 0], origins[i, 1], ux, uy, base + MAX_RAY_BIAS, 0.0, faces, buckets, march
        )
        survival, total, best, at, best_e, best_var = 1.0, 0.0, 0.0, -1, 0.0, 1.0
        before = 1.0
        for m in range(n):
            f = k[m]
            alpha = levels[j[m]] if j[m] >= first[f] else 0.0
            den = normals[f, 0] * ux + normals[f, 1] * uy
            var = variance(r[m], -normals[f, 1] * ux + normals[f, 0] * uy, den, noise)
            e = base - incidence_bias(den, r[m], s) / gain - r[m]
            if e * e < GATE * var:
                p = survival * alpha * np.exp(-0.5 * e * e / var) / np.sqrt(2 * np.pi * var)
                total += p
                if p > best:
                    best, at, best_e, best_var = p, m, e, var
            if e > 0:
                before = survival * (1 - alpha)
            survival *= 1 - alpha
        if at < 0:
            values[0, i] = max(base - mean_bias / gain, MIN_RANGE)
            continue
        f = k[at]
        den = normals[f, 0] * ux + normals[f, 1] * uy
        along = -normals[f, 1] * ux + normals[f, 0] * uy
        probability = best / (total + before * noise[3])
        face[i] = f
        values[0, i] = max(r[at] + best_e, MIN_RANGE)
        values[1, i], values[2, i], values[3, i] = r[at], den, along
        values[4, i] = t[at] + best_e * along
        values[5, i] = probability
        if (
            probability > 0.5
            and den < -MIN_COSINE
            and best_e * best_e < FIT_GATE * best_var
            and z < range_max
        ):
            values[6, i] = probability / best_var
