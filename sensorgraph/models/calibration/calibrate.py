"""Calibration: mount and ray terms of the laser, and better training poses, identified together with the faces.

A perfect laser fits its faces at once. One that is mounted elsewhere than stated, or whose rays have biases, bends
walls and splits them: faces and sensor must be found in turns. From coarse to fine: faces from corrected ranges,
one joint least squares (`adjustment`), poses (`poses_refined`), and the walls' common shift by occlusion edges (`gauge`).
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace

import numpy as np

from logs.run import RangeSensor
from sensorgraph.models.calibration.gauge import Gauge, estimate_gauge
from sensorgraph.models.calibration.laser_calibration import Calibration
from sensorgraph.models.calibration.matching import (
    Matches,
    Readings,
    directions_of,
    match_readings,
    mean_incidence,
    range_change,
)
from sensorgraph.models.calibration.normal_equations import (
    COMMON,
    INCIDENCE,
    MOUNT,
    N_COMMON,
    NormalEquations,
    normal_equations,
    select_terms,
    standard_errors,
    step_faces,
)
from sensorgraph.models.calibration.pose_refinement import (
    LaserPoses,
    RefinedPoses,
    compose_poses,
    is_broken,
    refine_poses,
)
from sensorgraph.models.calibration.ray_terms import RayTerms
from sensorgraph.models.calibration.settings import CALIBRATION
from sensorgraph.models.faces.fit import FittedFaces, draft_faces, fit_cost, fit_faces
from sensorgraph.models.faces.observed_space import ObservedSpace
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.reduction import RaySample
from sensorgraph.models.faces.visibility import Rays, ReturnNoise
from sensorgraph.types import Floats, Progress, ProgressBars, no_progress
from sensorgraph.work_counter import WorkCounter

logger = logging.getLogger(__name__)

COARSE_PASSES, ROUND_PASSES, REFINE_PASSES = 6, 12, 3
"""Passes over the readings that a coarse round, a fine one and a refinement of the poses take, about; they only tell progress."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibratedFaces:
    """Faces and the laser that saw them."""

    fitted: FittedFaces
    calibration: Calibration
    rays: Rays
    """With corrected origins, directions and ranges."""
    mount: Floats
    """(3,) [m, m, rad] laser in the frame of the poses."""


def readings_of(sample: RaySample, sensor: RangeSensor) -> tuple[Readings, Floats]:
    """Tell which scan each ray of a sample comes from; return readings and their poses (n_poses, 3).

    The poses are those of the scans, or of all rays where the laser sweeps. A slow sweep counts as several scans
    (`PoseSettings.sweep_rate`).
    """
    new = np.ones(len(sample), dtype=np.bool_)
    new[1:] = (sample.poses[1:] != sample.poses[:-1]).any(axis=1)
    sweeps = sample.ray_poses is not None
    if sweeps:
        n_parts = max(1, round(abs(sensor.sweep_time) * CALIBRATION.poses.sweep_rate))
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


def observed_by(rays: Rays) -> ObservedSpace:
    """Count the space that corrected rays went through."""
    reach = np.minimum(rays.ranges, rays.range_max)
    return ObservedSpace.of(rays.origins, rays.directions, reach, returned=np.isfinite(rays.ranges))


def corrected_rays(
    sample: RaySample,
    sensor: RangeSensor,
    mount: Floats,
    calibration: Calibration,
    faces: FaceSet,
    noise: ReturnNoise,
) -> Rays:
    """Return the rays of a sample with the identified ray terms taken off; poses stay as logged."""
    rays = sample.rays(sensor, mount)
    if calibration.terms.is_none:
        return rays
    readings, poses = readings_of(sample, sensor)
    lasers = compose_poses(poses, mount)
    first = match_readings(readings, lasers, calibration.terms, faces, noise, 0.0)
    mean_bias = mean_incidence(first, calibration.terms)
    found = match_readings(readings, lasers, calibration.terms, faces, noise, mean_bias)
    return replace(rays, ranges=found.ranges)


