"""Find a robot in a known place without a guess: branch and bound, fine matches, and the beam model to judge them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.transforms import compose, invert, wrap
from sensorgraph.localization.branch_and_bound import SearchWindow
from sensorgraph.localization.known_map import KnownMap
from sensorgraph.localization.map_settings import GLOBAL_SEARCH, GlobalSearchSettings
from sensorgraph.localization.matching import match
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.types import Floats, Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class LocalView:
    """Returns of one scan or several, seen from one of them."""

    points: Floats
    """(n, 2) [m] in base_link of that scan."""
    normals: Floats
    """(n, 2) unit normals, or 0, 0."""
    starts: Floats
    """(n, 2) [m] where the rays begin."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GlobalPlaces:
    """Where a view may have been taken, the most probable place first."""

    poses: Floats
    """(n, 3) [m, m, rad] base_link in map."""
    probabilities: Floats
    """(n,) that sum to 1."""
    agreements: Floats
    """(n,) share of the points that lie on surfaces of the map."""
    hidden: Floats
    """(n,) share of the points that walls of the map should have hidden."""

    @property
    def fit(self) -> float:
        """Share of the returns on surfaces at the first place, less `hidden_weight` times those through walls."""
        return (
            float(self.agreements[0] - GLOBAL_SEARCH.hidden_weight * self.hidden[0])
            if len(self.poses)
            else 0.0
        )

    @property
    def rivals(self) -> Floats:
        """(n, 3) other places that cannot be ruled out; none if the first is the place."""
        return self.poses[1:][self.probabilities[1:] > GLOBAL_SEARCH.rival_probability]


def local_view(
    scans: ScanPoints, chosen: Ints, poses: Floats, settings: GlobalSearchSettings = GLOBAL_SEARCH
) -> LocalView:
    """Join scans into a view from the last one, and thin it.

    Parameters
    ----------
    chosen : (n,) scans
    poses : (n, 3) of these in one frame, right from one to the next
    """
    most = max(settings.points // len(chosen), settings.least_points)
    parts: tuple[list[Floats], list[Floats], list[Floats]] = ([], [], [])
    for scan, (x, y, phi) in zip(chosen, compose(invert(poses[-1]), poses), strict=True):
        own = np.arange(scans.first[scan], scans.first[scan + 1])
        own = own[np.unique(np.linspace(0, len(own) - 1, min(most, len(own))).astype(np.intp))]
        turn = np.array([[np.cos(phi), np.sin(phi)], [-np.sin(phi), np.cos(phi)]])
        parts[0].append(scans.points[own] @ turn + (x, y))
        parts[1].append(scans.normals[own] @ turn)
        parts[2].append(scans.starts[own] @ turn + (x, y))
    points, normals, starts = (np.concatenate(part) for part in parts)
    return LocalView(points=points, normals=normals, starts=starts)


def find_places(
    view: LocalView,
    place: KnownMap,
    *,
    window: SearchWindow | None = None,
    settings: GlobalSearchSettings = GLOBAL_SEARCH,
) -> GlobalPlaces:
    """Return where in a window (None: all of the map) a view may have been taken; nothing where it fits nowhere."""
    s = settings
    empty = np.zeros(0)
    none = GlobalPlaces(poses=np.zeros((0, 3)), probabilities=empty, agreements=empty, hidden=empty)
    if len(view.points) < s.least_points:
        return none
    modes = place.pyramid.search(
        view.points,
        place.window if window is None else window,
        heading_step=s.heading_step,
        min_score=s.min_score,
        max_modes=s.max_modes,
        rival_ratio=s.rival_ratio,
        apart=(s.apart, s.apart_turn),
    )
    if len(modes.poses) == 0:
        return none
    found = [match(view.points, view.normals, place.surfaces, pose) for pose in modes.poses]
    poses = np.array([one.pose for one in found])
    likelihoods, hidden = place.judge(poses, view.points, view.starts)
    scores = likelihoods / s.correlation
    order = _distinct(poses, scores, s)
    weights = np.exp(scores[order] - scores[order[0]])
    return GlobalPlaces(
        poses=poses[order],
        probabilities=weights / weights.sum(),
        agreements=np.array([found[k].agreement for k in order]),
        hidden=hidden[order],
    )


def _distinct(poses: Floats, scores: Floats, settings: GlobalSearchSettings) -> Ints:
    """Return the places, the best first, that are not beside a better one."""
    kept: list[int] = []
    for k in np.argsort(-scores, kind="stable"):
        way = poses[kept] - poses[k]
        is_beside = (np.hypot(way[:, 0], way[:, 1]) < settings.apart) & (
            np.abs(wrap(way[:, 2])) < settings.apart_turn
        )
        if not is_beside.any():
            kept.append(int(k))
    return np.array(kept, dtype=np.intp)
