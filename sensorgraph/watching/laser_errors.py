"""Errors of the laser: offset and scale of the ranges, missing returns, and sectors that something blocks.

Offset b and scale s of the ranges follow from the residuals at the tracked pose. The pose is estimated with them and
eliminated, scan by scan. This is the residual e of a ray.

    c e = n · (dx, dy) + (p × n) dphi + c b + c r s.

c is the cosine of incidence, and r the range. n is the normal of the surface, and p the end point in base_link.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from scipy.special import bdtrc

from sensorgraph.localization.scans import ScanPoints
from sensorgraph.models.base import Prediction
from sensorgraph.robust import SIGMA_OF_MAD
from sensorgraph.types import Bools, Floats
from sensorgraph.watching.readings import GraphReadings
from sensorgraph.watching.settings import FAULTS_PER_HOUR, LASER_FAULTS, ROBOT, RobotPriors

MOST_RESIDUAL = 0.2
"""[m] A larger residual shows another surface."""
NOISE = 0.03
"""[m] Residual at which a ray counts half (Cauchy)."""
MEDIAN_TO_MEAN = math.sqrt(math.pi / 2)
"""Ratio of the standard error of a median to that of a mean, for a normal distribution."""
LEAST_SCATTER = 0.003
"""Least standard deviation of the share of a scan: one ray of 360."""
BLOCK = 8
"""Number of neighbouring rays that are judged together."""
CHANCE = 0.01
"""Probability that so many of them are missing by chance, below which something is in front of them."""
MOST_SCANS = 2000
"""Number of scans of which missing returns are kept: enough for two periods of driving. Older ones are dropped."""
STEPS = 4
"""Number of weightings of the rays of a scan."""


class RangeOffset:
    """Follows an offset of the ranges, with the prior of this fault, so that a laser that errs is not a robot that is lost."""

    def __init__(self) -> None:
        self.value = 0.0
        """[m]"""
        self._variance = LASER_FAULTS[0].size ** 2

    def add(self, residuals: Floats, share: float, weight: float) -> None:
        """Take the residuals (n_rays,) [m] of a scan, less the offset so far.

        Parameters
        ----------
        share : Share of independent readings.
        weight : Share of new evidence in the scan.
        """
        near = residuals[np.abs(residuals) < MOST_RESIDUAL]
        if len(near) < 20 or weight <= 0.0:
            return
        variance = (MEDIAN_TO_MEAN * NOISE) ** 2 / (weight * share * len(near))
        gain = self._variance / (self._variance + variance)
        self.value += gain * float(np.median(near))
        self._variance = max(self._variance * (1.0 - gain), LASER_FAULTS[0].tolerance ** 2)


class RangeErrors:
    """Collects the normal equations of offset and scale."""

    freedom = math.inf
    """The noise of a ray is stated."""

    def __init__(self) -> None:
        self.age = 0.0
        self.information, self.vector = np.zeros((2, 2)), np.zeros(2)

    def add(
        self, readings: GraphReadings, scan: ScanPoints, prediction: Prediction, ranges: Floats, weight: float
    ) -> None:
        """Add a scan that was matched."""
        at = np.full(readings.sensor.n_rays, -1, dtype=np.intp)
        at[scan.rays] = np.arange(len(scan.rays))
        own = at[readings.rays]
        z, predicted = ranges[readings.rays], prediction.mode[0]
        with np.errstate(invalid="ignore"):
            used = (own >= 0) & prediction.answered[0] & (np.abs(z - predicted) < MOST_RESIDUAL)
        if used.sum() < 20:
            return
        p, start = scan.points[own[used]], scan.starts[own[used]]
        normal = scan.normals[own[used]]
        is_line = np.abs(np.hypot(*normal.T) - 1.0) < 1e-3
        r = z[used]
        cosine = np.abs(((p - start) * normal).sum(axis=1)) / np.maximum(r, 1e-6)
        residual = cosine * (r - predicted[used])
        pose = np.column_stack([normal, p[:, 0] * normal[:, 1] - p[:, 1] * normal[:, 0]])
        rows = np.column_stack([pose, cosine, cosine * r])
        prior = np.diag([1e-6] * 3 + [1.0 / fault.size**2 for fault in LASER_FAULTS])
        left = residual
        for _ in range(STEPS):  # robust weights of what pose, offset and scale do not explain
            weights = is_line * (cosine > 0.3) / (NOISE**2 + left**2)
            normal_matrix = (rows * weights[:, None]).T @ rows
            vector = (rows * weights[:, None]).T @ residual
            left = residual - rows @ np.linalg.solve(normal_matrix + prior, vector)
        normal_matrix[:3, :3] += 1e-6 * np.eye(3)
        gain = np.linalg.solve(normal_matrix[:3, :3], normal_matrix[:3, 3:]).T
        share = weight * readings.priors.independent
        self.information += share * (normal_matrix[3:, 3:] - gain @ normal_matrix[:3, 3:])
        self.vector += share * (vector[3:] - gain @ vector[:3])

    def estimates(self) -> tuple[Floats, Floats]:
        """Return values and standard errors (2,) of offset [m] and scale, each with the prior of the other."""
        prior = np.array([fault.size for fault in LASER_FAULTS]) ** 2
        covariance = np.linalg.inv(self.information + np.diag(1.0 / prior))
        mean, variance = covariance @ self.vector, np.diag(covariance)
        own = 1.0 / np.maximum(1.0 / variance - 1.0 / prior, 1e-9)
        return mean / variance * own, np.sqrt(own)


class MissingReturns:
    """Collects the share of missing returns of each scan beyond the predicted one.

    A fault of the laser shows in every scan, a door that was opened in some: the median tells them apart. Neighbours that are mostly
    missing do not count.
    """

    def __init__(self) -> None:
        self.age = 0.0
        self.scans: deque[tuple[float, float]] = deque(maxlen=MOST_SCANS)
        """Share and weight of each scan."""

    def add(self, share: float, weight: float) -> None:
        """Add the share of missing returns of a scan beyond the predicted one."""
        self.scans.append((share, weight))

    def estimates(self) -> tuple[Floats, Floats]:
        """Return the median excess share and its standard error, (1,) each."""
        shares, weights = np.array(self.scans).reshape(-1, 2).T
        if weights.sum() <= 3.0:
            return np.zeros(1), np.full(1, math.inf)
        middle = _median(shares, weights)
        sd = max(SIGMA_OF_MAD * _median(np.abs(shares - middle), weights), LEAST_SCATTER)
        return np.array([middle]), np.array([MEDIAN_TO_MEAN * sd / math.sqrt(self.freedom + 1.0)])

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the standard error, which is the scatter of the scans."""
        weights = np.array(self.scans).reshape(-1, 2)[:, 1]
        return max(float(weights.sum() ** 2 / max((weights**2).sum(), 1e-9)) - 1.0, 1.0)


