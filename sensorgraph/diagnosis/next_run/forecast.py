"""Predict the evidence between two models that a drive will bring.

    nats = min over x of  constant + (squares - 2 right'x + x'matrix x) / 2 + |g / tau|² / 2,   x = (g, p)

The nuisances g, with prior standard deviations tau, and the smooth parameters p of the wrong model are
refitted; pose errors are eliminated. Each ray contributes half the squared difference of the two expected
readings over the variance, and the Kullback-Leibler divergence of the return probabilities. At fixed x, the
sum over scans is linear in time, so that the best allocation of time among motions is a concave problem
(`time_allocation`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from planners.arena import Arena
from sensorgraph.diagnosis.next_run.settings import NEXT_RUN
from sensorgraph.diagnosis.scan.fit import cast, solver_for
from sensorgraph.diagnosis.scan.gauss_newton import Solver
from sensorgraph.diagnosis.scan.likelihood import ExpectedReadings
from sensorgraph.diagnosis.scan.normal_equations import boxed
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Robot

Model = tuple[Amendment, ...]
VARIANCE_RATIO = (0.01, 100.0)
"""Limits of the ratio of the variances of two models, which may have no noise."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OpenQuestion:
    """Two models that the next run should distinguish."""

    truth: Model
    """Model that is taken as true."""
    alternative: Model
    text: str
    """The question: `latency or mounting offset`."""
    hint: str = ""
    """What distinguishes them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionSamples:
    """Sample moments of a motion."""

    poses: Floats
    """(n, 3) [m, m, rad]"""
    twists: Floats
    """(n, 2) [m/s, rad/s] v and omega."""
    times: Floats
    """(n,) [s] since the start of the run."""
    duration: float
    """[s] duration that these moments represent."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EvidenceQuadratics:
    """Evidence [nats] of one second of each of n motions, as a function of the refitted values x (k,).

        constant + (squares - 2 right'x + x'matrix x) / 2

    All coefficients are proportional to time. The total of a drive has no axis n.
    """

    matrix: Floats
    """(n, k, k) normal matrices."""
    right: Floats
    """(n, k) right-hand sides of the normal equations."""
    squares: Floats
    """(n,) sums of the weighted squared residuals at x = 0."""
    constant: Floats
    """(n,) [nats] part that no refit reduces."""

    def total(self, times: Floats) -> EvidenceQuadratics:
        """Return the evidence of a drive with times (n,) [s] of the motions."""
        return EvidenceQuadratics(
            matrix=np.tensordot(times, self.matrix, 1),
            right=times @ self.right,
            squares=np.asarray(times @ self.squares),
            constant=np.asarray(times @ self.constant),
        )

    def at(self, x: Floats) -> Floats:
        """Return the evidence (n,) [nats] that remains at refitted values x (k,)."""
        return np.asarray(self.constant + 0.5 * (self.squares - 2 * self.right @ x + (self.matrix @ x) @ x))


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedScans(ScanData):
    """Planned scans, each with its own pose and twist. Questions share them and their casts."""

    motions: Sequence[MotionSamples]
    """Motions that they sample, one after the other."""
    rays_per_cast: float
    """Number of sensor rays that each ray represents."""

    def motion(self, times: Floats) -> Floats:
        """Return poses (..., 3) at times (n_scans, ...) [s] near the stamps of the scans."""
        extra = (1,) * (times.ndim - 1)
        n = self.n_scans
        later = times - self.stamps.reshape(n, *extra)
        return np.asarray(
            self.poses.reshape(n, *extra, 3) + later[..., None] * self.twists.reshape(n, *extra, 3)
        )


class EvidenceForecast:
    """Expected evidence of many motions between the two models of a question."""

    def __init__(self, question: OpenQuestion, scans: PlannedScans) -> None:
        true_cast = cast(scans, question.truth)
        truth = true_cast.expected
        data = replace(scans, ranges=_noise_free_readings(truth, scans))
        self.solver, alternative_cast = solver_for(data, question.alternative)
        true_beams, beams = true_cast.beams, alternative_cast.beams
        bent = [~b.straight for b in (true_beams, beams) if b.straight is not None]
        same_wall = np.asarray((true_beams.wall == beams.wall) & ~sum(bent, np.zeros(1, dtype=np.bool_)))
        ratio = np.square(true_beams.sigma) / np.maximum(np.square(beams.sigma), 1e-12)
        weight, constant = _weights(self.solver, truth, data, same_wall, np.clip(ratio, *VARIANCE_RATIO))
        weight, constant = scans.rays_per_cast * weight, scans.rays_per_cast * constant
        self.per_second = self._per_second(scans, weight, constant)

    def _per_second(self, scans: PlannedScans, weight: Floats, constant: Floats) -> EvidenceQuadratics:
        """Return the evidence of one second of each motion, from weights and constants (n_scans, n_rays)."""
        systems, squares, constants, begin = [], [], [], 0
        for motion in scans.motions:
            rows = np.arange(begin, begin + len(motion.poses))
            begin += len(rows)
            solver = self.solver.of_scans(rows)
            system = solver.assemble(weight[rows], 1.0)
            w = np.where(solver.jacobian.valid, weight[rows], 0.0)
            poses = np.einsum("ni,nij,nj->", system.start, system.poses, system.start)
            systems.append(system)
            squares.append(float((w * solver.y**2).sum() - poses))
            constants.append(float(constant[rows].sum()))
        scans_per_second = scans.sensor.rate / np.array([len(motion.poses) for motion in scans.motions])
        return EvidenceQuadratics(
            matrix=scans_per_second[:, None, None] * np.stack([system.matrix for system in systems]),
            right=scans_per_second[:, None] * np.stack([system.right for system in systems]),
            squares=scans_per_second * np.array(squares),
            constant=scans_per_second * np.array(constants),
        )

    def refitted(self, total: EvidenceQuadratics) -> Floats:
        """Return the nuisances and parameters (k,) at which the alternative fits a drive best."""
        tau = self.solver.tau
        g, p = boxed(total.matrix, total.right, tau, SCAN.nuisance.max_tolerances * tau, self.solver.locked)
        return np.concatenate([g, p])

    def nats(self, times: Floats) -> float:
        """Return the expected evidence [nats] of a run with times (n,) [s] of the motions."""
        total, tau = self.per_second.total(times), self.solver.tau
        x = self.refitted(total)
        prior = 0.5 * float(np.sum((x[: len(tau)] / tau) ** 2))
        return max(float(total.at(x)) + prior, 0.0)


