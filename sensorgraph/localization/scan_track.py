"""`ScanTrack` and `TrackerState`: the result of the laser odometry, and what it knows after a scan; points and turns of poses."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sensorgraph.localization.line_map import LineMap
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.localization.settings import MATCH
from sensorgraph.localization.wheels import WheelEstimate, slip_of
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

    def between_key_frames(self) -> tuple[Ints, Ints, Floats]:
        """Return the key frames before and after each scan (n_scans,), and the share (n_scans,) of its way from one to the other.

        Between two track segments that nothing connects the motion is unknown: the share is 0.
        """
        keys, index = self.key_frames, np.arange(len(self.poses))
        left = np.clip(np.searchsorted(keys, index, side="right") - 1, 0, len(keys) - 1)
        right = np.minimum(left + 1, len(keys) - 1)
        is_joined = (self.piece[left] == self.piece[right]) | np.append(self.is_carried, False)[left]
        share = np.clip((index - keys[left]) / np.maximum(keys[right] - keys[left], 1), 0.0, 1.0)
        return left, right, share * (is_joined & (right > left))


@dataclass
class TrackerState:
    """State of the tracker."""

    wheels: WheelEstimate | None
    key_frames: list[int] = field(default_factory=list)
    piece: list[int] = field(default_factory=list)
    edges: list[Floats] = field(default_factory=list)
    motion_deviations: list[Floats] = field(default_factory=list)
    is_carried: list[bool] = field(default_factory=list)
    projections: list[Floats] = field(default_factory=list)
    determined_at: float = 0.0
    """[s] Stamp of the last key frame whose scan determines all directions, or of the first one."""
    jumps: list[int] = field(default_factory=list)
    surfaces: LineMap | None = None
    last_matched: int = 0
    """Last matched scan."""
    agreement: float = 0.0
    """Share of its points that fit the key frames."""
    usual_agreement: float = 0.5
    """Moving average of this share."""
    failures: list[int] = field(default_factory=list)
    """Scans without a match since then."""
    last_unmatched: tuple[int, LineMap] | None = None
    """The last of these, and the surfaces that it observed."""
    velocity: Floats = field(default_factory=lambda: np.zeros(3))
    """[m/s, m/s, rad/s] Velocity in base_link from the last two matches."""
    slip: Floats = field(default_factory=lambda: np.zeros(3))
    """[m/s, m/s, rad/s] Error of the odometry's speed at the last match, if it slips; otherwise zero."""

    def learn_slip(self, off: Floats, deviations: Floats | None, since: float) -> None:
        """Take the error (3,) [m, m, rad] of a prediction over `since` [s] as slip, if it is beyond the odometry's noise.

        Slip lasts, as of a robot that is pushed or that spins its wheels: the next prediction has this error as its deviation.
        """
        if deviations is None or self.wheels is None:
            return
        noise = np.sqrt(np.maximum(deviations**2 - (self.slip * since) ** 2, 0.0))
        self.slip = slip_of(off, noise) / since


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
    turns[..., 0, 0], turns[..., 0, 1] = cos, -sin
    turns[..., 1, 0], turns[..., 1, 1], turns[..., 2, 2] = sin, cos, 1.0
    return turns


def step_derivatives(first: Floats, second: Floats) -> tuple[Floats, Floats]:
    """Return the derivatives (n, 3, 3) of inv(x_a) ∘ x_b by x_a and by x_b, poses (n, 3) in map axes."""
    by_second = turn_matrices(-first[:, 2])
    by_first, way = -by_second, second[:, :2] - first[:, :2]
    cos, sin = np.cos(first[:, 2]), np.sin(first[:, 2])
    by_first[:, 0, 2] = -sin * way[:, 0] + cos * way[:, 1]
    by_first[:, 1, 2] = -cos * way[:, 0] - sin * way[:, 1]
    return by_first, by_second


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
