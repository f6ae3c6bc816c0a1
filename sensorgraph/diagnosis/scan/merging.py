"""Merge two effects of a model that are one: touching segments of a wall, or two sectors around an undisturbed one.

Effects are added one at a time, so the search may split a single effect. For a pane, the first half may explain most, and
a black segment next to it the rest. For a bias of all rays except some, two sectors around these may be found.
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
"""[m] maximum gap between two segments of a wall that may be one; rays that end in the gap meet both."""


def fewer_effects(model: Sequence[Amendment], data: ScanData) -> Iterator[Model]:
    """Yield models with fewer or simpler effects that may replace this one; new effects come last."""
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
    """Return the first effect on both segments of a wall; None if they do not touch."""
    if one.place != other.place or not (one.effect.on_part_of_wall and other.effect.on_part_of_wall):
        return None
    gap = max(one["a"], other["a"]) - min(one["b"], other["b"])
    if gap > MAX_GAP:
        return None
    return one.moved_to({"a": min(one["a"], other["a"]), "b": max(one["b"], other["b"])})


def _all_but_the_rest(one: Amendment, other: Amendment, data: ScanData) -> tuple[Amendment, Amendment] | None:
    """Replace two sectors with biases of the same sign by a bias of all rays and one opposite sector; None otherwise."""
    if one.effect is not SECTOR_BIAS or other.effect is not SECTOR_BIAS or one["b"] * other["b"] <= 0:
        return None
    bearings = data.sensor.bearings
    between = [(one["theta2"], other["theta1"]), (other["theta2"], one["theta1"])]
    first, last = max(between, key=lambda ends: int(in_sector(bearings, *ends).sum()))
    mean = float(np.mean([one["b"], other["b"]]))
    return RANGE_BIAS(b=mean), one.moved_to({"theta1": first, "theta2": last, "b": -mean})
