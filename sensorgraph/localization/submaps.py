"""Submaps: consecutive key frames as one rigid object that can be found again."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from logs.transforms import compose, invert
from sensorgraph.localization.branch_and_bound import MaxPyramid
from sensorgraph.localization.crossed_space import crossed, moved_points
from sensorgraph.localization.likelihood_field import field_of_points
from sensorgraph.localization.line_map import LineMap, line_map, thinned
from sensorgraph.localization.scan_track import ScanTrack, points_in
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.localization.settings import CLOSURES, MATCH, ClosureSettings, LineMatchSettings
from sensorgraph.types import Floats, Ints

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
    n_core: int
    """Number of key frames in the middle that are searched for in other submaps."""
    matching: LineMatchSettings

    @cached_property
    def _core(self) -> slice:
        middle = int(np.flatnonzero(self.key_frames == self.middle)[0])
        return slice(max(middle - self.n_core // 2, 0), middle + self.n_core - self.n_core // 2)

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


def cut_submaps(scans: ScanPoints, track: ScanTrack, settings: ClosureSettings = CLOSURES) -> list[Submap]:
    """Cut a track into overlapping submaps; each lies within one track segment."""
    submaps = []
    matching = MATCH.for_spacing(scans.spacing)
    for piece in np.unique(track.piece):
        own = np.flatnonzero(track.piece == piece)
        last_start = max(len(own) - settings.submap // 2, 1)
        for start in range(0, last_start, settings.submap // 2):
            chosen = own[start : start + settings.submap]
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
                    settings.core,
                    matching,
                )
            )
    return submaps
