"""Calibration: mount and ray terms of the laser and refined training poses, identified together with the faces.

A wrong mount and biased rays bend and split the fitted walls, so faces and sensor are estimated in turn, from coarse
to fine. Each round fits faces to corrected ranges, solves one joint least-squares problem (`normal_equations`),
refines the poses (`pose_refinement`) and fixes the walls' common shift by occlusion edges (`gauge`).
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace

import numpy as np

from logs.run import RangeSensor
from logs.transforms import compose, difference
from sensorgraph.models.calibration.gauge import Gauge, estimate_gauge
from sensorgraph.models.calibration.laser_calibration import Calibration
from sensorgraph.models.calibration.matching import (
    Matches,
    Readings,
    directions_of,
    match_readings,
    mean_incidence,
    range_change,
    readings_of,
)
from sensorgraph.models.calibration.normal_equations import (
    COMMON,
    INCIDENCE,
    MOUNT,
    N_COMMON,
    RIDGE,
    NormalEquations,
    normal_equations,
    select_terms,
    standard_errors,
    step_faces,
)
from sensorgraph.models.calibration.pose_refinement import (
    LaserPoses,
    RefinedPoses,
    exceeds_max_noise,
    refine_poses,
)
from sensorgraph.models.calibration.ray_terms import RayTerms
from sensorgraph.models.calibration.settings import CALIBRATION
from sensorgraph.models.faces.fit import FittedFaces, draft_faces, fit_faces, moved_faces
from sensorgraph.models.faces.observed_space import ObservedSpace
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.reduction import RaySample
from sensorgraph.models.faces.settings import FACES
from sensorgraph.models.faces.visibility import Rays, ReturnNoise
from sensorgraph.types import Floats, Progress, ProgressBars, no_progress
from sensorgraph.work_counter import WorkCounter

logger = logging.getLogger(__name__)

PROBE_READINGS = 250_000
"""Readings, in whole scans, of a first test and of the search for the gauge; without any gain there, the full test is skipped."""
COARSE_SIGMAS, FINE_SIGMA = (0.025, 0.015), 0.012
"""[m] Range noise assumed in the coarse rounds and in the fine ones."""
MAX_REFINEMENTS = 20
"""Maximum number of times that faces and poses are refined in turn."""
GAUGE_REACHES = (0.012, 0.003)
"""[m] Half width of the search for the gauge in each fine round."""
SELECTIONS = 3
"""Number of selections of terms; the penalty of a ray's term falls with the share of rays that have one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibratedFaces:
    """Faces and the identified laser."""

    fitted: FittedFaces
    calibration: Calibration
    rays: Rays
    """Rays with corrected origins, directions and ranges."""
    mount: Floats
    """(3,) [m, m, rad] pose of the laser in the frame of the poses."""


def observed_by(rays: Rays) -> ObservedSpace:
    """Return the space that corrected rays crossed."""
    reach = np.minimum(rays.ranges, rays.range_max)
    return ObservedSpace.of(rays.origins, rays.directions, reach, returned=np.isfinite(rays.ranges))


def rays_beside_faces(
    sample: RaySample,
    sensor: RangeSensor,
    mount: Floats,
    calibration: Calibration,
    faces: FaceSet,
    noise: ReturnNoise,
) -> tuple[Rays, tuple[float, float]]:
    """Return the rays of a new sample, corrected by identified ray terms, from poses refined against fitted faces.

    Also returns the standard errors of the refined poses [m, rad], 0 if they are as logged.

    Poses are first matched with the noise that poses of the earlier samples had. They stay as logged if refining them
    gains too little evidence.
    """
    readings, poses = readings_of(sample, sensor)
    work = _JointCalibration(readings, poses, mount, can_mount=False)
    work.weights, work.terms, work.faces = sample.weights, calibration.terms, faces
    work.noise = replace(
        noise,
        sigma_xy=max(noise.sigma_xy, calibration.sigma_xy),
        sigma_yaw=max(noise.sigma_yaw, calibration.sigma_yaw),
    )
    work.refine_poses()
    work.noise = noise
    work.refine_poses()
    return work.corrected(), work.pose_errors


