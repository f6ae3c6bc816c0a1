"""Prove: the gap between simulator and measurement on rays that no fit and no choice has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.result import Fit, Gap
from sensorgraph.diagnosis.scan.fit import Fitted, cast, corners_of, locked
from sensorgraph.diagnosis.scan.gauss_newton import Solver, State
from sensorgraph.diagnosis.scan.likelihood import Judged, judge, sample
from sensorgraph.diagnosis.scan.nuisance import Noise, pose_prior
from sensorgraph.diagnosis.scan.scan_data import Evidence
from sensorgraph.effects import Amendment
from sensorgraph.types import Bools, Floats

BLOCK = 1.0  # [s] of scans that are held out together
NEXT_TO_EDGE = 0.002  # chance of reading the other side of an edge; such rays count in the nats only
EVERY = 8  # one block in so many


def held_out(evidence: Evidence) -> Bools:
    """Return the scans (n_scans,) that are kept from every fit and choice: one block of a second in eight."""
    block = np.floor((evidence.stamps - evidence.begin) / BLOCK).astype(np.intp)
    held = block % EVERY == EVERY // 2
    if not held.any() or held.all():
        held = np.arange(evidence.n_scans) % EVERY == EVERY // 2
    return np.asarray(held)


class _Side:
    """One model on the held-out scans: poses from every other ray, judged on the rays between."""

    def __init__(self, evidence: Evidence, model: Sequence[Amendment], fitted: Fitted, noise: Noise) -> None:
        at = cast(evidence, model)
        corners = corners_of(evidence)
        self.what, self.steep = at.what, at.cols.steep
        none = np.zeros((evidence.n_scans, 0, evidence.n_rays))
        self.solver = Solver(
            evidence, at.what, at.cols, at.scene.walls, none, corners, locked(evidence, model, corners)
        )
        self.fitted, self.noise = fitted, noise

    def judged(self, evidence: Evidence) -> tuple[Judged, Floats]:
        """Return the judgement of every reading, and the expected readings."""
        solver, what = self.solver, self.what
        solver.evidence = evidence
        with np.errstate(invalid="ignore"):
            y = np.where(solver.cols.valid & evidence.returned, evidence.ranges - what.reading, 0.0)
        solver.y = np.where(np.isfinite(y), y, 0.0)
        state = State(
            g=np.where(solver.locked, 0.0, self.fitted.state.g),
            delta=np.zeros((evidence.n_scans, 3)),
            noise=self.noise,
            pose_scale=self.fitted.state.pose_scale,
            map_scale=self.fitted.state.map_scale,
        )
        even = np.zeros(what.reading.shape, dtype=np.bool_)
        even[:, ::2] = True
        none = np.zeros(0)
        for _ in range(3):
            judged = judge(evidence, what, solver.shift(state, none), state.noise)
            system = solver.assemble(np.where(even, judged.weight, 0.0), state.pose_scale)
            state.delta = solver.poses_at(system, state.g)
        shift = solver.shift(state, none)
        return judge(evidence, what, shift, state.noise), what.reading + shift


def gap(
    evidence: Evidence,
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
    before = _Side(evidence, (), final, null.state.noise)
    after = _Side(evidence, named, final, final.state.noise if named else null.state.noise)
    judged_before, mu_before = before.judged(evidence)
    judged_after, mu_after = after.judged(evidence)
    odd = np.zeros(mu_after.shape, dtype=np.bool_)
    odd[:, 1::2] = True
    odd &= ~np.isnan(evidence.ranges)
    sigma = evidence.sensor.sigma
    seen = odd & (after.what.p_alternative < NEXT_TO_EDGE) & (before.what.p_alternative < NEXT_TO_EDGE)
    seen &= judged_after.stray <= 0.5
    seen &= (after.steep < sigma) & (before.steep < sigma)
    floors = []
    for _ in range(replicates):
        drawn = _drawn(evidence, after, final, rng)
        judged, mu = after.judged(drawn)
        clear = seen & (judged.stray <= 0.5)
        floors.append(_fit(drawn, mu, judged, clear, odd, sigma))
    floor = Fit(
        rmse_m=float(np.mean([f.rmse_m for f in floors])),
        normalised=float(np.mean([f.normalised for f in floors])),
        nats_per_ray=float(np.mean([f.nats_per_ray for f in floors])),
    )
    return Gap(
        before=_fit(evidence, mu_before, judged_before, seen, odd, sigma),
        after=_fit(evidence, mu_after, judged_after, seen, odd, sigma),
        noise_floor=floor,
        n_rays=int(odd.sum()),
    )


def _fit(evidence: Evidence, mu: Floats, judged: Judged, seen: Bools, odd: Bools, sigma: float) -> Fit:
    ok = seen & evidence.returned & np.isfinite(mu)
    e = evidence.ranges[ok] - mu[ok]
    rmse = float(np.sqrt(np.mean(e**2))) if len(e) else 0.0
    return Fit(
        rmse_m=rmse, normalised=rmse / sigma if sigma else 0.0, nats_per_ray=float(-judged.log_p[odd].mean())
    )


def _drawn(evidence: Evidence, side: _Side, final: Fitted, rng: np.random.Generator) -> Evidence:
    """Draw readings of the held-out scans from the final model."""
    what, state = side.what, final.state
    prior = pose_prior(evidence, state.pose_scale)
    delta = np.einsum("nij,nj->ni", np.linalg.cholesky(prior), rng.normal(size=(evidence.n_scans, 3)))
    there = State(g=np.where(side.solver.locked, 0.0, state.g), delta=delta, noise=state.noise)
    mu = what.reading + side.solver.shift(there, np.zeros(0))
    return replace(evidence, ranges=sample(evidence, what, mu, state.noise, rng))