def in_a_block(missing: Bools, asked: Bools) -> Bools:
    """Return which rays (n,) are among `BLOCK` neighbours most of whose readings are missing: covered or open, no random loss.

    Most are more than half, and more than chance explains if readings are lost at random as often as in most neighbourhoods.
    """
    ones = np.ones(BLOCK)
    share = np.convolve(missing, ones) / np.maximum(np.convolve(asked, ones), BLOCK / 2)
    whole = np.convolve(asked, ones) == BLOCK
    loss = min(float(np.median(share[whole])), 1.0) if whole.any() else 0.0
    counts = np.arange(BLOCK + 1)
    most = max(BLOCK / 2, float(counts[bdtrc(counts, BLOCK, loss) <= CHANCE][0])) / BLOCK
    return np.asarray(np.convolve(share > most, ones)[BLOCK - 1 : BLOCK - 1 + len(missing)] > 0.5)


def _median(values: Floats, weights: Floats) -> float:
    """Return the weighted median."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


class BlockedSectors:
    """Judges for each sector of the laser whether something covers it: close readings or none, whatever is ahead."""

    def __init__(self, readings: GraphReadings, priors: RobotPriors = ROBOT) -> None:
        self.priors = priors
        bearings = readings.sensor.bearings[readings.rays]
        sector = np.floor((bearings - bearings.min()) / priors.sector).astype(np.intp)
        n = int(sector.max()) + 1
        self.members = np.zeros((n, len(bearings)))
        self.members[sector, np.arange(len(bearings))] = 1.0
        self.middle = (self.members @ bearings) / self.members.sum(axis=1)
        self.nats = np.zeros(n)
        self.log_odds = math.log(FAULTS_PER_HOUR / 3600.0 * priors.sector_window / n)

    def add(self, is_covered: Bools, expected: Floats, asked: Bools, weight: float, dt: float) -> None:
        """Add a scan: which rays are too close or missing, with the predicted probability of that, where the graph knows.

        A laser that loses readings everywhere is not covered: the loss of a quarter of the sectors counts as that of all.
        """
        s = self.priors
        n = self.members @ asked
        share = (self.members @ (is_covered & asked)) / np.maximum(n, 1.0)
        usual = (self.members @ np.where(asked, expected, 0.0)) / np.maximum(n, 1.0)
        loss = float(np.quantile((share - usual)[n > 0], 0.25)) if (n > 0).any() else 0.0
        stray = np.clip(usual + s.stray + max(loss, 0.0), s.stray, 0.9)
        gain = share * np.log(s.blocked / stray) + (1 - share) * np.log((1 - s.blocked) / (1 - stray))
        gain = np.where(n > 0, gain, 0.0)
        most = s.sector_window / max(dt, 1e-3)  # evidence of an old window is forgotten
        self.nats = np.clip(self.nats * (1.0 - 1.0 / max(most, 1.0)) + weight * gain, self.log_odds, 60.0)

    def blocked(self) -> Bools:
        """Return which sectors are probably blocked."""
        return self.nats + self.log_odds > 0.0

    def rays(self) -> Bools:
        """Return which of the compared rays are in a blocked sector."""
        return np.asarray(self.blocked() @ self.members > 0)