def calibrate_faces(
    sample: RaySample,
    sensor: RangeSensor,
    mount: Floats,
    fitted: FittedFaces,
    *,
    can_mount: bool = True,
    calibrate: bool | None = None,
    progress: ProgressBars = no_progress,
) -> CalibratedFaces:
    """Identify the laser that took a sample, and fit the faces again with it, where the evidence pays for it.

    Parameters
    ----------
    mount : (3,) [m, m, rad] as stated
    fitted : faces by the laser as stated
    can_mount : the poses are of a base that carries the laser; False where they are the laser's own
    calibrate : None: decide by evidence; True and False: always, never
    """
    readings, poses = readings_of(sample, sensor)
    work = _JointCalibration(readings, poses, mount, can_mount=can_mount)
    work.weights = sample.weights
    work.take(fitted)
    with progress("testing the laser", "%") as tick:
        is_worth = calibrate is not False and work.is_worth(force=calibrate is True, tick=tick)
    if is_worth:
        with progress("calibrating the laser", "%") as tick:
            found = work.run(tick)
        if found.calibration.is_plausible and _log_likelihood_per_ray(found.fitted) > _log_likelihood_per_ray(
            fitted
        ):
            return found
        logger.info("calibration is absurd or explains no more than none: left out")
    return CalibratedFaces(
        fitted=fitted,
        calibration=Calibration.none(sensor.n_rays, can_mount=can_mount),
        rays=sample.rays(sensor, mount),
        mount=mount,
    )


def _log_likelihood_per_ray(fitted: FittedFaces) -> float:
    return fitted.expectation.log_likelihood / max(fitted.n_rays, 1)


