"""Submaps: some key frames in a row, rigid, as one thing that can be found again."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from logs.transforms import compose, invert
from sensorgraph.localization.branch_and_bound import MaxPyramid
from sensorgraph.localization.front_end import ScanTrack, points_in
from sensorgraph.localization.likelihood_field import field_of_points
from sensorgraph.localization.line_map import LineMap, line_map, thinned
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.localization.settings import CLOSURES, MATCH, ClosureSettings, LineMatchSettings
from sensorgraph.types import Bools, Floats, Ints

SEARCH_VOXEL = 0.12
"""[m] between the points that are sought: as fine as the likelihood field is smooth."""

MAX_GAP = float(np.radians(3.0))
"""[rad] between neighbouring returns, above which nobody knows what lies between."""


@dataclass(frozen=True, eq=False)
class Submap:
    """Key frames in a row, in the frame of the one in the middle."""

    scans: ScanPoints
    key_frames: Ints
    """(n,) numbers of the key frames, in a row."""
    frames: Ints
    """(n,) their scans."""
    middle: int
    """Number of the key frame whose frame it is."""
    poses: Floats
    """(n, 3) [m, m, rad] in the middle's frame."""
    seen: int
    """Key frames in the middle that are sought in other submaps."""
    matching: LineMatchSettings

    @cached_property
    def _core(self) -> slice:
        middle = int(np.flatnonzero(self.key_frames == self.middle)[0])
        return slice(max(middle - self.seen // 2, 0), middle + self.seen - self.seen // 2)

    @cached_property
    def points(self) -> tuple[Floats, Floats]:
        """Points and normals (n, 2) of all its key frames."""
        return thinned(*points_in(self.scans, self.frames, self.poses))

    @cached_property
    def core_points(self) -> tuple[Floats, Floats]:
        """Points and normals (n, 2) of the key frames in the middle."""
        core = self._core
        return thinned(*points_in(self.scans, self.frames[core], self.poses[core]))

    @cached_property
    def search_points(self) -> Floats:
        """Few points (n, 2) that stand for `core_points`."""
        return thinned(*self.core_points, SEARCH_VOXEL)[0]

    @cached_property
    def pyramid(self) -> MaxPyramid:
        """Its likelihood field."""
        return MaxPyramid(field=field_of_points(self.points[0]))

    def forget_pyramid(self) -> None:
        """Free the memory of the likelihood field; it is made again when it is asked for."""
        self.__dict__.pop("pyramid", None)

    @cached_property
    def surfaces(self) -> LineMap:
        """Its lines."""
        return line_map(*self.points, side=self.matching.first_radius)

    def sees_through(self, other: Submap, relative: Floats, margin: float) -> float:
        """Return the share of another's points (its middle at `relative`) that lie where rays of this one went through.

        Only points in view of the key frames in the middle count, and only those far from any surface of this submap
        were gone through: along a wall, a slightly wrong heading moves the end of a ray far.
        """
        points = _moved(other.points[0], relative)
        is_alone = self.pyramid.field.at(points) == 0
        in_view, through = np.zeros(len(points), dtype=np.bool_), np.zeros(len(points), dtype=np.bool_)
        for frame, pose in zip(self.frames[self._core], self.poses[self._core], strict=True):
            own = self.scans.of(int(frame))
            if own.stop - own.start >= 8:
                seen, gone = _through(points, pose, self.scans, own, margin)
                in_view |= seen
                through |= gone
        return float((through & is_alone).sum() / max(int(in_view.sum()), 1))


def _through(
    points: Floats, pose: Floats, scans: ScanPoints, own: slice, margin: float
) -> tuple[Bools, Bools]:
    """Tell which of the points (n, 2) are in view of a scan, and which of these its rays went through."""
    start = scans.starts[own].mean(axis=0)
    rays = scans.points[own] - start
    bearing, length = np.arctan2(rays[:, 1], rays[:, 0]), np.hypot(*rays.T)
    order = np.argsort(bearing)
    bearing, length = bearing[order], length[order]
    local = _moved(points, invert(pose)) - start
    at, far = np.arctan2(local[:, 1], local[:, 0]), np.hypot(*local.T)
    right = np.searchsorted(bearing, at)
    inside = (right > 0) & (right < len(bearing))
    right = np.clip(right, 1, len(bearing) - 1)
    is_near = bearing[right] - bearing[right - 1] < MAX_GAP
    in_view = inside & is_near & (far < np.maximum(length[right], length[right - 1]) + margin)
    through = in_view & (far < np.minimum(length[right], length[right - 1]) - margin)
    return in_view, through


def _moved(points: Floats, pose: Floats) -> Floats:
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    moved: Floats = points @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]
    return moved


def cut_submaps(scans: ScanPoints, track: ScanTrack, settings: ClosureSettings = CLOSURES) -> list[Submap]:
    """Cut a track into submaps that overlap; none runs across two pieces of track."""
    submaps = []
    matching = MATCH.for_spacing(scans.spacing)
    for piece in np.unique(track.piece):
        own = np.flatnonzero(track.piece == piece)
        last_start = max(len(own) - settings.submap // 2, 1)
        for start in range(0, last_start, settings.step):
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
                    settings.seen,
                    matching,
                )
            )
    return submaps
