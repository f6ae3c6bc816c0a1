"""Places that look alike: where a submap may be as well as where it was found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from logs.transforms import compose, wrap
from sensorgraph.localization.result import Closure
from sensorgraph.localization.settings import ClosureSettings
from sensorgraph.types import Floats, Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class RivalPlaces:
    """Several places where a submap may be: a corridor that looks the same twice."""

    newer: int
    """Number of the key frame in the middle of the submap."""
    older: Ints
    """(n,) numbers of key frames in whose frames the places are."""
    relative: Floats
    """(n, 3) [m, m, rad]"""


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosureCandidate:
    """A place where a submap was sought and something was found."""

    older: int
    """Number of the key frame in the middle of the older submap."""
    closure: Closure
    """With the reason why it is none."""
    information: Floats
    agreement: float
    guess: Floats
    """(3,) [m, m, rad] where it was sought."""
    places: Floats
    """(n, 3) [m, m, rad] in the older submap that fit as well as each other; the best first."""


def rival_places(
    newer: int,
    candidates: Sequence[ClosureCandidate],
    poses: Floats,
    drift: float,
    settings: ClosureSettings,
) -> RivalPlaces | None:
    """Return the places of a submap that fit alike; None: there are no two.

    Parameters
    ----------
    newer : number of the key frame in the middle of the submap
    poses : (n_key, 3) [m, m, rad] of the key frames
    drift : [m] that the track may be off; places farther from where it has the submap are left out
    """
    s = settings
    fitting = [one for one in candidates if not one.closure.reason or len(one.places) > 1]
    best = max((one.agreement for one in fitting), default=0.0)
    older: list[int] = []
    relative: list[Floats] = []
    placed = np.zeros((0, 3))
    for one in fitting:
        for place in one.places:
            in_map = compose(poses[one.older], place)
            way = placed - in_map
            apart = np.where(np.array(older) == one.older, s.rival_apart, s.visits_apart)
            is_other = (np.hypot(way[:, 0], way[:, 1]) > apart) | (np.abs(wrap(way[:, 2])) > s.rival_turn)
            is_near = bool((np.abs(place[:2] - one.guess[:2]) <= drift).all())
            if is_near and one.agreement >= s.rivalry * best and is_other.all():
                older.append(one.older)
                relative.append(place)
                placed = np.vstack([placed, in_map])
    if len(older) < 2:
        return None
    return RivalPlaces(newer=newer, older=np.array(older, dtype=np.intp), relative=np.array(relative))
