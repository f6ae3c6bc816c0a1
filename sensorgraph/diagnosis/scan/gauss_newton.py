"""Joint fit of effects and nuisances: Gauss-Newton on the mixture, with the pose error of every scan eliminated.

The residuals y of a scan depend on its pose error delta, the nuisances g and the effects' smooth parameters p.

    y = B delta + S [g, p],    delta ~ N(0, P),    g ~ N(0, tau²).

Given the responsibilities of the mixture, each Gauss-Newton step solves weighted normal equations with weights W. The pose
error of each scan is eliminated by the Schur complement (Triggs, McLauchlan, Hartley and Fitzgibbon 2000, bundle
adjustment, section 6; see `normal_equations`). The objective integrates poses and nuisances out (Laplace approximation).

    J = Σ log p - ½ Σ deltaᵀ P⁻¹ delta - ½ Σ log |I + P BᵀWB| - ½ Σ (g / tau)² - ½ log |I + tau M tau|.

M is the block of the nuisances in the normal matrix, after elimination of the poses.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.lapack import dtrtri
from scipy.special import chdtri, ndtr

from sensorgraph.diagnosis.scan.corner_sums import Corners, corner_sums
from sensorgraph.diagnosis.scan.jacobian import Jacobian
from sensorgraph.diagnosis.scan.likelihood import ExpectedReadings, Responsibilities, e_step, fitted_noise
from sensorgraph.diagnosis.scan.normal_equations import (
    BoundedOptimum,
    System,
    boxed,
    with_prior,
    without_poses,
)
from sensorgraph.diagnosis.scan.nuisance import (
    State,
    pose_prior,
    prior_widths,
)
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.types import Bools, Floats, Ints

CHI2_MEDIAN_1, CHI2_MEDIAN_3 = 0.455, 2.366
"""Medians of the chi-squared distribution with one and with three degrees of freedom."""
MAX_POSE_ERROR = float(np.sqrt(chdtri(3, 2 * ndtr(-SCAN.nuisance.max_tolerances))))
"""Maximum Mahalanobis length of the pose error of a scan: exceeded with the same probability as the bound of a nuisance."""


class Solver:
    """The linearised problem at one cast: readings as a first-order function of the unknowns."""

    def __init__(
        self,
        data: ScanData,
        expected: ExpectedReadings,
        jacobian: Jacobian,
        walls: Floats,
        effects: Floats,
        corners: Corners,
        locked: Bools,
    ) -> None:
        self.data, self.expected, self.jacobian, self.corners = data, expected, jacobian, corners
        self.effects = effects  # (n_scans, k, n_rays)
        self.n_effects = effects.shape[1]
        self.shape = expected.reading.shape
        self.laid = np.zeros(self.shape)
        is_met = np.zeros(len(walls) + 1, dtype=np.bool_)  # a run usually meets only a part of a building
        is_met[jacobian.wall] = True
        met = np.flatnonzero(is_met)
        self.wall = (np.cumsum(is_met) - 1)[jacobian.wall]
        if corners.count:
            self.corner_ends = corners.ends[met]  # (n_walls, 2)
            d = np.diff(walls[met], axis=1)[:, 0]
            d = d / np.maximum(np.hypot(d[:, 0], d[:, 1]), 1e-12)[:, None]
            self.normals = np.stack([d[:, 1], -d[:, 0]], axis=1)  # (n_walls, 2)
            facing = np.sign(
                jacobian.nx * self.normals[:, 0][self.wall] + jacobian.ny * self.normals[:, 1][self.wall]
            )
            self.ends = jacobian.ends * facing
            self.laid += 0.0 if data.laid is None else self._by_corners(data.laid)
        if data.posed is not None:
            self.laid += np.matmul(data.posed[:, None, :], jacobian.pose)[:, 0]
        self.tau = np.concatenate(
            [prior_widths(data.tolerances), np.full(2 * corners.n_unknowns, data.tolerances.map)]
        )
        self.locked = locked  # (8 + 2 n,) of the nuisances, corners and obstacles
        self.rows = np.concatenate([jacobian.pose, jacobian.nuisances, effects], axis=1)
        self.y = self._residuals(data)

    def _residuals(self, data: ScanData) -> Floats:
        """Return measured minus expected readings (n_scans, n_rays) [m] without nuisances; 0 where they do not count."""
        with np.errstate(invalid="ignore"):
            y = np.where(self.jacobian.valid & data.returned, data.ranges - self.expected.reading, 0.0)
        return np.where(np.isfinite(y), y, 0.0)

    def with_readings(self, data: ScanData) -> Solver:
        """Return the linearised problem for other readings of the same scans."""
        out = copy(self)
        out.data, out.y = data, self._residuals(data)
        return out

    def of_scans(self, rows: Ints) -> Solver:
        """Return the linearised problem of some scans only, to assemble their normal equations."""
        j, out = self.jacobian, copy(self)
        out.data, out.rows = self.data.subset(rows), self.rows[rows]
        out.y, out.laid = self.y[rows], self.laid[rows]
        out.jacobian = replace(
            j, pose=j.pose[rows], nuisances=j.nuisances[rows], ends=j.ends[:, rows], wall=j.wall[rows],
            nx=j.nx[rows], ny=j.ny[rows], valid=j.valid[rows], steep=j.steep[rows],
        )  # fmt: skip
        out.shape, out.wall = (len(rows), self.shape[1]), self.wall[rows]
        if self.corners.count:
            out.ends = self.ends[:, rows]
        return out

    def with_columns(self, columns: Floats) -> Solver:
        """Return the linearised problem with additional columns (n_scans, k, n_rays) after those of the effects."""
        out = copy(self)
        out.effects = np.concatenate([self.effects, columns], axis=1)
        out.rows = np.concatenate([self.rows, columns], axis=1)
        out.n_effects = out.effects.shape[1]
        return out

    @property
    def stack(self) -> Floats:
        """(n_scans, 8 + k, n_rays) columns that all scans share, of nuisances and effects."""
        return self.rows[:, 3:]

    def shift(self, state: State, p: Floats) -> Floats:
        """Return the contribution of nuisances, poses and effect increments to the readings, (n_scans, n_rays)."""
        shared = np.concatenate([state.g[: len(Nuisance)], p])
        values = np.concatenate([state.delta, np.broadcast_to(shared, (self.shape[0], len(shared)))], axis=1)
        out = np.matmul(values[:, None, :], self.rows)[:, 0]
        if self.corners.count:
            out += self._by_corners(state.corners)
        return np.asarray(out - self.laid)

    def _by_corners(self, g: Floats) -> Floats:
        """Return the contribution of the unknowns (2 n,) [m] of corners and obstacles to the readings, (n_scans, n_rays)."""
        shifts = self.corners.shifts(g).reshape(-1, 2)[self.corner_ends]  # (n_walls, 2 ends, 2)
        first, last = np.matmul(shifts, self.normals[:, :, None])[..., 0].T
        return np.asarray(self.ends[0] * first[self.wall] + self.ends[1] * last[self.wall])

    def assemble(self, weight: Floats, pose_scale: float) -> System:
        """Build the normal equations for weights (n_scans, n_rays) [1/m²], with the poses eliminated.

        Blocks for each scan: h = BᵀWB + P⁻¹, c = BᵀWS, b = BᵀWy. Sums over all scans: g = SᵀWS, r = SᵀWy.
        """
        prior = pose_prior(self.data, pose_scale)
        w = np.where(self.jacobian.valid, weight, 0.0)
        y = self.y + self.laid
        products = np.matmul(
            self.rows * w[:, None, :], self.rows.transpose(0, 2, 1)
        )  # (n_scans, 11 + k, 11 + k)
        with_y = np.matmul(self.rows, (w * y)[:, :, None])[..., 0]  # (n_scans, 11 + k)
        h = products[:, :3, :3] + prior.inverse
        c, g = products[:, :3, 3:], products[:, 3:, 3:].sum(axis=0)
        b, r = with_y[:, :3], with_y[:, 3:].sum(axis=0)
        if self.corners.count:
            c, g, r = self._with_corners(w, y, c, g, r)
        return without_poses(g, r, h, c, b, prior.logdet)

    def _with_corners(
        self, w: Floats, y: Floats, c: Floats, g: Floats, r: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Insert the corners between the nuisances and the effects (blocks cv, gv, vv, rv of `corner_sums`)."""
        k = len(Nuisance)
        cv, gv, vv, rv = corner_sums(
            w, self.rows, self.ends, self.wall, y, self.normals, self.corner_ends, self.corners.count
        )  # fmt: skip
        cv, gv, vv, rv = (self.corners.of_unknowns(part) for part in (cv, gv, vv, rv))
        vv = self.corners.of_unknowns(vv.T)
        c = np.concatenate([c[..., :k], cv, c[..., k:]], axis=2)
        top = np.concatenate([g[:k, :k], gv[:k], g[:k, k:]], axis=1)
        middle = np.concatenate([gv[:k].T, vv, gv[k:].T], axis=1)
        low = np.concatenate([g[k:, :k], gv[k:], g[k:, k:]], axis=1)
        return c, np.concatenate([top, middle, low]), np.concatenate([r[:k], rv, r[k:]])

    @property
    def n_g(self) -> int:
        """Number of nuisances."""
        return len(self.tau)

    def maximise(self, system: System, state: State, like: BoundedOptimum | None = None) -> BoundedOptimum:
        """Solve for (g, p) with priors and bounds; the active bounds of a similar optimum `like` are tried first."""
        return boxed(system.matrix, system.right, self.scaled(state), self.box(state), self.locked, like)

    def box(self, state: State) -> Floats:
        """Return the bound of each nuisance's absolute value."""
        return np.asarray(SCAN.nuisance.max_tolerances * self.scaled(state))

    def scaled(self, state: State) -> Floats:
        """Return the prior standard deviations, widened where the tolerances are too tight."""
        tau = self.tau.copy()
        tau[len(Nuisance) :] *= state.map_scale
        tau[: len(Nuisance)] *= max(1.0, np.sqrt(state.map_scale * state.pose_scale))
        return tau

    def factor(self, system: System, state: State) -> Floats:
        """Return the lower Cholesky factor of M + 1/tau² for the nuisances that are not held at 0."""
        free, n = ~self.locked, self.n_g
        a = with_prior(system.matrix[:n, :n], self.scaled(state))
        return np.asarray(np.linalg.cholesky(a[np.ix_(free, free)]))

    def objective(
        self,
        system: System,
        lower: Floats,
        state: State,
        responsibilities: Responsibilities,
        delta_prior: Floats,
    ) -> float:
        """Return J [nats]; see the module. `lower` is the `factor` of the system."""
        tau, free = self.scaled(state), ~self.locked
        penalty = 0.5 * float(np.sum((state.g[free] / tau[free]) ** 2))
        volume = 2 * float(np.log(np.diag(lower)).sum() + np.log(tau[free]).sum())
        return (
            float(responsibilities.log_p.sum())
            - 0.5 * float(delta_prior.sum())
            - 0.5 * system.logdet
            - penalty
            - 0.5 * volume
        )


