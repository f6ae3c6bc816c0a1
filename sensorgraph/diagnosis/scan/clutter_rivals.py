"""Whether something local, too weak for a name at a cluttered site, is what a number of the whole sensor stands for.

Floors of clutter keep a sector or a disc without a name that is no worse than the site's own. A scale or a bias that no
floor holds down then takes its place: 6 cm on a fifth of the rays is a scale of 0.9 %, too. So a number of the whole
sensor must keep its size beside the local effects that are looked for, and held down.
"""

from __future__ import annotations

from sensorgraph.diagnosis.scan.fit import Fitted, fit
from sensorgraph.diagnosis.scan.model_selection import is_rough, searched, shortlist
from sensorgraph.diagnosis.scan.score_test import Candidate
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.diagnosis.scan.site_clutter import clutter_floor
from sensorgraph.diagnosis.scan.site_variation import is_within_baseline
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import without


def local_rival(fitted: Fitted, index: int, bounds: NoiseBounds) -> Amendment | None:
    """Return a local effect beside which one of the model is no more than the site shows by itself; None: there is none.

    One that is itself no more than the site shows stands for nothing.

    Parameters
    ----------
    index : of an effect of the whole sensor in the model
    """
    data, model = fitted.solver.data, fitted.model
    if model[index].name not in data.baseline_intervals:
        return None
    rest = without(model, index)
    others = fit(data, rest, fitted.state, bounds, outer=2, inner=4)
    best: dict[str, Candidate] = {}
    for c in sorted(shortlist(data, others, set(), 0.0), key=lambda c: -c.gain):
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
