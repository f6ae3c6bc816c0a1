"""Residuals of a fit, in the form that effects use to propose start values, and simulated replicates of its run."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.gauss_newton import Solver
from sensorgraph.diagnosis.scan.likelihood import SQRT_TAU, Responsibilities, e_step, sample
from sensorgraph.diagnosis.scan.nuisance import State, pose_prior
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects.interfaces import Present
from sensorgraph.types import Bools, Floats


@dataclass(eq=False)
class FitResiduals:
    """Expected and measured readings of a fit (see `sensorgraph.effects.interfaces.Residuals`)."""

    data: ScanData
    fitted: Fitted

    def __post_init__(self) -> None:
        solution, expected = self.fitted.solution, self.fitted.cast.expected
        self.z = self.data.ranges
        self.returned = self.data.returned
        self.lost = self.z == np.inf
        self.near = self.z == -np.inf
        self.log_p = solution.responsibilities.log_p
        self.mu = expected.reading + self.fitted.solver.shift(solution.state, solution.p)
        self.aimed = np.isfinite(self.mu)
        self.beams = self.fitted.cast.beams
        self.noise = solution.state.noise
        self.tail, self.loss = self.noise.tail, self.noise.loss
        self.residual = solution.responsibilities.residual
        self.weight = solution.responsibilities.weight
        self.stray = solution.responsibilities.stray
        self.valid = self.fitted.cast.jacobian.valid
        self.arena, self.sensor = self.data.arena, self.data.sensor
        self.walls = self.fitted.cast.scene.walls
        self.model: Sequence[Present] = self.fitted.model
        self.nominal_sigma = expected.sigma
        self.sigma = self.noise.core * expected.sigma
        self.strange = self.returned & (self.stray > 0.5)
        self.range_max = self.data.sensor.range_max
        with np.errstate(invalid="ignore"):
            self.short = self.strange & (
                self.z < np.where(self.aimed, self.mu, self.range_max) - 4 * self.sigma
            )
            self.long = self.strange & (self.z > self.mu + 4 * self.sigma)

    def of_rays(self, rays: Bools) -> FitResiduals:
        """Return the view of some rays (n_rays,), with all other rays masked."""
        view = copy(self)
        view.__dict__.pop("certain_loss", None)
        for name in ("returned", "lost", "near", "aimed", "valid", "strange", "short", "long"):
            setattr(view, name, getattr(self, name) & rays)
        view.weight = np.where(rays, self.weight, 0.0)
        return view

    @cached_property
    def certain_loss(self) -> Floats:
        """[nats] Gain of the hypothesis that a ray cannot return; 0 for rays that are not judged."""
        floor = np.log((self.noise.stray + SCAN.likelihood.unexplained) / self.range_max)
        gain = np.where(self.returned, floor, np.where(self.lost, 0.0, -12.0)) - self.log_p
        return np.asarray(np.where(np.isnan(self.z), 0.0, gain))

    @cached_property
    def along(self) -> Floats:
        """[m] Distance from the first end of the wall that is hit."""
        return self.beams.along(self.walls)

    @cached_property
    def incidence(self) -> Floats:
        """[rad] Incidence; nan without a hit."""
        return self.beams.incidence

    def ends(self, some: Bools) -> Floats:
        """Return the end points (n, 2) [m, map] of measured rays."""
        ox = np.broadcast_to(self.beams.ox, self.z.shape)[some]
        oy = np.broadcast_to(self.beams.oy, self.z.shape)[some]
        return np.stack(
            [ox + self.z[some] * self.beams.ux[some], oy + self.z[some] * self.beams.uy[some]], axis=1
        )

    def likely(self, mu: Floats, some: Bools | None = None) -> Floats:
        """Return log-likelihoods [nats] under other expected readings; arrays (n_scans, n_rays), or (n,) of `some`."""
        z, sigma = (self.z, self.sigma) if some is None else (self.z[some], self.sigma[some])
        returned = np.isfinite(z)
        aimed = np.isfinite(mu) & (mu < self.range_max)
        off = np.where(returned & aimed, z - np.where(aimed, mu, 0.0), np.inf)
        q = (off / sigma) ** 2
        tail = self.noise.tail
        density = (
            (1 - tail) * np.exp(-0.5 * q)
            + tail / SCAN.likelihood.tail_width * np.exp(-0.5 * q / SCAN.likelihood.tail_width**2)
        ) / (SQRT_TAU * sigma)
        back = (1 - self.noise.loss) * aimed
        hit = back * density + (self.noise.stray + SCAN.likelihood.unexplained) / self.range_max
        out = np.where(
            returned,
            hit,
            np.where(z > 0, 1 - back + SCAN.likelihood.unexplained, SCAN.likelihood.unexplained),
        )
        return np.asarray(np.log(np.where(np.isnan(z), 1.0, out)))


def replicate(data: ScanData, fitted: Fitted, rng: np.random.Generator) -> tuple[ScanData, Fitted]:
    """Draw readings from a fitted model, with pose errors and tails, and refit the nuisances linearly."""
    solution, expected = fitted.solution, fitted.cast.expected
    state = solution.state
    drawn, errors = drawn_scans(data, fitted.solver, state, solution.p, rng)
    solver = fitted.solver.with_readings(drawn)
    state = replace(state.copy(), delta=np.zeros_like(errors) if data.posed is None else errors)
    p, optimum = solution.p, None
    for _ in range(2):
        responsibilities = e_step(drawn, expected, solver.shift(state, p), state.noise)
        system = solver.assemble(responsibilities.weight, state.pose_scale)
        optimum = solver.maximise(system, state, optimum)
        state.g, p = optimum.x[: solver.n_g], optimum.x[solver.n_g :]
        state.delta = system.poses_at(optimum.x)
    responsibilities = e_step(drawn, expected, solver.shift(state, p), state.noise)
    refit = replace(solution, state=state, p=p, j=0.0, responsibilities=responsibilities, system=system)
    return drawn, replace(fitted, solution=refit, solver=solver)


def drawn_scans(
    data: ScanData, solver: Solver, state: State, p: Floats, rng: np.random.Generator
) -> tuple[ScanData, Floats]:
    """Draw pose errors and readings of scans from a model.

    Parameters
    ----------
    solver : The model, linearised at these scans.
    state, p : Its nuisances except for pose errors, and the increments (k,) of its effects.

    Returns
    -------
    The scans with the drawn readings, and their pose errors (n_scans, 3).
    """
    prior = pose_prior(data, state.pose_scale).covariance
    errors = np.einsum("nij,nj->ni", np.linalg.cholesky(prior), rng.normal(size=(data.n_scans, 3)))
    g = np.where(solver.locked, 0.0, state.g)
    mu = solver.expected.reading + solver.shift(replace(state, g=g, delta=errors), p)
    return replace(data, ranges=sample(data, solver.expected, mu, state.noise, rng)), errors


def with_poses_of_rays(solver: Solver, state: State, rays: Bools) -> tuple[Responsibilities, Floats]:
    """Fit the pose of each scan to some rays (n_rays,), at given other nuisances and without effects.

    Returns
    -------
    Responsibilities of all rays, and the contribution of the nuisances to their readings (n_scans, n_rays) [m].
    """
    state, none = state.copy(), np.zeros(0)
    for _ in range(SCAN.fit.rounds):
        found = e_step(solver.data, solver.expected, solver.shift(state, none), state.noise)
        system = solver.assemble(np.where(rays, found.weight, 0.0), state.pose_scale)
        state.delta = system.poses_at(state.g)
    shift = solver.shift(state, none)
    return e_step(solver.data, solver.expected, shift, state.noise), shift
