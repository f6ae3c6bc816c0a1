"""How well a model fits: what it leaves unexplained, by the differences without a name of `scan.unnamed`, and the gap.

The gap between simulator and measurement is that on scans that are excluded from every fit and choice.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sensorgraph.diagnosis.result import FitQuality, Gap
from sensorgraph.diagnosis.scan.consequence import likely_causes
from sensorgraph.diagnosis.scan.fit import Fitted, solver_of_nuisances
from sensorgraph.diagnosis.scan.likelihood import Responsibilities
from sensorgraph.diagnosis.scan.nuisance import BeamNoise, State, as_cast, as_pose_errors, pose_like
from sensorgraph.diagnosis.scan.residuals import FitResiduals, drawn_scans, with_poses_of_rays
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed import UNNAMED
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, sure
from sensorgraph.diagnosis.scan.unnamed.worse_than_specified import beyond_tolerances
from sensorgraph.effects import Amendment
from sensorgraph.types import Bools, Floats, Progress


@dataclass(frozen=True, kw_only=True, eq=False)
class GoodnessOfFit:
    """Result of the test whether a model leaves anything unexplained."""

    told: Doubt | None = None
    """The difference that is reported; None if the model is sufficient."""
    immaterial: tuple[str, ...] = ()
    """Differences that are significant, but smaller than a user tolerates."""
    tested: tuple[Doubt, ...] = ()
    """All differences that were tested, for the ledger."""
    least: float = 0.0
    """[nats] misfit that inexact effects may leave."""

    @property
    def is_doubted(self) -> bool:
        """Whether a difference is unexplained."""
        return self.told is not None

    @property
    def misfit(self) -> float:
        """[nats] approximate evidence for the unexplained part."""
        return 0.0 if self.told is None else self.told.misfit


def check(
    data: ScanData,
    fitted: Fitted,
    gained: float,
    gains: Mapping[int, float],
    *,
    rng: np.random.Generator,
    null: Fitted | None = None,
    tick: Progress | None = None,
) -> GoodnessOfFit:
    """Test whether a model explains the run.

    Parameters
    ----------
    gained : [nats] Gain of the model over the one without effects; a difference must exceed a share of it.
    gains : [nats] Gain of each effect of the model.
    null : The fit without effects.
    """
    sigma, view = data.sensor.sigma, FitResiduals(as_cast(data, fitted.state), fitted)
    checked = Checked(view=view, gains=gains, gained=gained, null=null, rng=rng, tick=tick)
    tests = [(test, test.find(checked)) for test in UNNAMED.values() if test.find is not None]
    causes = [doubt for test, found in tests if test.is_cause for doubt in found]
    others = [doubt for test, found in tests if not test.is_cause for doubt in found]
    share = SCAN.goodness_of_fit.min_share_of_gain
    inexact = sum((a.effect.diagnostics.misfit_share or share) * gains[i] for i, a in enumerate(fitted.model))
    # each effect allows for the share of its evidence by which its model is inexact
    least = max(share * gained, inexact)
    tested = (*causes, *others)
    doubts = [d for d in _told_in_order(sure(causes), sure(others)) if d.misfit > least]
    trifles = [d for d in doubts if d.size is not None and not d.size.is_material(sigma)]
    doubts = [d for d in doubts if d not in trifles]
    immaterial = tuple(f"{d.statement}; {d.size.sentence()}" for d in trifles if d.size is not None)
    rest = GoodnessOfFit(immaterial=immaterial, tested=tested, least=least)
    if not doubts:
        return rest
    first = replace(doubts[0], causes=doubts[0].causes or likely_causes(checked.deviations))
    return _told(first, doubts, rest)


def _told_in_order(changed: Sequence[Doubt], doubts: Sequence[Doubt]) -> list[Doubt]:
    """Order by misfit, with changes in time, error profiles and odd scans before their consequences.

    They do not come first if a single place has a larger misfit: readings are then off at that place, and the change only
    imitates it.
    """
    at_places = [d.deviation.z for d in doubts if d.deviation is not None and d.deviation.xy is not None]
    most = max((0.5 * z**2 for z in at_places), default=0.0)
    first = sorted((d for d in changed if d.misfit >= most), key=lambda d: -d.misfit)
    rest = [d for d in (*changed, *doubts) if d not in first]
    return [*first, *sorted(rest, key=lambda d: -d.misfit)]


def told_by_tolerances(fitted: Fitted, found: GoodnessOfFit) -> GoodnessOfFit | None:
    """Report tolerances of a fit that are far wider than specified; None if they are not.

    Where effects explain much of the residuals, no other test would detect this. For example, a room that is longer than in
    its plan is partly explained by a map scale, and its corners absorb the rest.
    """
    settings = SCAN.goodness_of_fit
    limit = settings.max_tolerance_scale_beside_effects if fitted.model else settings.max_tolerance_scale
    doubts = sure(beyond_tolerances(fitted, limit))
    if not doubts:
        return None
    return _told(max(doubts, key=lambda d: d.statistic), doubts, found)


def _told(first: Doubt, doubts: Sequence[Doubt], rest: GoodnessOfFit) -> GoodnessOfFit:
    """Add the first of several differences to a result; it takes the strongest deviation and the failed effects of all of them."""
    told = replace(
        first,
        deviation=next((d.deviation for d in doubts if d.deviation is not None), None),
        is_of_building=all(d.is_of_building for d in doubts),
        failed=frozenset[int]().union(*(d.failed for d in doubts)),
    )
    return replace(rest, told=told)


# held-out scans -------------------------------------------------------------------------------------------------------


def held_out(data: ScanData) -> Bools:
    """Return which scans (n_scans,) are excluded from every fit and choice: one block of a second in eight."""
    every = SCAN.held_out_every
    block = np.floor((data.stamps - data.begin) / SCAN.block).astype(np.intp)
    held = block % every == every // 2
    if not held.any() or held.all():
        held = np.arange(data.n_scans) % every == every // 2
    return np.asarray(held)


class _HeldOutFit:
    """A model on the held-out scans: poses are fitted to every other ray, and the likelihood is computed on the others."""

    def __init__(self, data: ScanData, model: Sequence[Amendment], fitted: Fitted, noise: BeamNoise) -> None:
        data = as_cast(data, fitted.state, same_scans=False)
        if data.posed is not None:  # the likely poses include the mount and delay of the model
            data = data.posed_by(data.posed - as_pose_errors(data, pose_like(model)))
        self.solver, at = solver_of_nuisances(data, model)
        self.begin, self.expected, self.steep = data.pose_start, at.expected, at.jacobian.steep
        self.fitted, self.noise = fitted, noise

    def e_step(self, data: ScanData, begin: Floats | None = None) -> tuple[Responsibilities, Floats]:
        """Return responsibilities and expected readings (n_scans, n_rays) [m], with poses fitted to the even rays.

        Parameters
        ----------
        begin : (n_scans, 3) Initial pose errors; by default those of the casts.
        """
        solver = self.solver.with_readings(data)
        state = State(
            g=np.where(solver.locked, 0.0, self.fitted.state.g),
            delta=self.begin if begin is None else begin,
            noise=self.noise,
            pose_scale=self.fitted.state.pose_scale,
            map_scale=self.fitted.state.map_scale,
        )
        responsibilities, shift = with_poses_of_rays(solver, state, np.arange(data.n_rays) % 2 == 0)
        return responsibilities, self.expected.reading + shift


def held_out_gap(
    data: ScanData,
    null: Fitted,
    final: Fitted,
    named: Sequence[Amendment],
    *,
    shared: Sequence[Amendment] = (),
    rng: np.random.Generator,
) -> Gap:
    """Measure the gap before and after on held-out scans, and the noise floor of a perfect model.

    "Before" is the nominal simulator with the shared effects; "after" includes the named effects. Both include the small setup corrections (map,
    mount, clocks within tolerance) of the final fit, so that they differ only in the effects.

    The pose error of each scan is estimated on its even rays, and the gap is measured on the odd ones. The RMS excludes
    outliers of the amended model, rays next to an edge in depth, and rays at grazing incidence. The log-likelihood
    includes all readings.

    Parameters
    ----------
    null, final : Fits without effects and of the accepted model, to the other scans.
    named : Effects of the amended simulator.
    shared : Those of them that a simulator shows already.
    """
    before = _HeldOutFit(data, shared, final, (final if shared else null).state.noise)
    after = _HeldOutFit(data, named, final, final.state.noise if named else null.state.noise)
    judged_before, mu_before = before.e_step(data)
    judged_after, mu_after = after.e_step(data)
    odd = np.zeros(mu_after.shape, dtype=np.bool_)
    odd[:, 1::2] = True
    odd &= ~np.isnan(data.ranges)
    sigma = data.sensor.sigma
    edge, stray = SCAN.likelihood.min_edge_chance, 0.5
    seen = odd & (after.expected.p_alternative < edge) & (before.expected.p_alternative < edge)
    seen &= judged_after.stray <= stray
    seen &= (after.steep < sigma) & (before.steep < sigma)

    floors = []
    for _ in range(SCAN.goodness_of_fit.n_slow_replicates):
        drawn, errors = drawn_scans(data, after.solver, final.state, np.zeros(0), rng)
        # as for the measured scans, start at the likely poses
        responsibilities, mu = after.e_step(drawn, None if data.posed is None else errors)
        clear = seen & (responsibilities.stray <= stray)
        floors.append(_fit(drawn, mu, responsibilities, clear, odd, sigma))
    mean = {key: float(np.mean([vars(f)[key] for f in floors])) for key in vars(floors[0])}
    return Gap(
        before=_fit(data, mu_before, judged_before, seen, odd, sigma),
        after=_fit(data, mu_after, judged_after, seen, odd, sigma),
        noise_floor=FitQuality(**mean),
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
