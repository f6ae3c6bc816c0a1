"""Maps of a run and status of its scans: what is connected, what fits several places, and what nothing determines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.errors import MAX_LISTED
from logs.transforms import compose
from sensorgraph.localization.loop_closures import ClosedTrack
from sensorgraph.localization.result import Status, interval_notes, true_intervals
from sensorgraph.localization.scan_track import ScanTrack, determines_all
from sensorgraph.localization.settings import FRONT_END
from sensorgraph.types import Bools, Floats, Ints

MIN_JOINING_CLOSURES = 2
"""Number of consistent loop closures that join a track segment to the map after a break."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MapStates:
    """Map and status of each scan."""

    status: tuple[Status, ...]
    """(n_scans,)"""
    maps: Ints
    """(n_scans,) Number of the map; 0: none."""
    rivals: dict[int, Floats]
    """Scan -> (n, 3) other places that fit equally well."""
    carried: Floats
    """(n_scans,) [m] Standard deviation of a position that only the odometry determines; 0 elsewhere."""
    open_directions: Floats
    """(n_scans, 3) Unit motion x, y, phi in map that scans do not determine; zeros elsewhere."""
    deviations: Floats
    """(n_scans,) [m, or rad for a turn] Standard deviation along it."""


def map_numbers(tracked: ScanTrack, closed: ClosedTrack, *, by_odometry: bool = True) -> Ints:
    """Return the number of the map of each track segment (n_pieces,): 1 for the largest, then by time.

    Closures of several places connect segments; a single place can look like another, and then like its neighbours too.
    With `by_odometry`, a carried pose does too.
    """
    n_pieces = int(tracked.piece[-1]) + 1
    label = np.arange(n_pieces)
    between = np.zeros((n_pieces, n_pieces), dtype=np.intp)
    ends = np.column_stack([closed.closures.first, closed.closures.second])
    joined = tracked.piece[ends]
    for a, b in np.unique(joined, axis=0):
        own = ends[(joined == [a, b]).all(axis=1)]
        between[a, b] = min(len(np.unique(own[:, 0])), len(np.unique(own[:, 1])))
    carried = tracked.piece[1:][tracked.is_carried & by_odometry]
    between[carried - 1, carried] += MIN_JOINING_CLOSURES
    between += between.T
    for a, b in zip(*np.nonzero(between >= MIN_JOINING_CLOSURES), strict=True):
        label[label == label[b]] = label[a]
    weight = np.bincount(label[tracked.piece], minlength=n_pieces)
    first = int(weight.argmax())
    others = [int(one) for one in dict.fromkeys(label.tolist()) if one != first]
    numbers = {first: 1, **{one: k + 2 for k, one in enumerate(others)}}
    return np.array([numbers[int(one)] for one in label], dtype=np.intp)


def map_states(
    tracked: ScanTrack,
    closed: ClosedTrack,
    poses: Floats,
    covariances: Floats,
    maps: Ints,
    matched: Bools,
    projections: Floats | None,
    *,
    has_odometry: bool,
) -> MapStates:
    """Return map and status of each scan.

    Parameters
    ----------
    poses, covariances : (n_scans, 3), (n_scans, 3, 3)
    maps : (n_pieces,) Number of the map of each track segment.
    matched : (n_scans,) The scan fits its map.
    projections : (n_key, 3, 3) Projection of a motion onto the directions that the key frame determines; None: all.
    """
    left, right, _ = tracked.between_key_frames()
    piece = tracked.piece[left]
    deviations = np.sqrt(np.einsum("nii->ni", covariances))
    is_near = (deviations < FRONT_END.unknown_motion).all(axis=1)
    is_broken = np.append((np.diff(tracked.piece) > 0) & ~tracked.is_carried, False)
    is_carried = ~matched & is_near & ~is_broken[left] & has_odometry
    directions = open_directions(projections, len(tracked.key_frames))
    nearest = np.where(np.abs(directions[left]).sum(axis=1) > 0, left, right)
    directions = directions[nearest]
    along = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", directions, covariances, directions), 0.0))
    is_open = (np.abs(directions).sum(axis=1) > 0) & ~is_near
    rivals, is_ambiguous = _rivals(
        tracked, closed, poses, maps == 1, np.where(matched, piece, tracked.piece[right])
    )
    is_lost = (maps[piece] != 1) | ~(matched | is_carried)
    words = np.where(is_ambiguous | (is_open & ~is_lost), "ambiguous", np.where(is_lost, "lost", "ok"))
    status: tuple[Status, ...] = tuple(words.tolist())
    return MapStates(
        status=status,
        maps=np.where(matched | is_carried, maps[piece], 0),
        rivals=rivals,
        carried=np.where(is_carried, deviations[:, :2].max(axis=1), 0.0),
        open_directions=directions,
        deviations=along,
    )


def open_directions(projections: Floats | None, n: int) -> Floats:
    """Return a unit motion x, y, phi in map (n_key, 3) that each key frame does not determine; zeros if it determines all."""
    out = np.zeros((n, 3))
    if projections is None:
        return out
    for k in np.flatnonzero(~determines_all(projections)):
        free = np.eye(3) - projections[k]
        along = int(np.argmax(np.diag(free)))
        column = free[:, along]
        out[k] = column / (np.hypot(*column[:2]) if along < 2 else column[2])
    return out


