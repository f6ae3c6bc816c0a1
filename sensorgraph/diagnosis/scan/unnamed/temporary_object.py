"""An object that is present for a part of the run only."""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.scan.consequence import ScanError
from sensorgraph.diagnosis.scan.fit import log_p_at
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed
from sensorgraph.effects.effect import without
from sensorgraph.effects.proposals import best_run

NAME = "temporary_object"
CAUSES = (
    "a door, a vehicle or a person that came or left during the run",
    "light from one side of the room, in which returns are missing while the robot faces it",
)
"""Possible causes; the second one only for parts of walls."""


def find(checked: Checked) -> list[Doubt]:
    """Return a fixed object that is absent for one part of the run: a door, for example, instead of a pane."""
    view, settings = checked.view, SCAN.goodness_of_fit
    data, fitted = view.data, view.fitted
    out = []
    for index, a in enumerate(fitted.model):
        if a.effect.place not in ("wall", "obstacle", "spot"):
            continue
        rest = without(fitted.model, index)
        bare = log_p_at(data, rest, fitted.state)
        off_edge = fitted.cast.expected.p_alternative < SCAN.likelihood.min_edge_chance
        better = np.where(off_edge, bare - view.log_p, 0.0)
        first, last, gain = best_run(better.sum(axis=1)[None])
        n_better = int((better[first[0] : last[0] + 1] > settings.clearly_better).sum())
        if gain[0] > settings.min_absence_gain and n_better > settings.min_readings:
            begin, end = data.stamps[first[0]], data.stamps[last[0]]
            out.append(
                Doubt(
                    family=NAME,
                    statement=f"{a.effect.title} at {a.place or 'its spot'} is absent from "
                    f"{begin - data.begin:.0f} s to {end - data.begin:.0f} s of the run",
                    misfit=float(gain[0]),
                    statistic=float(gain[0]),
                    threshold=settings.min_absence_gain,
                    failed=frozenset([index]),
                    size=ScanError(wrong=n_better / view.log_p.size),
                    causes=CAUSES[: 2 if a.effect.on_part_of_wall else 1],
                )
            )
    return out


TEMPORARY_OBJECT = Unnamed(titles={NAME: "an object that is present for a part of the run only"}, find=find)