@dataclass(eq=False)
class Solution:
    """The optimum at one cast."""

    state: State
    p: Floats
    """(k,) increments of the effects' smooth parameters."""
    j: float
    """[nats] penalised log-likelihood."""
    responsibilities: Responsibilities
    system: System
    covariance: Floats
    """(k, k) covariance of p, with the nuisances integrated out."""
    has_converged: bool
    """Whether J no longer rose; if not, the rounds were used up."""


def iterate(
    solver: Solver,
    state: State,
    p: Floats,
    noise_bounds: NoiseBounds,
) -> Solution:
    """Alternate between responsibilities and the linear solve; return the solution with the best J."""
    state, p = state.copy(), p.copy()
    best: Solution | None = None
    optimum: BoundedOptimum | None = None
    n, has_converged = solver.n_g, True
    for turn in range(SCAN.fit.max_rounds + 1):
        responsibilities = e_step(solver.data, solver.expected, solver.shift(state, p), state.noise)
        system = solver.assemble(responsibilities.weight, state.pose_scale)
        inverse = pose_prior(solver.data, state.pose_scale).inverse
        length = np.einsum("ni,nij,nj->n", state.delta, inverse, state.delta)
        lower = solver.factor(system, state)
        j = solver.objective(system, lower, state, responsibilities, length)
        if best is None or j > best.j:
            gained = np.inf if best is None else j - best.j
            best = Solution(
                state=state.copy(),
                p=p.copy(),
                j=j,
                responsibilities=responsibilities,
                system=system,
                covariance=np.zeros((0, 0)),  # that of the best round alone follows at the end
                has_converged=False,
            )
            if gained < SCAN.fit.min_gain and turn > 1:
                break
        elif turn > 2:
            break
        if turn == SCAN.fit.max_rounds:
            has_converged = False
            break
        optimum = solver.maximise(system, state, optimum)
        state.g, p = optimum.x[:n], optimum.x[n:]
        delta = system.poses_at(optimum.x)
        length = np.sqrt(np.einsum("ni,nij,nj->n", delta, inverse, delta))
        state.delta = delta * np.minimum(1.0, MAX_POSE_ERROR / np.maximum(length, 1e-9))[:, None]
        state.noise = fitted_noise(solver.data, solver.expected, responsibilities, noise_bounds)
        state.pose_scale, state.map_scale = _scales(solver, system, lower, state, noise_bounds)
        box = solver.box(state)  # the bounds may have shrunk since g was solved for
        state.g = np.clip(state.g, -box, box)
    assert best is not None
    covariance = _covariance(best.system, solver, best.state)
    return replace(best, covariance=covariance, has_converged=has_converged)


