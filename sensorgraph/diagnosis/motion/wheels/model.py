"""Regression of reference poses on wheels: effects, slippery patches, structure, and the noise of the rows.

    y = A theta + noise,   y = reference minus wheels

All effects except the clock and the place of a patch are linear. Rows are whitened, so that scales are
determined over long stretches and patches and clocks over short ones, as the noise of camera and wheels
requires.

For the columns of structure, the motion of the wheels is estimated without its noise:

    total_t = walk_t + level noise,   walk_t = walk_(t-1) + step      (local-level model)

Rows are reference minus wheels. A column made of the wheels' readings shares its noise with the rows (errors
in variables). This attenuates every scale. It also creates false scales where a column selects increments by
their noisy speed, or by standstill (Fuller 1987, chapter 1). By the Gauss-Markov theorem, the best estimate
of the motion from wheels and reference is uncorrelated with their difference. Columns made of that estimate
therefore find nothing in pure noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solveh_banded

from planners.kernel import kernel
from sensorgraph.diagnosis.motion.consequence import SimulationError, simulation_error
from sensorgraph.diagnosis.motion.increments import WheelIncrements
from sensorgraph.diagnosis.motion.reference_noise import FILTER_ORDER
from sensorgraph.diagnosis.motion.regression import (
    SHUT_SIGMA,
    BoundedPrior,
    Regression,
    Term,
    clusters_of,
    ridge_solution,
)
from sensorgraph.diagnosis.motion.settings import EVIDENCE
from sensorgraph.diagnosis.motion.structure_test import AcceptedStructure, TestedStructure
from sensorgraph.diagnosis.motion.wheels.rows import OdometryRows, WheelColumns, wheel_rows
from sensorgraph.diagnosis.motion.whitening import Whitener, WhiteningFilter, both_kinds, clipped
from sensorgraph.diagnosis.motion.whitening import fit_autoregression as fit_filter
from sensorgraph.effects.wheel_slip import WHEEL_SLIP
from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot

CLOCK_TOLERANCE_SHARE = 0.6
"""Standard deviation of a clock offset that needs no effect, as a share of the tolerance of one stamp."""
CLOCK_TOLERANCE_RANGE = (0.0015, 0.0035)
"""[s] minimum and maximum of that standard deviation."""
RIM = 0.02
"""[m] width of the edge of a patch, and minimum standard error of its place: about the length of an increment."""
MARKER_SIGMA = 0.003
"""[m] standard deviation of the distance between the axle and the base_link of the reference."""
MAX_CLOCK_SHIFT = 0.02
"""[s] maximum change of the clock offset at that time."""
RADIUS_RANGE = (0.1, 2.5)
"""[m] smallest and largest radius of a patch."""
STRUCTURE_THRESHOLD = 20.0
"""[nats] evidence that structure needs if the residual is white; proportionally more otherwise."""
MIN_RATIO = 1e-9
"""Ratio of walk and level noise, at which the walk is practically constant."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SlipPatch:
    """A slippery disc."""

    x: float
    y: float
    r: float
    """[m, map]"""
    track: float
    """[m] distance between the points that slip separately: the wheelbase; 0: the body slips as a whole, at
    its middle."""
    covariance: Floats
    """(4, 4) of s, x, y, r from the search."""

    @property
    def disc(self) -> Floats:
        """(3,) x, y, r [m, map]"""
        return np.array([self.x, self.y, self.r])

    @property
    def is_unbounded(self) -> bool:
        """Whether the disc may have the maximum radius: its rim is then unknown, and it may not be a disc."""
        return bool(self.r + 2 * np.sqrt(self.covariance[3, 3]) >= RADIUS_RANGE[1])


def clock_sigma(robot: Robot) -> float:
    """Return the standard deviation of a clock offset that needs no effect [s]."""
    return float(np.clip(CLOCK_TOLERANCE_SHARE * robot.tolerances.stamp, *CLOCK_TOLERANCE_RANGE))


