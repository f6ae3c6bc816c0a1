"""Draw simulated replicates of a run from a fitted model (parametric bootstrap; Efron and Tibshirani 1993, chapter 6)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.gauss_newton import Solution, Solver
from sensorgraph.diagnosis.scan.likelihood import e_step, sample
from sensorgraph.diagnosis.scan.nuisance import pose_prior
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.sweep_wobble import drawn_wobble, wobble_of_readings


def replicate(data: ScanData, fitted: Fitted, rng: np.random.Generator) -> tuple[ScanData, Fitted]:
    """Draw readings from a fitted model, with pose errors and tails, and refit the nuisances linearly."""
    solution, expected, jacobian = fitted.solution, fitted.cast.expected, fitted.cast.jacobian
    state = solution.state.copy()
    prior = pose_prior(data, state.pose_scale)
    state.delta = np.einsum("nij,nj->ni", np.linalg.cholesky(prior), rng.normal(size=state.delta.shape))
    mu = expected.reading + fitted.solver.shift(state, solution.p)
    if any(data.wobble):  # neighbouring rays share the wobble, so it is drawn apart from their noise
        spread = wobble_of_readings(data.wobble, jacobian.pose)
        alone = np.sqrt(np.maximum(expected.sigma**2 - spread**2, 0.0))
        delays = data.sensor.ray_delays
        when = (delays - delays.min()) / data.sensor.scan_duration
        mu = mu + drawn_wobble(data.wobble, data.references_in_sweep, when, jacobian.pose, rng)
        z = sample(data, replace(expected, sigma=alone), mu, state.noise, rng)
    else:
        z = sample(data, expected, mu, state.noise, rng)
    drawn = replace(data, ranges=z)
    corners = fitted.solver.corners
    solver = Solver(
        drawn,
        expected,
        jacobian,
        fitted.cast.scene.walls,
        fitted.solver.effects,
        corners,
        fitted.solver.locked,
    )
    begin = np.zeros_like(state.delta) if data.posed is None else state.delta
    state = replace(solution.state.copy(), delta=begin.copy())
    p, optimum = solution.p, None
    for _ in range(2):
        responsibilities = e_step(drawn, expected, solver.shift(state, p), state.noise)
        system = solver.assemble(responsibilities.weight, state.pose_scale)
        optimum = solver.maximise(system, state, optimum)
        state.g, p = optimum.x[: solver.n_g], optimum.x[solver.n_g :]
        state.delta = system.poses_at(optimum.x)
    responsibilities = e_step(drawn, expected, solver.shift(state, p), state.noise)
    refit = Solution(
        state=state,
        p=p,
        j=0.0,
        responsibilities=responsibilities,
        system=system,
        covariance=solution.covariance,
    )
    return drawn, Fitted(model=fitted.model, solution=refit, cast=fitted.cast, solver=solver)
