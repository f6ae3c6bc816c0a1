"""Predict the evidence between two models that a drive will bring.

    nats = min over x of  constant + (squares - 2 right'x + x'matrix x) / 2 + |g / tau|² / 2,   x = (g, p)

The nuisances g, with prior standard deviations tau, and the smooth parameters p of the wrong model are
refitted; pose errors are eliminated. Each ray contributes half the squared difference of the two expected
readings over the variance, and the Kullback-Leibler divergence of the return probabilities. All coefficients are
proportional to time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from planners.arena import Arena
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
MAX_NATS_PER_RAY = 5.0
"""[nats] maximum evidence of a single ray."""
MAX_RAYS = 46
"""Maximum number of rays of a scan that are cast; each represents an equal number of rays."""
DECIDED_NATS = 50.0
"""[nats] lead of an effect over its rival, above which the question is closed."""


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
        self.motions, self.rate = scans.motions, scans.sensor.rate
        true_cast = cast(scans, question.truth)
        truth = true_cast.expected
        data = replace(scans, ranges=_noise_free_readings(truth, scans))
        self.solver, alternative_cast = solver_for(data, question.alternative)
        self.tau = self.solver.tau
        self.locked = self.solver.locked
        true_beams, beams = true_cast.beams, alternative_cast.beams
        bent = [~b.straight for b in (true_beams, beams) if b.straight is not None]
        same_wall = np.asarray((true_beams.wall == beams.wall) & ~sum(bent, np.zeros(1, dtype=np.bool_)))
        variance_ratio = np.square(true_beams.sigma) / np.maximum(np.square(beams.sigma), 1e-12)
        weight, constant = _weights(self.solver, truth, data, same_wall, variance_ratio)
        self.weight, self.constant = scans.rays_per_cast * weight, scans.rays_per_cast * constant

    def nats(self) -> Floats:
        """Return the expected evidence (n_motions,) [nats] of each motion; see the module."""
        out, begin = [], 0
        for motion in self.motions:
            rows = np.arange(begin, begin + len(motion.poses))
            begin += len(rows)
            solver = self.solver.of_scans(rows)
            system = solver.assemble(self.weight[rows], 1.0)
            w = np.where(solver.jacobian.valid, self.weight[rows], 0.0)
            squares = (w * solver.y**2).sum() - np.einsum(
                "ni,nij,nj->", system.start, system.poses, system.start
            )
            scans = self.rate * motion.duration / len(rows)  # that each sample stands for
            matrix, right = scans * system.matrix, scans * system.right
            limit = SCAN.nuisance.max_tolerances * self.tau
            x = boxed(matrix, right, self.tau, limit, self.locked).x
            left = scans * (self.constant[rows].sum() + 0.5 * squares) - right @ x + 0.5 * x @ matrix @ x
            out.append(max(float(left + 0.5 * np.sum((x[: len(self.tau)] / self.tau) ** 2)), 0.0))
        return np.array(out)


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
    step = max(1, -(-sensor.n_rays // MAX_RAYS))
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
    expected = solver.expected
    sigma = expected.sigma
    both = np.isfinite(truth.reading) & np.isfinite(expected.reading)
    off = np.where(both, np.where(both, truth.reading, 0.0) - np.where(both, expected.reading, 0.0), 0.0)
    p, q = _return_probability(truth, data), _return_probability(expected, data)
    counts = expected.p_alternative <= SCAN.likelihood.min_edge_chance
    counts &= truth.p_alternative <= SCAN.likelihood.min_edge_chance
    near = same_wall | (np.abs(off) <= SCAN.goodness_of_fit.clip * sigma)
    small: Bools = solver.jacobian.valid & near & data.returned
    weight = np.where(small & counts, p / sigma**2, 0.0)
    of_variance = 0.5 * (variance_ratio - 1 - np.log(variance_ratio))
    of_difference = np.where(small, 0.0, 0.5 * (off / sigma) ** 2)
    per_return = np.minimum(of_difference + of_variance, MAX_NATS_PER_RAY)
    of_returning = p * np.log(p / q) + (1 - p) * np.log((1 - p) / (1 - q))
    return weight, np.where(counts, of_returning + p * q * per_return, 0.0)


def _return_probability(expected: ExpectedReadings, data: ScanData) -> Floats:
    """Return the probability of a return (n_scans, n_rays), limited away from 0 and 1."""
    p_lost = SCAN.noise.loss[1]
    aimed = np.isfinite(expected.reading)
    margin = data.sensor.range_max - np.where(aimed, expected.reading, 1e9)
    chance = expected.p_return * ndtr(margin / expected.sigma)
    return np.clip(np.where(aimed, chance, 0.0), p_lost, 1 - p_lost)