class WheelModel:
    """Regression of one run at the current state of the search, which adds and removes patches and structure."""

    def __init__(self, rows: OdometryRows, wheels: WheelIncrements, robot: Robot) -> None:
        self.rows, self.wheels, self.robot = rows, wheels, robot
        self.layout = WheelColumns.of_library()
        self.y = wheel_rows(rows, wheels)
        self.motion = wheels
        self.A = self.layout.evaluate(rows, wheels, robot.wheels.base)
        self.clusters = clusters_of(rows.stamps)
        self.patches: list[SlipPatch] = []
        self.structure: AcceptedStructure | None = None
        self.tested: list[TestedStructure] = []
        """Tests for structure, for the ledger."""
        self.last_patch: tuple[SlipPatch, float] | None = None
        """The best further patch, and its evidence [nats], when the selection ended."""
        raw, order = both_kinds(self.y, rows.n), FILTER_ORDER
        first, second = (WhiteningFilter.white(order, float(np.std(y[rows.valid]) + 1e-12)) for y in raw)
        self.whitener = Whitener.plain((first, second), rows.valid)
        self.fit_noise()

    # rows and columns

    @property
    def columns(self) -> Floats:
        """(2 n, layout.n + patches + structure)"""
        parts = [self.A]
        if self.patches:
            parts += [self.slip_columns(patch.disc[None], patch.track) for patch in self.patches]
        if self.structure is not None:
            parts.append(self.structure.family.columns)
        return np.concatenate(parts, axis=1)

    def slip_columns(self, discs: Floats, track: float) -> Floats:
        """Return the motion of the wheels inside discs (k, 3), with a minus because it is lost: (2 n, k).

        Parameters
        ----------
        track : [m] Distance between the wheels that slip separately; 0: both are at the middle of the body.
        """
        apart = track or self.robot.wheels.base  # for two points at the middle, any value gives the same
        middle, phi = self.rows.increment_poses[:, :2], self.rows.increment_poses[:, 2]
        aside = track / 2 * np.stack([-np.sin(phi), np.cos(phi)], axis=1)
        left, right = self.motion.sides(apart)
        lost = lost_inside(middle + aside, middle - aside, left, right, apart, discs, RIM)
        return -self.rows.of_wheels(*lost)

    # noise

    def fit_noise(self) -> None:
        """Fit the noise to the residual with all wheel effects free, and whiten the rows with it.

        Structure is included only if accepted. Otherwise its many smooth columns would absorb the slow noise
        of the wheels, and the rest would seem too accurate.
        """
        self.whitener, self.residual = self._fitted_noise(self.columns)
        self.whiten()

    def denoise_motion(self) -> None:
        """Recompute all columns from the motion without the wheels' noise, as far as the residual shows it."""
        self.motion = fused_motion(self.rows, self.wheels, self.residual)
        self.A = self.layout.evaluate(self.rows, self.motion, self.robot.wheels.base)
        self.fit_noise()

    def whiten(self) -> None:
        """Form the regression again, after a change of the columns or the noise."""
        self.regression = Regression.of(self.whitener(self.columns), self.whitener(self.y))

    def _fitted_noise(self, columns: Floats) -> tuple[Whitener, Floats]:
        """Fit columns and noise in turn, twice, from the current noise; return the noise and the residual (2 n,)."""
        scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
        settings, valid, whitener = EVIDENCE, self.rows.valid, self.whitener
        for _ in range(2):
            theta = ridge_solution(whitener(scaled), whitener(self.y))
            residual = self.y - scaled @ theta
            taken = 1 / np.sqrt(1 - 0.5 * len(theta) / max(2 * valid.sum(), 1))
            first, second = (
                fit_filter(clipped(part, valid, settings.clip_limit, 1e-12) * taken, valid, FILTER_ORDER)
                for part in both_kinds(residual, self.rows.n)
            )
            whitener = Whitener.robust((first, second), valid, residual, settings.huber_limit)
        return whitener, residual

    # evidence

    def patch_term(self, i: int) -> Term:
        """Return the term of a patch."""
        return Term(WHEEL_SLIP, self.layout.n + i)

    def prior(self, terms: Sequence[Term]) -> BoundedPrior:
        """Return the prior of the columns with some effects free; other patches are fixed at 0."""
        sigma = [regressor.tolerance for _, regressor in self.layout.regressors]
        sigma += [clock_sigma(self.robot), MARKER_SIGMA]
        sigma += [SHUT_SIGMA] * len(self.patches)
        k = len(sigma)
        if self.structure is not None:
            sigma += [self.structure.family.sigma] * self.structure.family.columns.shape[1]
        mean = np.zeros(len(sigma))
        mean[self.layout.clock] = -self.rows.clock
        prior = BoundedPrior.of(np.array(sigma), mean, EVIDENCE.max_tolerances)
        return prior.freed([term.column for term in terms]).unbounded_from(k)

    def error_without(self, missing: Floats) -> SimulationError:
        """Return the error of a simulation that lacks rows (2 n,) [m, rad] of the motion."""
        rows, motion = self.rows, self.motion
        distance, turn = rows.D_along @ motion.distance, rows.D_yaw @ motion.turn
        return simulation_error(distance, turn, missing, np.gradient(rows.stamps), self.robot.wheels.base)

    def clock_left(self) -> float:
        """Return the remaining error of the assumed clock offset, with all effects free [s]."""
        most = MAX_CLOCK_SHIFT
        theta = self.regression.solve(self.prior(self.layout.terms)).theta
        return float(np.clip(theta[self.layout.clock], -most, most))

    def log_posterior(self, terms: Sequence[Term]) -> float:
        """Return the penalised log-likelihood of a set of effects [nats]."""
        return self.regression.solve(self.prior(terms)).log_posterior

    def evidence(self, terms: Sequence[Term], term: Term) -> float:
        """Return the evidence of an effect in addition to a set, less its complexity penalty [nats]."""
        rest = [other for other in terms if other != term]
        return self.log_posterior([*rest, term]) - self.log_posterior(rest) - price(term)