class _JointCalibration:
    """What is known so far: mount, poses, terms, faces and noise."""

    def __init__(self, readings: Readings, poses: Floats, mount: Floats, *, can_mount: bool) -> None:
        self.readings, self.can_mount = readings, can_mount
        self.stated, self.mount = mount, mount.copy()
        self.n_scans = int(readings.scan.max(initial=-1)) + 1
        self.shifts = np.zeros((self.n_scans, 3))
        self._lasers = LaserPoses(poses, readings.pose, readings.scan)
        self.terms, self.mean_bias = RayTerms.none(len(readings.bearings)), 0.0
        self.weights: Floats | None = None  # (n,) rays that each reading stands for; None: all the same
        self.is_amiss = self.has_mount = False
        self.own = np.zeros((2, len(readings.bearings)), dtype=np.bool_)
        self.offset_se = np.full(3, np.nan)
        self.gauge: Gauge | None = None
        self.pose_noise = self.pose_errors = (0.0, 0.0)
        self.faces: FaceSet
        self.noise: ReturnNoise

    @property
    def lasers(self) -> Floats:
        """(n_poses, 3) by mount and refined poses."""
        return self._lasers.at(self.mount, self.shifts)

    def rays(self, readings: Readings, ranges: Floats) -> Rays:
        origins, directions = directions_of(readings, self.lasers)
        return Rays(origins=origins, directions=directions, ranges=ranges, range_max=readings.range_max)

    def take(self, fitted: FittedFaces, *, least: float = 0.0) -> None:
        """Go on from new faces; returns may be off by `least` [m] or more."""
        self.faces = fitted.faces
        self.noise = replace(fitted.noise, sigma=max(fitted.noise.sigma, least))

    def match(self, readings: Readings | None = None) -> Matches:
        """Match readings to faces; the mean incidence term follows."""
        readings = self.readings if readings is None else readings
        found = match_readings(readings, self.lasers, self.terms, self.faces, self.noise, self.mean_bias)
        self.mean_bias = mean_incidence(found, self.terms)
        return found

    def is_worth(self, *, force: bool, tick: Progress) -> bool:
        """Test whether ray terms or refined poses pay on faces that were fitted without them.

        Noise of a pose moves all returns of a scan together, and many such scans look like terms that are not
        there. So the mount counts against the poses' noise, and all others after the poses were refined.
        """
        if is_broken(self.noise.sigma_xy, self.noise.sigma_yaw):
            logger.info("calibration: returns and poses do not belong together: %s", self.noise)
            return False
        everything, probe = self.readings, CALIBRATION.probe_readings
        work = WorkCounter(tick, probe + len(everything))
        if not force and len(everything) > 2 * probe:
            self.readings = _whole_scans(everything, probe)
            mount, terms, better = self._paying()
            self.readings = everything
            work.add(probe)
            if max(mount, terms, better.log_evidence) <= 0:
                return False
        mount, terms, better = self._paying()
        if better.log_evidence > CALIBRATION.min_gain:
            self.shifts, self.pose_noise = better.shifts, (better.sigma_xy, better.sigma_yaw)
            self.pose_errors = better.errors
        least = max(CALIBRATION.min_gain, CALIBRATION.min_gain_per_reading * len(self.readings))
        self.is_amiss = force or mount > CALIBRATION.min_gain or terms > least
        return self.is_amiss or better.log_evidence > CALIBRATION.min_gain

    def _paying(self) -> tuple[float, float, RefinedPoses]:
        """Return the nats of the mount against the noise of the poses, of all other terms, and better poses."""
        better = self._poses(self.match())
        mount = self._found(better)[0] if self.can_mount else 0.0
        kept = self.shifts
        if better.log_evidence > CALIBRATION.min_gain:
            self.shifts = better.shifts
        terms = self._found(better)[1]
        self.shifts = kept
        logger.info(
            "calibration: mount %.0f, terms %.0f, poses %.0f nats (%.2f mm, %.3f mrad)",
            mount, terms, better.log_evidence, 1e3 * better.sigma_xy, 1e3 * better.sigma_yaw,
        )  # fmt: skip
        return mount, terms, better

    def _found(self, better: RefinedPoses) -> tuple[float, float]:
        """Return the nats of the mount alone, against the noise of the poses, and of the other terms."""
        normal = normal_equations(self.readings, self.lasers, self.match(), self.faces, hold=False)
        prices = self._prices(normal, incidence=True)
        price = prices[0]
        prices[MOUNT] = np.inf
        terms = select_terms(normal, np.zeros(len(prices)), prices)[2]
        limits = np.array([better.sigma_xy, better.sigma_xy, better.sigma_yaw]) ** 2 / self.n_scans
        own = normal.matrix[MOUNT, MOUNT] + CALIBRATION.adjustment.ridge * np.eye(3)
        spread = np.linalg.inv(own) + np.diag(limits)
        offset = np.linalg.solve(own, normal.rhs[MOUNT])
        return 0.5 * float(offset @ np.linalg.solve(spread, offset)) - 3 * price, terms

    def run(self, tick: Progress) -> CalibratedFaces:
        """Go from coarse to fine; a laser that is as stated needs only its poses."""
        reaches = CALIBRATION.gauge.reaches[: 2 if self.is_amiss else 1]
        n = len(self.readings)
        fit, round_ = fit_cost(n), (ROUND_PASSES if self.is_amiss else REFINE_PASSES) * n
        coarse = COARSE_PASSES * n
        n_coarse = len(CALIBRATION.coarse_sigmas) if self.is_amiss else 0
        work = WorkCounter(tick, n_coarse * coarse + len(reaches) * (fit + round_) + fit)
        if self.is_amiss:
            self.shifts = np.zeros_like(self.shifts)  # they tried to make up for the laser
            self.pose_noise = self.pose_errors = (0.0, 0.0)
            for i, sigma in enumerate(CALIBRATION.coarse_sigmas):
                self.take(draft_faces(self.corrected(), sigma=sigma), least=sigma)
                self.adjust(incidence=i > 0)
                self.adjust(incidence=i > 0)
                work.add(coarse)
        for reach in reaches:
            rays = self.corrected()
            self.take(
                fit_faces(
                    rays, sigma=CALIBRATION.fine_sigma, pose_errors=self.pose_errors, progress=work.part(fit)
                )
            )
            work.add(fit)
            if self.is_amiss:
                self.adjust(incidence=True)
                self.refine_poses()
                self.adjust(incidence=True)
                self.settle(reach)
            self.refine_poses()
            work.add(round_)
        rays = self.corrected()
        fitted = fit_faces(rays, pose_errors=self.pose_errors, progress=work.part(fit))
        return CalibratedFaces(fitted=fitted, calibration=self.calibration(), rays=rays, mount=self.mount)

    def corrected(self) -> Rays:
        """Return the rays as they are by what is known of the laser."""
        return replace(self.rays(self.readings, self.match().ranges), weights=self.weights)

    def adjust(self, *, incidence: bool, shift: float = 0.0) -> None:
        """Move mount, terms and faces together; faces are `shift` [m] nearer first, and their mean stays there.

        The mean shift of the faces is free until occlusion edges have fixed it (`estimate_gauge`).
        """
        matches, faces = self.match(), self.faces._replace(offsets=self.faces.offsets + shift)
        if shift:
            matches = replace(matches, rho=matches.rho + range_change(matches, shift))
        hold = self.gauge is not None
        normal = normal_equations(self.readings, self.lasers, matches, faces, hold=hold)
        current = np.concatenate([np.zeros(5), self.terms.incidence, self.terms.constant, self.terms.slope])
        for _ in range(
            CALIBRATION.adjustment.price_rounds
        ):  # prices fall with the share of rays that have a term
            values, chosen, _ = select_terms(normal, current, self._prices(normal, incidence=incidence))
            self.own = chosen[N_COMMON:].reshape(2, -1)
        self.faces = step_faces(faces, normal, values - current)
        self.terms = _terms(values)
        if chosen[MOUNT].any():
            self.has_mount = True
            self.mount = compose_poses(self.mount[None], values[MOUNT])[0]
            self.offset_se = standard_errors(normal, chosen)[MOUNT]
        logger.info(
            "mount %s, %d + %d rays, incidence %s mm", np.round(self.mount - self.stated, 5),
            *self.own.sum(axis=1), np.round(1e3 * self.terms.incidence, 1),
        )  # fmt: skip

    def refine_poses(self) -> None:
        """Move the training poses where their noise shows."""
        matches = self.match()
        better = self._poses(matches)
        size = 1e3 * better.sigma_xy, 1e3 * better.sigma_yaw
        logger.info("poses: %.0f nats, %.2f mm, %.3f mrad", better.log_evidence, *size)
        if better.log_evidence < CALIBRATION.min_gain:
            return
        self.shifts = better.shifts
        self.pose_noise, self.pose_errors = (better.sigma_xy, better.sigma_yaw), better.errors

    def settle(self, reach: float) -> None:
        """Fix the common shift of the walls by occlusion edges, then adjust the ray terms to it."""
        if not self.terms.has_incidence:
            return
        some = _whole_scans(self.readings, CALIBRATION.gauge.readings)
        matches = self.match(some)
        found = estimate_gauge(self.rays(some, matches.ranges), matches, self.faces, self.noise, reach=reach)
        before = self.gauge.shift if self.gauge is not None else 0.0
        self.gauge = replace(found, shift=before + found.shift)
        logger.info("gauge %s", found)
        if found.shift:
            self.adjust(incidence=True, shift=found.shift)

    def calibration(self) -> Calibration:
        # the mean of the poses' noise over all scans is a mount to us
        limits = np.array([*2 * self.pose_noise[:1], self.pose_noise[1]]) / math.sqrt(self.n_scans)
        return Calibration(
            terms=self.terms,
            offset=self.mount - self.stated,
            offset_se=np.hypot(self.offset_se, limits),
            can_mount=self.can_mount,
            n_own=int(self.own.any(axis=0).sum()),
            gauge=self.gauge,
            sigma_xy=self.pose_noise[0],
            sigma_yaw=self.pose_noise[1],
        )

    def _poses(self, matches: Matches) -> RefinedPoses:
        found = refine_poses(self.readings, self.lasers, matches, self.faces, self.shifts, self.noise.sigma)
        if is_broken(found.sigma_xy, found.sigma_yaw):
            logger.info("poses off by %.2f m, %.2f rad: not refined", found.sigma_xy, found.sigma_yaw)
            return replace(found, log_evidence=0.0)
        return found

    def _prices(self, normal: NormalEquations, *, incidence: bool) -> Floats:
        """Nats that each term must be worth: BIC, and the log of how many there are to choose from."""
        n, n_rays = max(normal.n_returns, 2.0), len(self.terms.constant)
        prices = np.full(N_COMMON + 2 * n_rays, 0.5 * math.log(n) + math.log(N_COMMON + 2 * n_rays))
        if not self.can_mount:
            prices[MOUNT] = np.inf
        elif self.has_mount:
            prices[MOUNT] = -np.inf
        if not incidence:
            prices[INCIDENCE] = np.inf
        for group in range(2):
            share = (self.own[group].sum() + 0.5) / (n_rays + 1)
            own = 0.5 * math.log(max(n / n_rays, 2.0)) + math.log((1 - share) / share)
            prices[N_COMMON + group * n_rays : N_COMMON + (group + 1) * n_rays] = own
        return prices


def _whole_scans(readings: Readings, most: int) -> Readings:
    """Take evenly spaced scans if there are too many."""
    step = -(-len(readings) // most)
    return readings if step == 1 else readings.take(readings.scan % step == 0)


def _terms(values: Floats) -> RayTerms:
    """Add what all rays have in common to each ray's own terms."""
    constant, slope = values[N_COMMON:].reshape(2, -1)
    common, scale = values[COMMON]
    return RayTerms(constant=constant + common, slope=slope + scale, incidence=values[INCIDENCE])
