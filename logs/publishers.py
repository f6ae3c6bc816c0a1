"""Separate the poses of several publishers on one topic, as of wheels and of a filter that both publish the odometry.

The poses of one publisher are continuous: each is near the last one, moved on at its velocity. So each pose joins the track
that predicts it best, or begins one. Tracks of two publishers alternate; those of a publisher that restarts follow each other.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import hypot, inf

import numpy as np

from logs.jumps import JUMP_LIMITS
from logs.types import Floats, Ints


@dataclass(frozen=True, kw_only=True)
class PublisherLimits:
    """Limits for the poses of one publisher; conventions, not fitted to data."""

    distance: float = 0.02
    """[m] maximum distance of a pose from its prediction, beyond what `acceleration` explains."""
    acceleration: float = 2.0
    """[m/s²] of a robot indoors, ahead or in a curve."""
    span: float = 0.05
    """[s] minimum time over which a velocity is measured, so that the last pose of another publisher hardly changes it."""
    lever: float = 1.0
    """[m] distance that a turn by one radian counts as: 2 cm are a turn by 1°."""
    share: float = 0.1
    """Minimum share of the messages that a second publisher has."""
    alternating: float = 0.5
    """Minimum number of changes from one publisher to another, per message of the rarer one; it is 2 if each is alone."""
    tracks: int = 50
    """Maximum number of tracks; more are noise, and not publishers."""


PUBLISHER_LIMITS = PublisherLimits()


Pose = tuple[float, float, float]


@dataclass
class _Track:
    """The poses of one publisher, up to a message."""

    index: list[int] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    poses: list[Pose] = field(default_factory=list)
    before: list[int] = field(default_factory=list)
    """Messages before the first one, of the track from which this one departs: until then, they are of both publishers."""
    since: int = 0
    """Position in the track of the pose from which the velocity is measured."""

    def excess(self, time: float, pose: Pose) -> float:
        """Return the distance [m] of a pose from the predicted one; inf if the robot cannot get there.

        Over a time t from the last pose, whose velocity was measured over tau, an acceleration a adds a t (t + tau) / 2.
        """
        dt, over = time - self.times[-1], self.times[-1] - self.times[self.since]
        last = self.poses[-1]
        way = _step(last, pose)
        if over > 0:
            ahead = _step(self.poses[self.since], last)
            way = tuple(one - step * dt / over for one, step in zip(way, ahead, strict=True))  # type: ignore[assignment]
        off = hypot(way[0], way[1], PUBLISHER_LIMITS.lever * way[2])
        most = PUBLISHER_LIMITS.acceleration * dt * (dt + over) / 2 if over > 0 else JUMP_LIMITS.speed * dt
        return off if off <= PUBLISHER_LIMITS.distance + most else inf

    def distance(self, time: float, pose: Pose) -> float:
        """Return the distance [m] of a pose from the last one; inf if the robot cannot get there."""
        x, y, _ = _step(self.poses[-1], pose)
        off = hypot(x, y)
        return off if off <= PUBLISHER_LIMITS.distance + JUMP_LIMITS.speed * (time - self.times[-1]) else inf

    def add(self, k: int, time: float, pose: Pose) -> None:
        """Add a message."""
        self.index.append(k)
        self.times.append(time)
        self.poses.append(pose)
        while self.since + 1 < len(self.times) and time - self.times[self.since + 1] >= PUBLISHER_LIMITS.span:
            self.since += 1

    def moves(self) -> bool:
        """Tell whether the poses move by more than poses of another publisher that joined this track."""
        return bool(
            (np.ptp(self.poses, axis=0) * [1.0, 1.0, PUBLISHER_LIMITS.lever]).max()
            > 2 * PUBLISHER_LIMITS.distance
        )


def _step(first: Pose, second: Pose) -> Pose:
    x, y, phi = (b - a for a, b in zip(first, second, strict=True))
    return x, y, float(np.pi - (np.pi - phi) % (2 * np.pi))


def of_one_publisher(stamps: Floats, poses: Floats) -> Ints | None:
    """Return the indices of the poses of one of several publishers; None if no two publishers alternate.

    It is the publisher with the most poses of those that move. If it restarts, its poses before and after are joined.

    Parameters
    ----------
    stamps : (n,) [s] in order.
    poses : (n, 3) [m, m, rad]
    """
    tracks = _tracks(stamps, poses)
    if not tracks:
        return None
    tracks.sort(key=lambda track: (not track.moves(), -len(track.index)))
    chosen = list[_Track]()
    for track in tracks:
        if all(_follow(track, other) for other in chosen):
            chosen.append(track)
    is_first = np.zeros(len(stamps), dtype=np.bool_)
    last = -1
    for track in sorted(chosen, key=lambda track: track.index[0]):
        shared = [k for k in track.before if k > last]
        is_first[shared + track.index] = True
        last = track.index[-1]
    fewer = min(int(is_first.sum()), int((~is_first).sum()))
    n_changes = int((is_first[1:] != is_first[:-1]).sum())
    if fewer < PUBLISHER_LIMITS.share * len(stamps) or n_changes < PUBLISHER_LIMITS.alternating * fewer:
        return None
    return np.flatnonzero(is_first)


def _tracks(stamps: Floats, poses: Floats) -> list[_Track] | None:
    """Return the tracks of the poses that are finite; None if there are more than `tracks`."""
    tracks = list[_Track]()
    for k in np.flatnonzero(np.isfinite(poses).all(axis=1)).tolist():
        time, (x, y, phi) = float(stamps[k]), poses[k].tolist()
        off = [track.excess(time, (x, y, phi)) for track in tracks]
        if min(off, default=inf) == inf:
            tracks.append(_Track(before=_shared(tracks, time, (x, y, phi))))
            off.append(0.0)
        tracks[off.index(min(off))].add(k, time, (x, y, phi))
        if len(tracks) > PUBLISHER_LIMITS.tracks:
            return None
    return tracks


def _shared(tracks: list[_Track], time: float, pose: Pose) -> list[int]:
    """Return the messages before a pose that begins a track: those of the nearest track from which the robot gets there."""
    off = [track.distance(time, pose) for track in tracks]
    if min(off, default=inf) == inf:
        return []
    near = tracks[off.index(min(off))]
    return [*near.before, *near.index]


def _follow(one: _Track, other: _Track) -> bool:
    """Tell whether one of two tracks ends before the other begins."""
    return one.index[-1] < other.index[0] or other.index[-1] < one.index[0]
