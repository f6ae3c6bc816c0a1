"""Prove: the gap between simulator and measurement on rays that no fit and no choice has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.result import FitQuality, Gap
from sensorgraph.diagnosis.scan.fit import Fitted, cast, corners_of, locked
from sensorgraph.diagnosis.scan.gauss_newton import Solver, State
from sensorgraph.diagnosis.scan.likelihood import Responsibilities, e_step, sample
from sensorgraph.diagnosis.scan.nuisance import BeamNoise, pose_prior
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.effects import Amendment
from sensorgraph.types import Bools, Floats

BLOCK = 1.0  # [s] of scans that are held out together
NEXT_TO_EDGE = 0.002  # chance of reading the other side of an edge; such rays count in the nats only
EVERY = 8  # one block in so many


def held_out(data: ScanData) -> Bools:
    """Return the scans (n_scans,) that are kept from every fit and choice: one block of a second in eight."""
    block = np.floor((data.stamps - data.begin) / BLOCK).astype(np.intp)
    held = block % EVERY == EVERY // 2
    if not held.any() or held.all():
        held = np.arange(data.n_scans) % EVERY == EVERY // 2
    return np.asarray(held)


class _Side:
    """One model on the held-out scans: poses from every other ray, judged on the rays between."""

    def __init__(self, data: ScanData, model: Sequence[Amendment], fitted: Fitted, noise: BeamNoise) -> None:
        at = cast(data, model)
        corners = corners_of(data)
        self.expected, self.steep = at.expected, at.jacobian.steep
        none = np.zeros((data.n_scans, 0, data.n_rays))
        self.solver = Solver(
            data, at.expected, at.jacobian, at.scene.walls, none, corners, locked(data, model, corners)
        )
        self.fitted, self.noise = fitted, noise

    def responsibilities(self, data: ScanData) -> tuple[Responsibilities, Floats]:
        """Return the judgement of every reading, and the expected readings."""
        solver, expected = self.solver, self.expected
        solver.data = data
        with np.errstate(invalid="ignore"):
            y = np.where(solver.jacobian.valid & data.returned, data.ranges - expected.reading, 0.0)
        solver.y = np.where(np.isfinite(y), y, 0.0)
        state = State(
            g=np.where(solver.locked, 0.0, self.fitted.state.g),
            delta=np.zeros((data.n_scans, 3)),
            noise=self.noise,
            pose_scale=self.fitted.state.pose_scale,
            map_scale=self.fitted.state.map_scale,
        )
        even = np.zeros(expected.reading.shape, dtype=np.bool_)
        even[:, ::2] = True
        none = np.zeros(0)
        for _ in range(3):
            responsibilities = e_step(data, expected, solver.shift(state, none), state.noise)
            system = solver.assemble(np.where(even, responsibilities.weight, 0.0), state.pose_scale)
            state.delta = solver.poses_at(system, state.g)
        shift = solver.shift(state, none)
        return e_step(data, expected, shift, state.noise), expected.reading + shift


def gap(
    data: ScanData,
    null: Fitted,
    final: Fitted,
    named: Sequence[Amendment],
    *,
    rng: np.random.Generator,
    replicates: int = 4,
) -> Gap:
    """Measure the gap before and after on held-out scans, beside what a perfect model would leave.

    Before: the nominal simulator; after: with the named effects. Both have the small corrections of the set-up (map,
    mount, clocks within tolerance) of the final fit, so that what they differ in is the effects alone.

    The pose error of each scan is estimated on its even rays and the gap is measured on the odd ones. Readings that
    the amended model takes for strays, rays that a hair would put on the other side of an edge, and rays that all but
    graze their wall are left out of the RMS, not of the nats.
    """
    before = _Side(data, (), final, null.state.noise)
    after = _Side(data, named, final, final.state.noise if named else null.state.noise)
    judged_before, mu_before = before.responsibilities(data)
    judged_after, mu_after = after.responsibilities(data)
    odd = np.zeros(mu_after.shape, dtype=np.bool_)
    odd[:, 1::2] = True
    odd &= ~np.isnan(data.ranges)
    sigma = data.sensor.sigma
    seen = (
        odd & (after.expected.p_alternative < NEXT_TO_EDGE) & (before.expected.p_alternative < NEXT_TO_EDGE)
    )
    seen &= judged_after.stray <= 0.5
    seen &= (after.steep < sigma) & (before.steep < sigma)
    floors = []
    for _ in range(replicates):
        drawn = _drawn(data, after, final, rng)
        responsibilities, mu = after.responsibilities(drawn)
        clear = seen & (responsibilities.stray <= 0.5)
        floors.append(_fit(drawn, mu, responsibilities, clear, odd, sigma))
    floor = FitQuality(
        rmse_m=float(np.mean([f.rmse_m for f in floors])),
        normalised=float(np.mean([f.normalised for f in floors])),
        nats_per_ray=float(np.mean([f.nats_per_ray for f in floors])),
    )
    return Gap(
        before=_fit(data, mu_before, judged_before, seen, odd, sigma),
        after=_fit(data, mu_after, judged_after, seen, odd, sigma),
        noise_floor=floor,
        n_rays=int(odd.sum()),
    )


def _fit(
    data: ScanData, mu: Floats, responsibilities: Responsibilities, seen: Bools, odd: Bools, sigma: float
) -> FitQuality:
    ok = seen & data.returned & np.isfinite(mu)
    e = data.ranges[ok] - mu[ok]
    rmse = float(np.sqrt(np.mean(e**2))) if len(e) else 0.0
    return FitQuality(
        rmse_m=rmse,
        normalised=rmse / sigma if sigma else 0.0,
        nats_per_ray=float(-responsibilities.log_p[odd].mean()),
    )


def _drawn(data: ScanData, side: _Side, final: Fitted, rng: np.random.Generator) -> ScanData:
    """Draw readings of the held-out scans from the final model."""
    expected, state = side.expected, final.state
    prior = pose_prior(data, state.pose_scale)
    delta = np.einsum("nij,nj->ni", np.linalg.cholesky(prior), rng.normal(size=(data.n_scans, 3)))
    there = State(g=np.where(side.solver.locked, 0.0, state.g), delta=delta, noise=state.noise)
    mu = expected.reading + side.solver.shift(there, np.zeros(0))
    return replace(data, ranges=sample(data, expected, mu, state.noise, rng))