def calibrate_faces(
    sample: RaySample, sensor: RangeSensor, mount: Floats, fitted: FittedFaces, *, coarse: int = 1,
    can_mount: bool = True, calibrate: bool | None = None, progress: ProgressBars = no_progress,
) -> CalibratedFaces:  # fmt: skip
    """Identify the laser of a sample and fit the faces again with it, if the evidence supports a calibration.

    Parameters
    ----------
    mount : (3,) [m, m, rad] Specified mount.
    fitted : Faces fitted with the laser as specified.
    coarse : `coarseness` of the laser.
    can_mount : Whether the poses are those of a base that carries the laser. False: they are the laser's own.
    calibrate : None: decide by evidence. True or False: always or never.
    """
    readings, poses = readings_of(sample, sensor)
    work = _JointCalibration(readings, poses, mount, can_mount=can_mount)
    work.weights, work.coarse = sample.weights, coarse
    work.set_faces(fitted)
    with progress("testing the laser", "%") as tick:
        should_calibrate = calibrate is not False and work.should_calibrate(
            force=calibrate is True, tick=tick
        )
    if should_calibrate:
        with progress("calibrating the laser", "%") as tick:
            found = work.run(tick)
        if found.calibration.is_plausible and _log_likelihood_per_ray(found.fitted) > _log_likelihood_per_ray(
            fitted
        ):
            return found
        logger.info("calibration rejected: it is implausible or does not raise the likelihood")
    return CalibratedFaces(
        fitted=fitted,
        calibration=Calibration.none(sensor.n_rays, can_mount=can_mount),
        rays=sample.rays(sensor, mount),
        mount=mount,
    )


def _log_likelihood_per_ray(fitted: FittedFaces) -> float:
    return fitted.expectation.log_likelihood / max(fitted.n_rays, 1)


