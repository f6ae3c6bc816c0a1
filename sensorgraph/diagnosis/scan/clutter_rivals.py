"""Test whether an effect of the whole sensor absorbs a local effect that is too weak to be named at a cluttered site.

The clutter floor of a site suppresses a sector or a disc that is no stronger than in known-good runs. A scale or a bias
without such a floor then takes its place: 6 cm on a fifth of the rays is also a scale of 0.9 %. An effect of the whole
sensor must therefore keep its size when the suppressed local effects are in the model.
"""

from __future__ import annotations

from sensorgraph.diagnosis.scan.candidate_fits import is_rough, searched
from sensorgraph.diagnosis.scan.fit import Fitted, fit
from sensorgraph.diagnosis.scan.score_test import Candidate
from sensorgraph.diagnosis.scan.search_memory import SearchMemory
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.diagnosis.scan.shortlist import shortlist
from sensorgraph.diagnosis.scan.site_clutter import clutter_floor
from sensorgraph.diagnosis.scan.site_variation import is_within_baseline
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import without


def local_rival(fitted: Fitted, index: int, bounds: NoiseBounds) -> Amendment | None:
    """Return a local effect that reduces an effect of the whole sensor to what the site shows; None without one.

    A local effect that is itself no larger than in the known-good runs is not returned.

    Parameters
    ----------
    index : Index in the model of an effect of the whole sensor.
    """
    data, model = fitted.solver.data, fitted.model
    if model[index].name not in data.baseline_intervals:
        return None
    rest = without(model, index)
    others = fit(data, rest, fitted.state, bounds, outer=2, inner=4)
    best: dict[str, Candidate] = {}
    for c in sorted(shortlist(data, others, 0.0, SearchMemory()), key=lambda c: -c.gain):
        if c.amendment.effect.place is not None and clutter_floor(c.amendment, data) > 0:
            best.setdefault(c.amendment.name, c)
    for candidate in best.values():
        both = fit(data, (*rest, model[index], candidate.amendment), fitted.state, bounds, outer=3, inner=3)
        if is_rough(both.model[-1]):
            both = searched(data, both, bounds, rounds=3, first=1.0, turns=1)
        number, local = both.model[-2:]
        if is_within_baseline(both, number) and not is_within_baseline(both, local):
            return local
    return None
