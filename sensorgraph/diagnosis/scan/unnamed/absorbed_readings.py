"""Short readings or outliers that behave otherwise than the effect that absorbs them."""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.scan.consequence import ScanError
from sensorgraph.diagnosis.scan.reading_laws import PEOPLE, STANDING_CAUSES, STRAYS, better_law
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed
from sensorgraph.effects import Amendment

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
    if not explains or odd.sum() <= SCAN.goodness_of_fit.min_readings:
        return "", (), 0.0
    why = better_law(view, odd, PEOPLE if explains == "short readings" else STRAYS)
    return (*why, float(odd.mean()))


ABSORBED_READINGS = Unnamed(
    titles={NAME: "short readings or outliers that behave otherwise than the effect that absorbs them"},
    find=find,
)
