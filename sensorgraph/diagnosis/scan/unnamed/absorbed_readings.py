"""Short readings or outliers that behave otherwise than the effect that absorbs them."""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.scan.consequence import ScanError
from sensorgraph.diagnosis.scan.people_law import (
    STANDING_CAUSES,
    STRAY_CAUSES,
    clustered,
    where_things_stand,
    why_not_people,
)
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed
from sensorgraph.effects import Amendment
from sensorgraph.types import Bools

NAME = "absorbed_readings"


def find(checked: Checked) -> list[Doubt]:
    """Return the effects that absorb readings contrary to their assumptions."""
    view, gains, out = checked.view, checked.gains, []
    model = view.fitted.model
    absorbed = checked.gained - sum(gains[i] for i, a in enumerate(model) if not a.effect.absorber)
    for index, a in enumerate(model):
        words, causes, odd_share = why_not_absorbed(view, a)
        if not words:
            continue
        # a fringe of a strong effect's own readings is not a contradiction
        worth = SCAN.goodness_of_fit.failed_law_share * max(gains[index], absorbed)
        out.append(
            Doubt(
                family=NAME,
                statement=words,
                misfit=worth,
                statistic=0.0,
                threshold=0.0,
                failed=frozenset([index]),
                fringe=frozenset([index]),
                size=ScanError(wrong=odd_share),
                causes=causes,
                # an occupancy-grid map lacks moving and thin objects, so these outliers are not uniform
                is_of_building=causes == STANDING_CAUSES
                or (a.effect.diagnostics.explains == "strays" and view.data.grain > 0),
            )
        )
    return out


def why_not_absorbed(view: FitResiduals, a: Amendment) -> tuple[str, tuple[str, ...], float]:
    """Return why the readings that an effect absorbs contradict its assumptions, their possible causes and their share.

    The reason is empty if they are consistent, or if the effect absorbs none.
    """
    explains = a.effect.diagnostics.explains
    responsibilities = view.fitted.solution.responsibilities
    off_edge = view.fitted.cast.expected.p_alternative < SCAN.likelihood.min_edge_chance
    odd = view.returned & (responsibilities.core + responsibilities.tail < 0.5) & off_edge
    if explains == "short readings":
        with np.errstate(invalid="ignore"):
            odd &= view.z < np.where(view.aimed, view.mu, view.range_max)
    if not explains or odd.sum() <= SCAN.goodness_of_fit.min_absorbed_rays:
        return "", (), 0.0
    why = why_not_people(view, odd) if explains == "short readings" else _why_not_random(view, odd)
    return (*why, float(odd.mean()))


def _why_not_random(view: FitResiduals, odd: Bools) -> tuple[str, tuple[str, ...]]:
    """Return why outliers are not uniform, and their possible causes; empty if they may be random."""
    settings = SCAN.goodness_of_fit
    share = float(odd.mean())
    u = np.sort(view.z[odd] / view.range_max)
    n = len(u)
    d = float(np.abs(u - (np.arange(n) + 0.5) / n).max())
    least, per_root = settings.max_uniform_distance
    constant, times = settings.max_clustered_strays
    strays = f"{100 * share:.1f} % of the readings are outliers"
    if d > max(least, per_root / np.sqrt(n)):
        words = f"{strays}, but their ranges are not uniformly distributed"
    elif clustered(view, odd) > constant + times * share:
        words = f"{strays} and form clusters"
    else:
        return "", ()
    if standing := where_things_stand(view, odd):
        return f"{strays}, {standing}: the map differs from the building there", STANDING_CAUSES
    return words, STRAY_CAUSES


ABSORBED_READINGS = Unnamed(
    titles={NAME: "short readings or outliers that behave otherwise than the effect that absorbs them"},
    find=find,
)
