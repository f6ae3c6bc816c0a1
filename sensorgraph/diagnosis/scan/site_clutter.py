"""As what the clutter of a site is booked: by effect, and things that stand free apart from those at a wall.

Where a map has a wall it may be a little off, or lack what leans there, and a model that fits badly puts its largest discs
there. A thing that stands free of all walls and of unknown space is none of that, so that clutter at walls tells nothing
about it.
"""

from __future__ import annotations

import numpy as np

from planners.clearance import Barriers
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import EFFECTS, Amendment

STANDING_FREE = ", standing free"
MEMO_KEY = b"barriers"


def clutter_kind(amendment: Amendment, data: ScanData) -> str:
    """Return the name of an effect, marked where it is a thing that stands free."""
    values = amendment.parameters
    if amendment.effect.place != "spot" or "r" not in values:
        return amendment.name
    if MEMO_KEY not in data.memo:
        data.memo[MEMO_KEY] = Barriers(data.arena)
    barriers = data.memo[MEMO_KEY]
    assert isinstance(barriers, Barriers)
    distance = float(barriers.distances(np.array([[values["x"], values["y"]]]))[0])
    is_free = distance > values["r"] + SCAN.goodness_of_fit.outline_distance
    return amendment.name + (STANDING_FREE if is_free else "")


def kinds_of(name: str) -> tuple[str, ...]:
    """Return the kinds of an effect."""
    return (name, name + STANDING_FREE) if EFFECTS[name].place == "spot" else (name,)


def effect_of(kind: str) -> str:
    """Return the name of the effect of a kind."""
    return kind.removesuffix(STANDING_FREE)
