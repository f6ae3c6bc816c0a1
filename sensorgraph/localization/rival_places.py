"""Rival places: several places at which a submap fits equally well."""

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
    """Several possible places of a submap, such as two identical corridors."""

    newer: int
    """Number of the key frame in the middle of the submap."""
    older: Ints
    """(n,) Numbers of the key frames in whose frames the places are given."""
    relative: Floats
    """(n, 3) [m, m, rad] Places of the submap in these frames."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosureCandidate:
    """Result of the search for a submap in an older one."""

    older: int
    """Number of the key frame in the middle of the older submap."""
    closure: Closure
    """Closure with the reason for rejection, if any."""
    information: Floats
    agreement: float
    guess: Floats
    """(3,) [m, m, rad] Centre of the search."""
    places: Floats
    """(n, 3) [m, m, rad] Places in the older submap that fit equally well; the best first."""


def rival_places(
    newer: int,
    candidates: Sequence[ClosureCandidate],
    poses: Floats,
    drift: float,
    settings: ClosureSettings,
) -> RivalPlaces | None:
    """Return the places at which a submap fits equally well; None if there are fewer than two.

    Parameters
    ----------
    newer : Number of the key frame in the middle of the submap.
    poses : (n_key, 3) [m, m, rad] Poses of the key frames.
    drift : [m] Expected drift of the track; places farther from the tracked pose are excluded.
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