class _JointCalibration:
    """Current estimates of mount, poses, ray terms, faces and noise."""

    def __init__(self, readings: Readings, poses: Floats, mount: Floats, *, can_mount: bool) -> None:
        self.readings, self.can_mount = readings, can_mount
        self.specified, self.mount = mount, mount.copy()
        self.n_scans = int(readings.scan.max(initial=-1)) + 1
        self.shifts = np.zeros((self.n_scans, 3))
        self._lasers = LaserPoses(poses, readings.pose, readings.scan)
        self.terms, self.mean_bias = RayTerms.none(len(readings.bearings)), 0.0
        self.weights: Floats | None = None  # (n,) number of rays that each reading represents; None: 1
        self.coarse = 1  # `coarseness` of the laser
        self.laser_differs = self.has_mount = False
        self.has_own = np.zeros((2, len(readings.bearings)), dtype=np.bool_)
        self.offset_se = np.full(3, np.nan)
        self.gauge: Gauge | None = None
        self.pose_noise = self.pose_errors = (0.0, 0.0)
        self.faces: FaceSet
        self.noise: ReturnNoise

    @property
    def lasers(self) -> Floats:
        """(n_poses, 3) [m, m, rad] poses of the laser from the mount and the refined poses."""
        return self._lasers.at(self.mount, self.shifts)

    def rays(self, readings: Readings, ranges: Floats) -> Rays:
        origins, directions = directions_of(readings, self.lasers)
        return Rays(origins=origins, directions=directions, ranges=ranges, range_max=readings.range_max)

    def set_faces(self, fitted: FittedFaces, *, least: float = 0.0) -> None:
        """Use new faces; the range noise is at least `least` [m]."""
        self.faces = fitted.faces
        self.noise = replace(fitted.noise, sigma=max(fitted.noise.sigma, least))

    def match(self, readings: Readings | None = None) -> Matches:
        """Match readings to faces, and update the mean incidence term."""
        readings = self.readings if readings is None else readings
        found = match_readings(readings, self.lasers, self.terms, self.faces, self.noise, self.mean_bias)
        self.mean_bias = mean_incidence(found, self.terms)
        return found

    def should_calibrate(self, *, force: bool, tick: Progress) -> bool:
        """Test whether ray terms or refined poses gain enough evidence on faces fitted without them.

        Noise of a pose moves all returns of a scan together, and over many scans it imitates ray terms. Therefore
        the mount is tested against the noise of the poses, and all other terms after the poses are refined.
        """
        if exceeds_max_noise(self.noise.sigma_xy, self.noise.sigma_yaw):
            logger.info("calibration: returns and poses are inconsistent: %s", self.noise)
            return False
        all_readings, probe = self.readings, PROBE_READINGS
        work = WorkCounter(tick, 2)
        if not force and len(all_readings) > 2 * probe:
            self.readings = _whole_scans(all_readings, probe)
            mount, terms, better = self._test_evidence()
            self.readings = all_readings
            work.add(1)
            if max(mount, terms, better.log_evidence) <= 0:
                return False
        mount, terms, better = self._test_evidence()
        if better.log_evidence > CALIBRATION.min_gain:
            self.shifts, self.pose_noise = better.shifts, (better.sigma_xy, better.sigma_yaw)
            self.pose_errors = better.errors
        least = max(CALIBRATION.min_gain, CALIBRATION.min_gain_per_reading * len(self.readings))
        self.laser_differs = force or mount > CALIBRATION.min_gain or terms > least
        return self.laser_differs or better.log_evidence > CALIBRATION.min_gain

    def _test_evidence(self) -> tuple[float, float, RefinedPoses]:
        """Return the log evidence [nats] of the mount and of all other terms, and refined poses."""
        matches = self.match()
        better = self._poses(matches)
        mount, terms = self._gains_of(better, matches)
        kept = self.shifts
        if better.log_evidence > CALIBRATION.min_gain:
            self.shifts = better.shifts
            terms = self._gains_of(better, self.match())[1]
        self.shifts = kept
        logger.info(
            "calibration: mount %.0f, terms %.0f, poses %.0f nats (%.2f mm, %.3f mrad)",
            mount, terms, better.log_evidence, 1e3 * better.sigma_xy, 1e3 * better.sigma_yaw,
        )  # fmt: skip
        return mount, terms, better

    def _gains_of(self, better: RefinedPoses, matches: Matches) -> tuple[float, float]:
        """Return the log evidence [nats] of the mount alone, given the noise of the poses, and of the other terms."""
        normal = normal_equations(self.readings, self.lasers, matches, self.faces, hold=False)
        penalties = self._penalties(normal, incidence=True)
        penalty = penalties[0]
        penalties[MOUNT] = np.inf
        terms = select_terms(normal, np.zeros(len(penalties)), penalties)[2]
        limits = np.array([better.sigma_xy, better.sigma_xy, better.sigma_yaw]) ** 2 / self.n_scans
        if not self.can_mount:
            return 0.0, terms
        mount_matrix = normal.matrix[MOUNT, MOUNT] + RIDGE * np.eye(3)
        spread = np.linalg.inv(mount_matrix) + np.diag(limits)
        offset = np.linalg.solve(mount_matrix, normal.rhs[MOUNT])
        return 0.5 * float(offset @ np.linalg.solve(spread, offset)) - 3 * penalty, terms

    def run(self, tick: Progress) -> CalibratedFaces:
        """Calibrate from coarse to fine, then refine poses and faces; for a laser as specified, only the latter."""
        reaches, sigmas = (GAUGE_REACHES, COARSE_SIGMAS) if self.laser_differs else ((), ())
        work = WorkCounter(tick, len(sigmas) + 2 * len(reaches) + 1)  # stages of similar duration
        if self.laser_differs:
            self.shifts = np.zeros_like(self.shifts)  # they compensated errors of the laser
            self.pose_noise = self.pose_errors = (0.0, 0.0)
        for i, sigma in enumerate(sigmas):
            rays = self.corrected()
            self.set_faces(draft_faces(rays, sigma=sigma, coarse=self.coarse), least=sigma)
            self.adjust(incidence=i > 0)
            self.adjust(incidence=i > 0)
            work.add(1)
        for reach in reaches:
            rays = self.corrected()
            self.set_faces(self._fitted(rays, FINE_SIGMA, work.part(1)))
            work.add(1)
            self.adjust(incidence=True)
            self.refine_poses()
            self.adjust(incidence=True)
            self.fix_gauge(reach)
            self.refine_poses()
            work.add(1)
        self.refine_in_turn()
        rays = self.corrected()
        fitted = self._fitted(rays, FACES.first_sigma, work.part(1))
        return CalibratedFaces(fitted=fitted, calibration=self.calibration(), rays=rays, mount=self.mount)

    def _fitted(self, rays: Rays, sigma: float, progress: Progress) -> FittedFaces:
        return fit_faces(
            rays, sigma=sigma, coarse=self.coarse, pose_errors=self.pose_errors, progress=progress
        )

    def corrected(self) -> Rays:
        """Return the rays, corrected by the current estimates."""
        return replace(self.rays(self.readings, self.match().ranges), weights=self.weights)

    def adjust(self, *, incidence: bool, shift: float = 0.0) -> None:
        """Estimate mount, ray terms and faces jointly, with the faces shifted by `shift` [m] towards the laser first.

        The mean shift of the faces is free until occlusion edges have fixed it (`estimate_gauge`).
        """
        matches, faces = self.match(), self.faces._replace(offsets=self.faces.offsets + shift)
        if shift:
            matches = replace(matches, rho=matches.rho + range_change(matches, shift))
        hold = self.gauge is not None
        normal = normal_equations(self.readings, self.lasers, matches, faces, hold=hold)
        current = np.concatenate([np.zeros(5), self.terms.incidence, self.terms.constant, self.terms.slope])
        for _ in range(SELECTIONS):  # penalties fall as more rays have a term
            values, chosen, _ = select_terms(normal, current, self._penalties(normal, incidence=incidence))
            self.has_own = chosen[N_COMMON:].reshape(2, -1)
        self.faces = step_faces(faces, normal, values - current)
        self.terms = _terms(values)
        if chosen[MOUNT].any():
            self.has_mount = True
            self.mount = compose(self.mount, values[MOUNT])
            self.offset_se = standard_errors(normal, chosen)[MOUNT]
        logger.info(
            "mount %s, %d + %d rays, incidence %s mm", np.round(self.mount - self.specified, 5),
            *self.has_own.sum(axis=1), np.round(1e3 * self.terms.incidence, 1),
        )  # fmt: skip

    def refine_in_turn(self) -> None:
        """Move faces to the rays and poses to the faces, until the poses gain little evidence per reading."""
        least, before = CALIBRATION.min_gain_per_reading * len(self.readings), -math.inf
        for _ in range(MAX_REFINEMENTS):
            self.faces, self.noise = moved_faces(self.corrected(), self.faces, self.noise)
            evidence = self.refine_poses()
            if evidence - before < least:
                break
            before = evidence

    def refine_poses(self) -> float:
        """Refine the training poses if that gains enough evidence; return the log evidence [nats]."""
        matches = self.match()
        better = self._poses(matches)
        size = 1e3 * better.sigma_xy, 1e3 * better.sigma_yaw
        logger.info("poses: %.0f nats, %.2f mm, %.3f mrad", better.log_evidence, *size)
        if better.log_evidence >= CALIBRATION.min_gain:
            self.shifts = better.shifts
            self.pose_noise, self.pose_errors = (better.sigma_xy, better.sigma_yaw), better.errors
        return better.log_evidence

    def fix_gauge(self, reach: float) -> None:
        """Fix the common shift of the walls by occlusion edges, then adjust the ray terms."""
        if not self.terms.has_incidence:
            return
        some = _whole_scans(self.readings, PROBE_READINGS)
        matches = self.match(some)
        found = estimate_gauge(self.rays(some, matches.ranges), matches, self.faces, self.noise, reach=reach)
        before = self.gauge.shift if self.gauge is not None else 0.0
        self.gauge = replace(found, shift=before + found.shift)
        logger.info("gauge %s", found)
        if found.shift:
            self.adjust(incidence=True, shift=found.shift)

    def calibration(self) -> Calibration:
        offset = difference(self.mount, self.specified)
        # the mean error of the poses over all scans cannot be distinguished from a mount error
        limits = np.array([*2 * self.pose_noise[:1], self.pose_noise[1]]) / math.sqrt(self.n_scans)
        return Calibration(
            terms=self.terms, offset=offset,
            offset_se=np.hypot(self.offset_se, limits), can_mount=self.can_mount,
            n_own=int(self.has_own.any(axis=0).sum()), gauge=self.gauge, sigma_xy=self.pose_noise[0],
            sigma_yaw=self.pose_noise[1],
        )  # fmt: skip

    def _poses(self, matches: Matches) -> RefinedPoses:
        found = refine_poses(self.readings, self.lasers, matches, self.faces, self.shifts, self.noise)
        if exceeds_max_noise(found.sigma_xy, found.sigma_yaw):
            logger.info("poses off by %.2f m, %.2f rad: not refined", found.sigma_xy, found.sigma_yaw)
            return replace(found, log_evidence=0.0)
        return found

    def _penalties(self, normal: NormalEquations, *, incidence: bool) -> Floats:
        """Return the complexity penalty [nats] of each term: BIC, and the log of the number of candidates."""
        n, n_rays = max(normal.n_returns, 2.0), len(self.terms.constant)
        penalties = np.full(N_COMMON + 2 * n_rays, 0.5 * math.log(n) + math.log(N_COMMON + 2 * n_rays))
        if not self.can_mount:
            penalties[MOUNT] = np.inf
        elif self.has_mount:
            penalties[MOUNT] = -np.inf
        if not incidence:
            penalties[INCIDENCE] = np.inf
        for group in range(2):
            share = (self.has_own[group].sum() + 0.5) / (n_rays + 1)
            penalty = 0.5 * math.log(max(n / n_rays, 2.0)) + math.log((1 - share) / share)
            penalties[N_COMMON + group * n_rays : N_COMMON + (group + 1) * n_rays] = penalty
        return penalties


def _whole_scans(readings: Readings, most: int) -> Readings:
    """Return evenly spaced scans with about `most` readings at most."""
    step = -(-len(readings) // most)
    return readings if step == 1 else readings.take(readings.scan % step == 0)


def _terms(values: Floats) -> RayTerms:
    """Add the terms that all rays share to each ray's own terms."""
    constant, slope = values[N_COMMON:].reshape(2, -1)
    common, scale = values[COMMON]
    return RayTerms(constant=constant + common, slope=slope + scale, incidence=values[INCIDENCE])