def planned_scans(
    motions: Sequence[MotionSamples], arena: Arena, robot: Robot, run_duration: float
) -> PlannedScans:
    """Return scans at all sample moments, with fewer rays.

    Parameters
    ----------
    run_duration : [s] Of the whole run, over which time-dependent effects change.
    """
    poses = np.concatenate([m.poses for m in motions])
    v, omega = np.concatenate([m.twists for m in motions]).T
    times = np.concatenate([m.times for m in motions])
    sensor = robot.sensor
    step = max(1, -(-sensor.n_rays // NEXT_RUN.forecast.max_rays))
    rays = np.arange(step // 2, sensor.n_rays, step)
    phi = poses[:, 2]
    return PlannedScans(
        arena=arena,
        sensor=sensor.take(rays),
        tolerances=robot.tolerances,
        stamps=times,
        ranges=np.zeros((len(poses), len(rays))),
        poses=poses,
        twists=np.stack([v * np.cos(phi), v * np.sin(phi), omega], axis=1),
        track=(times, poses),
        begin=0.0,
        span=run_duration,
        laser_frame=False,
        motions=motions,
        rays_per_cast=sensor.n_rays / len(rays),
    )


def _noise_free_readings(expected: ExpectedReadings, data: ScanData) -> Floats:
    """Return the readings (n_scans, n_rays) [m] without noise; inf where no return is more likely."""
    with np.errstate(invalid="ignore"):
        seen = (expected.reading < data.sensor.range_max) & (expected.p_return > 0.5)
    return np.where(seen, expected.reading, np.inf)


def _weights(
    solver: Solver, truth: ExpectedReadings, data: ScanData, same_wall: Bools, variance_ratio: Floats
) -> tuple[Floats, Floats]:
    """Return weights [1/m²] of rays with a small difference, and the evidence [nats] of those with a large one.

    Parameters
    ----------
    same_wall : (n_scans, n_rays) Both models see the same wall, along a straight ray.
    variance_ratio : Variance of the readings under the true model over that under the alternative.
    """
    settings, expected = NEXT_RUN.forecast, solver.expected
    sigma = expected.sigma
    both = np.isfinite(truth.reading) & np.isfinite(expected.reading)
    off = np.where(both, np.where(both, truth.reading, 0.0) - np.where(both, expected.reading, 0.0), 0.0)
    p, q = _return_probability(truth, data), _return_probability(expected, data)
    counts = np.maximum(expected.p_alternative, truth.p_alternative) <= SCAN.likelihood.min_edge_chance
    near = same_wall | (np.abs(off) <= settings.linear_sigmas * sigma)
    small: Bools = solver.jacobian.valid & near & data.returned
    weight = np.where(small & counts, p / sigma**2, 0.0)
    of_variance = 0.5 * (variance_ratio - 1 - np.log(variance_ratio))
    of_difference = np.where(small, 0.0, 0.5 * (off / sigma) ** 2)
    per_return = np.minimum(of_difference + of_variance, settings.max_nats_per_ray)
    of_returning = p * np.log(p / q) + (1 - p) * np.log((1 - p) / (1 - q))
    return weight, np.where(counts, of_returning + p * q * per_return, 0.0)


def _return_probability(expected: ExpectedReadings, data: ScanData) -> Floats:
    """Return the probability of a return (n_scans, n_rays), limited away from 0 and 1."""
    p_lost = NEXT_RUN.forecast.p_lost
    aimed = np.isfinite(expected.reading)
    margin = data.sensor.range_max - np.where(aimed, expected.reading, 1e9)
    chance = expected.p_return * ndtr(margin / expected.sigma)
    return np.clip(np.where(aimed, chance, 0.0), p_lost, 1 - p_lost)