def with_unknown_motion(
    covariances: Floats, stamps: Floats, tracked: ScanTrack, projections: Floats | None
) -> Floats:
    """Return the covariances (n_scans, 3, 3) of a run without odometry, at least those of an unknown motion.

    Where no key frame of a track segment determines a direction, as in a corridor, the scans of a driving robot can
    look like those of a standing one. The motion is then up to `speed_sd` times half the duration.
    """
    out, s, (left, _, _) = covariances.copy(), FRONT_END, tracked.between_key_frames()
    directions = open_directions(projections, len(tracked.key_frames))
    for number in np.unique(tracked.piece):
        if not directions[tracked.piece == number].any(axis=1).all():
            continue
        own = np.flatnonzero(tracked.piece[left] == number)
        way = directions[left[own]]
        rate = np.where(np.hypot(way[:, 0], way[:, 1]) > 0.5, s.speed_sd, s.turn_rate_sd)
        least = (rate * (stamps[own].max() - stamps[own].min()) / 2) ** 2
        missing = np.maximum(least - np.einsum("ni,nij,nj->n", way, out[own], way), 0.0)
        out[own] += missing[:, None, None] * way[:, :, None] * way[:, None, :]
    return out


def _rivals(
    tracked: ScanTrack, closed: ClosedTrack, poses: Floats, joined: Bools, piece: Ints
) -> tuple[dict[int, Floats], Bools]:
    """Return the other places (n, 3) in map of some scans, and which scans (n_scans,) they make ambiguous.

    A track segment that no closures join to the other place is ambiguous as a whole. In a joined segment, all scans
    after the submap are ambiguous, unless a later closure in the segment resolves them.

    Parameters
    ----------
    piece : (n_scans,) Track segment of each scan; the next one for scans that fit nowhere.
    """
    closed_maps = map_numbers(tracked, closed, by_odometry=False)
    keys, scans = tracked.key_frames, np.arange(len(poses))
    held = np.concatenate([closed.closures.first, closed.closures.second, [-1]])
    rivals: dict[int, Floats] = {}
    is_ambiguous = np.zeros(len(poses), dtype=np.bool_)
    for one in closed.rivals:
        own = int(tracked.piece[one.newer])
        is_known = joined[tracked.piece[one.older]]
        if is_known.sum() < 2:
            continue
        depends = piece == own
        if closed_maps[own] == closed_maps[tracked.piece[one.older]].max():
            if held[tracked.piece[held] == own].max(initial=-1) > one.newer:
                continue
            depends &= scans >= keys[one.newer]
        rivals[int(keys[one.newer])] = compose(poses[keys[one.older]], one.relative)[is_known]
        is_ambiguous |= depends
    return rivals, is_ambiguous


def state_notes(stamps: Floats, tracked: ScanTrack, states: MapStates) -> tuple[str, ...]:
    """Return notes for the user: breaks of the track, maps, what the odometry determines, ambiguity."""
    notes: list[str] = []
    breaks = np.flatnonzero(np.diff(tracked.piece) > 0)
    if len(breaks):
        times = ", ".join(f"{stamps[tracked.key_frames[k + 1]]:.1f} s" for k in breaks[:MAX_LISTED])
        n = int(tracked.is_carried.sum())
        by = f"; the odometry carried on the pose {n} time{'' if n == 1 else 's'}" if n else ""
        notes.append(
            f"tracking was interrupted {len(breaks)} time{'' if len(breaks) == 1 else 's'} (at {times}){by}"
        )
    notes += _map_notes(stamps, states)
    notes += _carried_notes(stamps, states)
    is_open = (np.array(states.status) == "ambiguous") & (np.abs(states.open_directions).sum(axis=1) > 0)
    for start, stop in true_intervals(is_open)[:MAX_LISTED]:
        k = start + int(np.argmax(states.deviations[start:stop]))
        x, y, _ = states.open_directions[k]
        angle = np.degrees(np.arctan2(y, x)) % 180.0
        what, size = f"the position along {angle:.0f}° in map", f"{states.deviations[k]:.1f} m"
        if np.hypot(x, y) < 0.5:
            what, size = "the heading", f"{min(np.degrees(states.deviations[k]), 180):.0f}°"
        notes.append(
            f"ambiguous from {stamps[start]:.1f} s to {stamps[stop - 1]:.1f} s: scans and odometry do not determine "
            f"{what} (standard deviation up to {size})"
        )
    other: tuple[Status, ...] = tuple(
        "lost" if opened else word for opened, word in zip(is_open, states.status, strict=True)
    )
    return (*notes, *interval_notes(stamps, other, "ambiguous"))


def _map_notes(stamps: Floats, states: MapStates) -> list[str]:
    """Return a note for each map that is not connected to the first."""
    notes = []
    for number in range(2, int(states.maps.max(initial=0)) + 1):
        where = states.maps == number
        if not where.any():
            continue
        times = ", ".join(
            f"{stamps[a]:.1f} to {stamps[b - 1]:.1f} s" for a, b in true_intervals(where)[:MAX_LISTED]
        )
        notes.append(
            f"map {number} ({int(where.sum()):,} scans, {times}) is not connected to map 1: its poses are in a frame of "
            "their own and count as lost"
        )
    return notes


def _carried_notes(stamps: Floats, states: MapStates) -> list[str]:
    """Return a note for each longer interval in which only the odometry determines the pose."""
    notes = []
    for start, stop in true_intervals(states.carried > 0):
        if stamps[stop - 1] - stamps[start] > FRONT_END.patience:
            most = float(states.carried[start:stop].max())
            notes.append(
                f"from {stamps[start]:.1f} s to {stamps[stop - 1]:.1f} s only the odometry determines the pose (standard "
                f"deviation up to {most:.2f} m)"
            )
    return notes[:MAX_LISTED]
