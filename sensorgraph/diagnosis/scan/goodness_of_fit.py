"""Goodness of fit: what a model leaves unexplained, by the differences without a name of `scan.unnamed`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sensorgraph.diagnosis.scan.cast_place import as_cast
from sensorgraph.diagnosis.scan.consequence import likely_causes
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed import UNNAMED
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, sure
from sensorgraph.diagnosis.scan.unnamed.worse_than_specified import beyond_tolerances
from sensorgraph.types import Progress


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
