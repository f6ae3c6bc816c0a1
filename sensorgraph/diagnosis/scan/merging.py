"""Two effects of a model that are one: parts of a wall that touch, and two sectors of which the rest is the one that differs.

Effects are added one at a time, and so the search may cut in two what is one. Of a pane the first half explains most, and a
black part beside it explains the rest; of a bias of all rays but some, the sectors on either side do.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations, permutations

import numpy as np

from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import without
from sensorgraph.effects.places import in_sector
from sensorgraph.effects.range_bias import RANGE_BIAS
from sensorgraph.effects.sector_bias import SECTOR_BIAS

Model = tuple[Amendment, ...]
MAX_GAP = 0.2
"""[m] between two parts of a wall that may be one: the rays there meet both."""


def fewer_effects(model: Sequence[Amendment], data: ScanData) -> Iterator[Model]:
    """Yield models with fewer effects, or simpler ones, that may stand for this one; what is new comes last."""
    for i, j in permutations(range(len(model)), 2):
        if (whole := _whole_part(model[i], model[j])) is not None:
            yield (*without(model, i, j), whole)
    for i, j in combinations(range(len(model)), 2):
        if (both := _all_but_the_rest(model[i], model[j], data)) is not None:
            common, rest = both
            others = without(model, i, j)
            known = sum(a["b"] for a in others if a.effect is RANGE_BIAS)
            others = tuple(a for a in others if a.effect is not RANGE_BIAS)
            yield (*others, common.moved_to({"b": common["b"] + known}), rest)


def _whole_part(one: Amendment, other: Amendment) -> Amendment | None:
    """Return the first effect on its own part of a wall and on the other's, too; None where they do not touch."""
    if one.place != other.place or not (one.effect.on_part_of_wall and other.effect.on_part_of_wall):
        return None
    gap = max(one["a"], other["a"]) - min(one["b"], other["b"])
    if gap > MAX_GAP:
        return None
    return one.moved_to({"a": min(one["a"], other["a"]), "b": max(one["b"], other["b"])})


def _all_but_the_rest(one: Amendment, other: Amendment, data: ScanData) -> tuple[Amendment, Amendment] | None:
    """Return a bias of all rays, and a sector that takes it back, for two sectors with biases of one sign; None: no sectors."""
    if one.effect is not SECTOR_BIAS or other.effect is not SECTOR_BIAS or one["b"] * other["b"] <= 0:
        return None
    bearings = data.sensor.bearings
    between = [(one["theta2"], other["theta1"]), (other["theta2"], one["theta1"])]
    first, last = max(between, key=lambda ends: int(in_sector(bearings, *ends).sum()))
    mean = float(np.mean([one["b"], other["b"]]))
    return RANGE_BIAS(b=mean), one.moved_to({"theta1": first, "theta2": last, "b": -mean})