def _scales(
    solver: Solver, system: System, lower: Floats, state: State, noise_bounds: NoiseBounds
) -> tuple[float, float]:
    """Estimate the factors by which the tolerances of reference pose and map are too tight.

        pose_scale ← pose_scale sqrt(median(q) / CHI2_MEDIAN_3),    q = deltaᵀ (P - h⁻¹)⁻¹ delta.

    P - h⁻¹ is the covariance of the estimated delta under the prior. The corners of the map are treated in the same way.
    Medians are used, because an effect then does not widen the tolerances. `lower` is the `factor` of the system.
    """
    prior = pose_prior(solver.data, state.pose_scale).covariance
    spread = prior - np.linalg.inv(system.poses)  # covariance of the estimate under the prior
    spread = spread + 1e-3 * prior
    q = np.einsum("ni,nij,nj->n", state.delta, np.linalg.inv(spread), state.delta)
    pose = state.pose_scale * float(np.sqrt(np.median(q) / CHI2_MEDIAN_3))
    free = np.flatnonzero(~solver.locked)
    corners = free[free >= len(Nuisance)]
    scale = state.map_scale
    if len(corners) >= SCAN.goodness_of_fit.min_blocks:
        tau = solver.scaled(state)
        rows, _ = dtrtri(lower, lower=1)  # (M + 1/tau²)^-1 = rows' rows
        variances = (rows**2).sum(axis=0)[-len(corners) :]
        left = variances / tau[corners] ** 2  # remaining share of the prior variance
        seen = left < SCAN.fit.max_prior_share
        if seen.sum() >= SCAN.goodness_of_fit.min_blocks:
            ratio = (state.g[corners] / tau[corners])[seen] ** 2 / (1 - left[seen])
            scale = state.map_scale * float(np.sqrt(np.median(ratio) / CHI2_MEDIAN_1))
    return float(np.clip(pose, 1.0, noise_bounds.max_scale)), float(
        np.clip(scale, 1.0, noise_bounds.max_scale)
    )


def _covariance(system: System, solver: Solver, state: State) -> Floats:
    """Return the covariance of p, with the nuisances integrated out."""
    n = solver.n_g
    k = len(system.right) - n
    if k == 0:
        return np.zeros((0, 0))
    a = with_prior(system.matrix, solver.scaled(state))
    free = ~solver.locked
    across = a[:n, n:][free]
    schur = a[n:, n:] - across.T @ cho_solve(cho_factor(a[:n, :n][np.ix_(free, free)]), across)
    return np.asarray(np.linalg.inv(schur))
