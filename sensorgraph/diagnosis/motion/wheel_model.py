"""Regression of reference poses on wheels: effects, slippery patches, structure, and the noise of the rows.

    y = A theta + noise,   y = reference minus wheels

All effects except the clock and the place of a patch are linear. Rows are whitened, so that scales are
determined over long stretches and patches and clocks over short ones, as the noise of camera and wheels
requires. Rows across the heading have columns of the setup only: a reference that is mounted askew or ahead of
the axle, and positions that are older than the headings.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planners.kernel import outer_kernel
from sensorgraph.diagnosis.motion.consequence import SimulationError, simulation_error
from sensorgraph.diagnosis.motion.increments import WheelIncrements, clock_sigma
from sensorgraph.diagnosis.motion.reference_noise import FILTER_ORDER
from sensorgraph.diagnosis.motion.regression import (
    BoundedPrior,
    Fit,
    Regression,
    Term,
    clusters_of,
    ridge_solution,
)
from sensorgraph.diagnosis.motion.structure_test import TestedFamily
from sensorgraph.diagnosis.motion.wheel_rows import WINDOW, OdometryRows, fused_motion
from sensorgraph.diagnosis.motion.wheel_structure import in_curves
from sensorgraph.diagnosis.motion.whitening import Whitener, WhiteningFilter, by_kind, clipped
from sensorgraph.diagnosis.motion.whitening import fit_autoregression as fit_filter
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.effects.interfaces import DrivenMotion
from sensorgraph.effects.pose_clock_offset import POSE_CLOCK_OFFSET
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS
from sensorgraph.effects.wheel_slip import WHEEL_SLIP
from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot

RIM = 0.02
"""[m] width of the edge of a patch, and minimum standard error of its place: about the length of an increment."""
MARKER_SIGMA = 0.003
"""[m] standard deviation of the distance between the axle and the base_link of the reference."""
ASKEW_SIGMA = 0.014
"""[rad] standard deviation of the misalignment of a reference that counts as setup: at most 2°, with the bound of all
tolerances."""
STAMP_AVERAGING = 8.0
"""Ratio of the tolerance of one stamp to the error of the mean over a run."""


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


class WheelModel:
    """Regression of one run at the current state of the search, which adds and removes patches and structure."""

    channel = "odometry"

    def __init__(self, rows: OdometryRows, wheels: WheelIncrements, robot: Robot) -> None:
        self.rows, self.wheels, self.robot = rows, wheels, robot
        found = [(effect, effect.diagnostics.regressor) for effect in EFFECTS.values()]
        self.regressors = [(effect, one) for effect, one in found if one and effect.channel == self.channel]
        self.clock = len(self.regressors)
        """Column of the clock offset; those of the setup follow."""
        self.n_own = self.clock + 5
        """Number of columns before those of patches and structure."""
        effects = [*(effect for effect, _ in self.regressors), POSE_CLOCK_OFFSET]
        self.effects = tuple(Term(effect, k) for k, effect in enumerate(effects))
        """Effects that act everywhere."""
        self.terms = [*self.effects]
        """Hypotheses that may enter the model."""
        self.y = rows.of_kinds(
            rows.along - rows.D_along @ wheels.distance,
            rows.yaw - rows.D_yaw @ wheels.turn,
            rows.across - rows.D_across @ wheels.distance,
        )
        self.motion = wheels
        self.A = self._own_columns()
        self.clusters = clusters_of(rows.stamps, 3)
        self.patches: list[SlipPatch] = []
        self.structure: TestedFamily | None = None
        self.tested: list[TestedFamily] = []
        """For the ledger."""
        self.last_patch: tuple[SlipPatch, float] | None = None
        """The best further patch, and its evidence [nats], when the selection ended."""
        sigmas = [float(np.std(part[rows.valid]) + 1e-12) for part in by_kind(self.y, rows.n)]
        filters = tuple(WhiteningFilter.white(FILTER_ORDER, sigma) for sigma in sigmas)
        self.whitener = Whitener.plain(filters, rows.valid)
        self.fit_noise()

    # rows and columns

    def allow_askew(self) -> None:
        """Let the body move at an angle to its heading: the reference measures the heading of the base itself."""
        self.terms.append(Term(None, self.clock + 2, "askew"))

    def _own_columns(self) -> Floats:
        """Return the columns (3 n, n_own): wheel effects, the clock, and the setup of the reference.

        A marker off the axle swings as the robot turns.
        """
        rows, motion = self.rows, self.motion
        distance, turn, nothing = rows.D_along @ motion.distance, rows.D_yaw @ motion.turn, np.zeros(rows.n)
        moved = DrivenMotion(
            distance=distance, turn=turn, path=rows.D_yaw @ motion.distance, base=self.robot.wheels.base
        )
        columns = [rows.of_kinds(*one.column(moved)) for _, one in self.regressors]
        columns.append(rows.of_kinds(*rows.slopes.T))
        columns.append(rows.of_kinds(-turn, nothing))
        columns += [
            rows.of_kinds(nothing, nothing, some) for some in (distance, turn, in_curves(rows, motion))
        ]
        return np.stack(columns, axis=1)

    def slip_columns(self, discs: Floats, track: float) -> Floats:
        """Return the motion of the wheels inside discs (k, 3), with a minus because it is lost: (2 n, k).

        Rows across the heading show nothing of it.

        Parameters
        ----------
        track : [m] Distance between the wheels that slip separately; 0: both are at the middle of the body.
        """
        apart = track or self.robot.wheels.base  # for two points at the middle, any value gives the same
        middle, phi = self.rows.increment_poses[:, :2], self.rows.increment_poses[:, 2]
        aside = track / 2 * np.stack([-np.sin(phi), np.cos(phi)], axis=1)
        left, right = self.motion.sides(apart)
        distance, turn = lost_inside(middle + aside, middle - aside, left, right, apart, discs, RIM)
        return -self.rows.masked(np.concatenate([self.rows.D_along @ distance, self.rows.D_yaw @ turn]))

    # noise

    def fit_noise(self) -> None:
        """Fit the noise to the residual with all wheel effects free, and whiten the rows with it.

        Structure is included only if accepted. Otherwise its many smooth columns would absorb the slow noise
        of the wheels, and the rest would seem too accurate.
        """
        self.whiten()
        scaled = self.columns / np.maximum(np.linalg.norm(self.columns, axis=0), 1e-12)
        valid, n = self.rows.valid, self.rows.n
        for _ in range(2):
            theta = ridge_solution(self.whitener(scaled), self.whitener(self.y))
            self.residual = self.y - scaled @ theta
            taken = 1 / np.sqrt(1 - 0.5 * len(theta) / max(2 * valid.sum(), 1))
            filters = tuple(
                fit_filter(
                    clipped(part, valid, SCAN.goodness_of_fit.clip, 1e-12) * taken, valid, FILTER_ORDER
                )
                for part in by_kind(self.residual, n)
            )
            self.whitener = Whitener.robust(filters, valid, self.residual)
        self.whiten()

    def denoise_motion(self) -> None:
        """Recompute all columns from the motion without the wheels' noise, as far as the residual shows it."""
        self.motion = fused_motion(self.rows, self.wheels, self.residual)
        self.A = self._own_columns()
        self.fit_noise()

    def whiten(self) -> None:
        """Form columns (3 n, n_own + patches + structure) and regression again, after a change of model or noise."""
        parts = [self.A]
        if self.patches:
            lost = np.concatenate(
                [self.slip_columns(one.disc[None], one.track) for one in self.patches], axis=1
            )
            parts.append(np.concatenate([lost, np.zeros((self.rows.n, len(self.patches)))]))
        if self.structure is not None:
            parts.append(self.structure.family.columns)
        self.columns = np.concatenate(parts, axis=1)
        self.regression = Regression.of(self.whitener(self.columns), self.whitener(self.y))

    # evidence

    def patch_term(self, i: int) -> Term:
        """Return the term of a patch."""
        return Term(WHEEL_SLIP, self.n_own + i)

    def prior(self, terms: Sequence[Term], fit: Fit | None = None) -> BoundedPrior:
        """Return the prior of the columns with some hypotheses free; other patches are fixed at 0."""
        sigma = [one.tolerance for _, one in self.regressors]
        sigma += [clock_sigma(self.robot), MARKER_SIGMA, ASKEW_SIGMA, np.inf, clock_sigma(self.robot)]
        if all(term.family != "askew" for term in self.terms):
            sigma[self.clock + 2] = np.inf  # the mount of a laser may be askew by any angle
        sigma += [0.0] * len(self.patches)
        k = len(sigma)
        if self.structure is not None:
            sigma += [self.structure.family.sigma] * self.structure.family.columns.shape[1]
        mean = np.zeros(len(sigma))
        mean[self.clock] = -self.rows.clock
        prior = BoundedPrior.of(np.array(sigma), mean, SCAN.nuisance.max_tolerances)
        return prior.freed([term.column for term in terms]).unbounded_from(k)

    def fit(self, terms: Iterable[Term], start: Fit | None = None) -> Fit:
        """Return the bounded optimum of a set of hypotheses."""
        solution = self.regression.solve(self.prior([*terms]))
        return Fit(
            regression=self.regression,
            solution=solution,
            columns=self.columns,
            y=self.y,
            simulated=np.zeros_like(self.y),
        )

    # report

    def error_without(self, fit: Fit, missing: Floats) -> SimulationError:
        """Return the error of a simulation that lacks rows (3 n,) [m, rad, m] of the motion."""
        rows, motion = self.rows, self.motion
        distance, turn = rows.D_along @ motion.distance, rows.D_yaw @ motion.turn
        dt = np.gradient(rows.stamps)
        ahead, aside = missing[: 2 * rows.n], missing[2 * rows.n :]
        return simulation_error(distance, turn, ahead, dt, self.robot.wheels.base, aside)

    def sized(self, term: Term, fit: Fit, error: float) -> Amendment:
        """Return an effect with its size and standard error, from the standard error of its coefficient."""
        theta, effect = float(fit.solution.theta[term.column]), term.named
        if effect is WHEEL_SLIP:
            return self._slip(self.patches[term.column - self.n_own], theta, error)
        key, regressor = effect.parameters[0].name, effect.diagnostics.regressor
        if regressor is not None:
            radius = [k for k, (one, _) in enumerate(self.regressors) if one is WHEEL_RADIUS]
            gain = 1 + float(fit.solution.theta[radius].sum())
            value, stderr = regressor.size(theta, gain), regressor.stderr(error, gain)
        else:  # the clock: no more accurate than the mean of the run's stamps
            value = float(self.rows.clock + theta)
            stderr = float(np.hypot(error, self.robot.tolerances.stamp / STAMP_AVERAGING))
        return replace(effect(**{key: value}), stderr={key: stderr})

    def _slip(self, patch: SlipPatch, share: float, error: float) -> Amendment:
        """Return a patch with its place; the standard errors combine those of the fit and of the search."""
        width = np.sqrt(np.diag(patch.covariance))
        stderr = {"s": float(np.hypot(error, width[0]))} | {
            key: float(np.hypot(w, RIM)) for key, w in zip("xyr", width[1:], strict=True)
        }
        slip = WHEEL_SLIP(s=float(np.clip(share, 0, 1)), x=patch.x, y=patch.y, r=patch.r)
        return replace(slip, stderr=stderr).at(xy=(patch.x, patch.y))

    def words_of(self, freed: Mapping[int, float]) -> str:
        """Return the statement of a reference that is askew by more than 2° [rad]."""
        (angle,) = freed.values()
        side = "left" if angle > 0 else "right"
        words = f"a direction of travel {np.degrees(abs(angle)):.1f}° to the {side} of the body's heading"
        return f"{words}: the axle or the markers of the reference are misaligned"

    @property
    def nominal_residual(self) -> Floats:
        """(3 n,) without any correction; the clock is as stamped."""
        return self.y + self.rows.clock * self.columns[:, self.clock]

    def rates_of(self, residual: Floats) -> tuple[Floats, Floats]:
        """Return speeds and turn rates [m/s, rad/s] of a residual (3 n,), averaged over a second."""
        step = float(np.median(np.diff(self.rows.stamps)))
        m = max(1, round(WINDOW / step))
        k = self.rows.n // m
        parts = by_kind(self.rows.masked(residual), self.rows.n)[:2]
        v, omega = (part[: k * m].reshape(k, m).sum(axis=1) / (m * step) for part in parts)
        return v, omega


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
    distance, turn = np.empty((2, len(left), len(discs)))
    x, y, radius = np.ascontiguousarray(discs.T)
    _sum_lost(left_at, right_at, left, right, track, x, y, radius, rim, distance, turn)
    return distance, turn


@outer_kernel
def _sum_lost(
    left_at: Floats,
    right_at: Floats,
    left: Floats,
    right: Floats,
    track: float,
    x: Floats,
    y: Floats,
    radius: Floats,
    rim: float,
    distance: Floats,
    turn: Floats,
) -> None:
    """Fill `distance` and `turn` as of `lost_inside`; x, y, radius: (n_discs,) [m]."""
    per_way = 1 / rim
    for i in range(len(left)):
        for j in range(len(x)):
            until = radius[j] * per_way + 0.5
            dx, dy = left_at[i, 0] - x[j], left_at[i, 1] - y[j]
            lost_left = left[i] * min(max(until - np.sqrt(dx * dx + dy * dy) * per_way, 0.0), 1.0)
            dx, dy = right_at[i, 0] - x[j], right_at[i, 1] - y[j]
            lost_right = right[i] * min(max(until - np.sqrt(dx * dx + dy * dy) * per_way, 0.0), 1.0)
            distance[i, j] = (lost_left + lost_right) / 2
            turn[i, j] = (lost_right - lost_left) / track
