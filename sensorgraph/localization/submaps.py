"""Submaps: consecutive key frames as one rigid object that can be found again, and rival places at which one fits equally well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from logs.transforms import compose, invert, wrap
from sensorgraph.localization.branch_and_bound import MaxPyramid
from sensorgraph.localization.likelihood_field import field_of_points
from sensorgraph.localization.line_map import LineMap, line_map, thinned
from sensorgraph.localization.result import Closure
from sensorgraph.localization.scan_track import ScanTrack, points_in
from sensorgraph.localization.scans import ScanPoints, crossed, moved_points
from sensorgraph.localization.settings import CLOSURES, MATCH, LineMatchSettings
from sensorgraph.types import Floats, Ints

SUBMAP = 16
"""Number of key frames of a submap; consecutive submaps overlap by half."""
CORE = 6
"""Number of key frames in the middle of a submap that are searched for in an older one."""
RIVAL_APART = (0.5, 0.17)
"""[m], [rad] Minimum distance or heading difference between the best place in an older submap and a rival."""
VISITS_APART = 2.0
"""[m] Minimum distance between places found in two older visits, which may have drifted relative to each other."""
SEARCH_VOXEL = 0.12
"""[m] Spacing of the search points, matched to the smoothness of the likelihood field."""


@dataclass(frozen=True, eq=False)
class Submap:
    """Consecutive key frames, in the frame of the middle one."""

    scans: ScanPoints
    key_frames: Ints
    """(n,) Consecutive numbers of the key frames."""
    frames: Ints
    """(n,) Scans of the key frames."""
    middle: int
    """Number of the key frame that defines the frame."""
    poses: Floats
    """(n, 3) [m, m, rad] Poses in the frame of the middle one."""
    matching: LineMatchSettings

    @cached_property
    def _core(self) -> slice:
        middle = int(np.flatnonzero(self.key_frames == self.middle)[0])
        return slice(max(middle - CORE // 2, 0), middle + CORE - CORE // 2)

    @cached_property
    def points(self) -> tuple[Floats, Floats]:
        """Points and normals (n, 2) of all key frames."""
        return thinned(*points_in(self.scans, self.frames, self.poses))

    @cached_property
    def core_points(self) -> tuple[Floats, Floats]:
        """Points and normals (n, 2) of the key frames in the middle."""
        core = self._core
        return thinned(*points_in(self.scans, self.frames[core], self.poses[core]))

    @cached_property
    def search_points(self) -> Floats:
        """Thinned `core_points` (n, 2) for the search."""
        return thinned(*self.core_points, SEARCH_VOXEL)[0]

    @cached_property
    def pyramid(self) -> MaxPyramid:
        """Likelihood field for the search."""
        return MaxPyramid(field=field_of_points(self.points[0]))

    def forget_pyramid(self) -> None:
        """Free the memory of the likelihood field; it is built again on the next access."""
        self.__dict__.pop("pyramid", None)

    @cached_property
    def surfaces(self) -> LineMap:
        """Line map."""
        return line_map(*self.points, side=self.matching.first_radius)

    def sees_through(self, other: Submap, relative: Floats, margin: float) -> float:
        """Return the share of another submap's points, at `relative`, in space that rays of this one crossed.


        Only points visible from the key frames in the middle count. A point near a surface of this submap is
        not crossed: along a wall, a small heading error displaces the end of a ray far.
        """
        points = moved_points(other.points[0], relative)
        is_alone = self.pyramid.field.at(points) == 0
        in_view, through = np.zeros(len(points), dtype=np.bool_), np.zeros(len(points), dtype=np.bool_)
        for frame, pose in zip(self.frames[self._core], self.poses[self._core], strict=True):
            own = self.scans.of(int(frame))
            if own.stop - own.start >= 8:
                seen, gone = crossed(points, pose, self.scans, own, margin)
                in_view |= seen
                through |= gone
        return float((through & is_alone).sum() / max(int(in_view.sum()), 1))


def cut_submaps(scans: ScanPoints, track: ScanTrack, size: int = SUBMAP) -> list[Submap]:
    """Cut a track into submaps of `size` key frames that overlap by half; each lies within one track segment."""
    submaps = []
    matching = MATCH.for_spacing(scans.spacing)
    for piece in np.unique(track.piece):
        own = np.flatnonzero(track.piece == piece)
        last_start = max(len(own) - size // 2, 1)
        for start in range(0, last_start, size // 2):
            chosen = own[start : start + size]
            middle = int(chosen[len(chosen) // 2])
            poses = track.poses[track.key_frames[chosen]]
            origin = track.poses[track.key_frames[middle]]
            submaps.append(
                Submap(
                    scans,
                    chosen,
                    track.key_frames[chosen],
                    middle,
                    compose(invert(np.broadcast_to(origin, poses.shape)), poses),
                    matching,
                )
            )
    return submaps


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
    newer: int, candidates: Sequence[ClosureCandidate], poses: Floats, drift: float
) -> RivalPlaces | None:
    """Return the places at which a submap fits equally well; None if there are fewer than two.

    Parameters
    ----------
    newer : Number of the key frame in the middle of the submap.
    poses : (n_key, 3) [m, m, rad] Poses of the key frames.
    drift : [m] Expected drift of the track; places farther from the tracked pose are excluded.
    """
    fitting = [one for one in candidates if not one.closure.reason or len(one.places) > 1]
    best = max((one.agreement for one in fitting), default=0.0)
    older: list[int] = []
    relative: list[Floats] = []
    placed = np.zeros((0, 3))
    for one in fitting:
        for place in one.places:
            in_map = compose(poses[one.older], place)
            way = placed - in_map
            apart = np.where(np.array(older) == one.older, RIVAL_APART[0], VISITS_APART)
            is_other = (np.hypot(way[:, 0], way[:, 1]) > apart) | (np.abs(wrap(way[:, 2])) > RIVAL_APART[1])
            is_near = bool((np.abs(place[:2] - one.guess[:2]) <= drift).all())
            if is_near and one.agreement >= CLOSURES.rivalry * best and is_other.all():
                older.append(one.older)
                relative.append(place)
                placed = np.vstack([placed, in_map])
    if len(older) < 2:
        return None
    return RivalPlaces(newer=newer, older=np.array(older, dtype=np.intp), relative=np.array(relative))
