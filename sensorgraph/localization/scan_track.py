"""`ScanTrack`: the result of the laser odometry; points, turns and information of its poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.localization.scans import ScanPoints
from sensorgraph.localization.settings import MATCH
from sensorgraph.localization.wheels import WheelEstimate
from sensorgraph.types import Bools, Floats, Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanTrack:
    """Tracked scans: accurate from one scan to the next, with drift over long distances."""

    poses: Floats
    """(n_scans, 3) [m, m, rad] base_link in the frame of the first scan."""
    matched: Bools
    """(n_scans,) The scan fits the preceding key frames, or has hardly moved from the last that does."""
    is_continuous: Bools
    """(n_scans,) The scan continues the view of the previous one. Otherwise the motion between them is not
    known, or only seems to be: a similar place fits too."""
    key_frames: Ints
    """(n_key,) Scans of the map."""
    piece: Ints
    """(n_key,) Number of the track segment; scans do not determine the motion between two segments."""
    edge_information: Floats
    """(n_key - 1, 3, 3) Information of each key frame's pose in the frame of the previous one."""
    motion_deviations: Floats
    """(n_key - 1, 3) [m, m, rad] Standard deviations of this motion without the scans: ahead, left, turn."""
    is_carried: Bools
    """(n_key - 1,) The odometry carries the pose into a new track segment."""
    projections: Floats
    """(n_key, 3, 3) Projection of a motion ahead, left and turn onto the directions that the scan determines."""
    jumps: tuple[int, ...]
    """Scans before which the odometry jumped."""
    noise: Floats
    """(n_scans,) [m] Scatter of a scan's returns around the surfaces of the preceding key frames; nan: not
    matched."""
    wheels: WheelEstimate | None

    def within(self, steps: Bools) -> Bools:
        """Tell which scans (n_scans,) lie within some of the steps (n_key - 1,) from key frame to key frame."""
        left = np.clip(np.searchsorted(self.key_frames, np.arange(len(self.poses))) - 1, 0, None)
        return np.append(steps, False)[left]


def points_in(scans: ScanPoints, chosen: list[int] | Ints, poses: Floats) -> tuple[Floats, Floats]:
    """Return points and normals (n, 2) of some scans, transformed by their poses (n_chosen, 3)."""
    points, normals = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for scan, (x, y, phi) in zip(chosen, poses, strict=True):
        turn = np.array([[np.cos(phi), np.sin(phi)], [-np.sin(phi), np.cos(phi)]])
        points.append(scans.points[scans.of(scan)] @ turn + (x, y))
        normals.append(scans.normals[scans.of(scan)] @ turn)
    return np.concatenate(points), np.concatenate(normals)


def is_covered(scans: ScanPoints, k: int) -> bool:
    """Tell whether all returns of scan k are within the match radius, as with a covered laser."""
    return bool((scans.ranges[scans.of(k)] < MATCH.first_radius).all())


def turn_matrices(phi: Floats) -> Floats:
    """Return the matrices (..., 3, 3) that turn a motion ahead, left and turn at headings phi (...) into x, y, phi in map."""
    cos, sin = np.cos(phi), np.sin(phi)
    turns = np.zeros((*np.shape(phi), 3, 3))
    turns[..., 0, 0], turns[..., 0, 1], turns[..., 1, 0], turns[..., 1, 1], turns[..., 2, 2] = (
        cos,
        -sin,
        sin,
        cos,
        1.0,
    )
    return turns


def information_at(pose: Floats, deviations: Floats) -> Floats:
    """Return the information (3, 3) of x, y, phi in map, given standard deviations (3,) ahead, left and in heading."""
    turn = turn_matrices(pose[2])
    return (turn * deviations**-2.0) @ turn.T


def determines_all(projections: Floats) -> Bools:
    """Tell which scans determine all directions, by their projections (..., 3, 3)."""
    return np.asarray(np.trace(projections, axis1=-2, axis2=-1) > 2.5)


def settled(projections: Floats, neighbours: int = 4) -> Floats:
    """Return projections (n_key, 3, 3) in which most of the neighbouring key frames agree with an open direction.

    Where most of the key frames before and after one do not determine a direction, it does not either: by chance, the errors of
    the returns look like a shape of the walls. A real shape is seen from several key frames.

    Parameters
    ----------
    projections : (n_key, 3, 3) Projection of a motion ahead, left and turn onto the directions that a key frame determines.
    neighbours : Number of key frames before, and after.
    """
    out, is_open = projections.copy(), ~determines_all(projections)
    among = np.flatnonzero(is_open)
    total = np.concatenate([[0], np.cumsum(is_open)])
    for k in np.flatnonzero(~is_open).tolist():
        start, stop = max(k - neighbours, 0), min(k + neighbours + 1, len(out))
        if 2 * (total[stop] - total[start]) > stop - start:
            out[k] = projections[among[np.abs(among - k).argmin()]]
    return out