def price(term: Term) -> float:
    """Return the complexity penalty of an effect [nats]."""
    return EVIDENCE.price * len(term.effect.parameters)


@kernel
def lost_inside(
    left_at: Floats, right_at: Floats, left: Floats, right: Floats, track: float, discs: Floats, rim: float
) -> tuple[Floats, Floats]:
    """Return distance [m] and turn [rad] (n_increments, n_discs) that two points of the body lose inside discs.

        lost     = length clip((r - d) / rim + 1/2, 0, 1)      for each point
        distance = (lost_left + lost_right) / 2,   turn = (lost_right - lost_left) / track

    d is the distance of the point from the centre of the disc.

    Parameters
    ----------
    left_at, right_at : (n_increments, 2) [m, map] Positions of the points.
    left, right : (n_increments,) [m] Signed lengths of their paths.
    track : [m] Distance between them.
    discs : (n_discs, 3) x, y, r [m, map].
    rim : [m] Width of the edge.
    """
    n, k = len(left), len(discs)
    x, y = discs[:, 0].copy(), discs[:, 1].copy()
    per_way = 1 / rim
    until = discs[:, 2] * per_way + 0.5
    distance, turn = np.empty((n, k)), np.empty((n, k))
    for i in range(n):
        for j in range(k):
            dx, dy = left_at[i, 0] - x[j], left_at[i, 1] - y[j]
            lost_left = left[i] * min(max(until[j] - np.sqrt(dx * dx + dy * dy) * per_way, 0.0), 1.0)
            dx, dy = right_at[i, 0] - x[j], right_at[i, 1] - y[j]
            lost_right = right[i] * min(max(until[j] - np.sqrt(dx * dx + dy * dy) * per_way, 0.0), 1.0)
            distance[i, j] = (lost_left + lost_right) / 2
            turn[i, j] = (lost_right - lost_left) / track
    return distance, turn


def fused_motion(rows: OdometryRows, wheels: WheelIncrements, residual: Floats) -> WheelIncrements:
    """Return the increments of the wheels less their noise, as far as the reference shows it.

    Their noise is a random walk, seen in the noise of the averaged reference. It is smoothed with the
    local-level model (Durbin and Koopman 2012, section 2.4). The residual determines both variances.

    Parameters
    ----------
    residual : (2 n,) [m], then [rad]; residual of the model.
    """
    ends = np.append(wheels.start, wheels.end[-1]) - rows.clock
    noise = [np.diff(_wheel_noise(part, rows, ends)) for part in both_kinds(residual, rows.n)]
    return replace(wheels, distance=wheels.distance + noise[0], turn=wheels.turn + noise[1])


def _wheel_noise(residual: Floats, rows: OdometryRows, ends: Floats) -> Floats:
    """Return the accumulated noise of the wheels at the ends of the increments, from a residual (n,)."""
    part = np.where(rows.valid, clipped(residual, rows.valid, EVIDENCE.clip_limit, 1e-12), 0.0)
    period = float(np.median(np.diff(rows.stamps)))
    walk, level = _variances(part, period)
    smooth = _smoothed_walk(np.cumsum(part), max(walk / level, MIN_RATIO))
    return np.asarray(np.interp(ends, rows.stamps, smooth))


def _smoothed_walk(total: Floats, ratio: float) -> Floats:
    """Return the smoothed walk x (n,) in a sum `total` (n,).

        minimise  |total - x|² + |diff x|² / ratio

    Parameters
    ----------
    ratio : Variance of one step of the walk over that of the noise of the level.
    """
    bands = np.full((2, len(total)), -1.0 / ratio)
    bands[1] = 1.0 + 2.0 / ratio
    bands[1, [0, -1]] = 1.0 + 1.0 / ratio
    bands[0, 0] = 0.0
    return np.asarray(solveh_banded(bands, total))


def _variances(residual: Floats, period: float) -> tuple[float, float]:
    """Return the variances of one step of the walk and of the noise of the level.

        walk = (block - single) / (k - 2/3),   level = (single - 2/3 walk) / 2

    single and block are the mean squares of rows and of sums over k rows. Such a sum grows with the walk
    only.
    """
    k = max(round(EVIDENCE.cluster / period), 2)
    n = max(len(residual) // k, 1)
    single = float(np.mean(residual**2)) + 1e-18
    block = float(np.mean(residual[: n * k].reshape(n, -1).sum(axis=1) ** 2))
    walk = float(np.clip((block - single) / (k - 2 / 3), 0.0, 1.5 * single))
    return walk, max((single - 2 / 3 * walk) / 2, 1e-18)
