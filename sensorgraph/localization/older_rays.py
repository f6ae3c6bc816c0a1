"""Rays that are older than the others of their scan, as where a node merges two lasers: found from the run itself.

The field of view has `SECTORS` parts. The times of the rays in each, relative to the first part, are estimated as those of a
sweep are (`turning_pieces`). Two merged lasers have times with one step at each end of a part: of the normal equations
M c = g of the sectors, the part b with the largest

    gain(b) = (b'g)² / b'M b

must explain `MIN_EXPLAINED` of g'M⁻¹g at every step. No part explains more than 3/4 of a sweep, which is a ramp, nor of wrong
bearings. A part that is far off starts with the time at which most of its points match the others.

Points of a part that is 0.2 s older are decimetres from those of the others, where no linearised residual sees them. So
points are counted: C[d, s, t] is the number of points of fine sector s, with its rays d later, in cells that have points of
sector t from other frames. If a part b of the fine sectors is d later than the others, its count rises most:

    count(b, d) = sum over s in b, t not in b of C[d, s, t] + C[-d, t, s] - C[0, s, t] - C[0, t, s]
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from logs.motion import Motion
from logs.run import RangeSensor
from sensorgraph.localization.line_map import bucket_key
from sensorgraph.localization.point_rows import FramePoints
from sensorgraph.localization.scan_lag import MIN_LAG, N_STEPS
from sensorgraph.localization.scans import scan_points
from sensorgraph.localization.turning_pieces import (
    MAX_STEPS,
    MIN_GAIN,
    LinearisedPieces,
    TimeEstimate,
    TurningPieces,
)
from sensorgraph.types import Bools, Floats, Ints

SECTORS = 12
"""Number of parts of the field of view."""
ENDS = 20
"""Number of groups of rays about each end of a part, of which each gets its own time."""
MIN_EXPLAINED = 0.8
"""Share of the gain of all sectors that a part must explain."""
FINE_SECTORS = 48
"""Number of sectors in which points are counted. Ends of a part within larger ones hide it."""
CELL = 0.1
"""[m] Side of a cell: noise and curvature of the track stay within it, 50 ms of a turn do not."""
TIMES = np.arange(-6, 7) * 0.05
"""(13,) [s] Times that are tried."""


def _parts(n: int) -> Bools:
    """Return the parts (n_parts, n) of n sectors that do not hold the first one."""
    ends = [(first, end) for first in range(1, n) for end in range(first + 1, n + 1)]
    return np.array([(first <= np.arange(n)) & (end > np.arange(n)) for first, end in ends])


_PATTERNS = _parts(SECTORS)[:, 1:].astype(np.float64)
_PARTS = _parts(FINE_SECTORS)


@dataclass(frozen=True, kw_only=True, eq=False)
class OlderRays:
    """A part of the rays that is older than the others."""

    sensor: RangeSensor
    """With the times of its rays."""
    rays: Bools
    """(n_rays,) the older ones."""
    age: float
    """[s]"""
    stderr: float
    """[s]"""

    @property
    def line(self) -> str:
        """One line for the user."""
        part = self.rays if not (self.rays[0] and self.rays[-1]) else ~self.rays
        first, last = np.degrees(self.sensor.bearings[np.flatnonzero(part)[[0, -1]]])
        which = "rays from" if part is self.rays else "rays not from"
        return (
            f"the {which} {first:.0f}° to {last:.0f}° are {1e3 * self.age:.0f} ± {1e3 * self.stderr:.1f} ms older than the "
            "others of their scan, as where two lasers are merged: corrected"
        )


def identify_older_rays(
    sensor: RangeSensor, pieces: TurningPieces, start: LinearisedPieces, motion: Motion, widening: float
) -> OlderRays | None:
    """Return the part of the rays that is older than the others; None if the run shows none.

    Parameters
    ----------
    start : `pieces`, linearised at the ray times of the sensor.
    motion : Motion of base_link, from the odometry or the track.
    widening : Factor of the covariances, as there are few pieces.
    """
    if sensor.n_rays < 2 * SECTORS:
        return None
    part, time = best_part(pieces, start.poses, sensor.ray_delays, motion)
    sector = _sectors(part) if time else np.arange(sensor.n_rays) * SECTORS // sensor.n_rays
    rays = _Rays(sensor=sensor, pieces=pieces, motion=motion)
    basis = (sector[:, None] == np.arange(1, SECTORS)).astype(np.float64)
    values = np.asarray([time * part[np.argmax(column)] for column in basis.T])
    equations = rays.linearised(basis @ values) if time else start
    for _ in range(MAX_STEPS):
        found = equations.estimate(basis)
        values = values + found.change
        best, share = _best_pattern(values, found)
        if (
            np.ptp(np.append(values, 0.0)) < 0.5 * MIN_LAG or share < MIN_EXPLAINED
        ):  # a step finds half, or more
            return None
        if np.abs(found.change).max() < 0.1 * MIN_LAG:
            break
        equations = rays.linearised(basis @ values)
    weights = best @ found.information
    chance = float(weights @ found.covariance @ weights)
    if np.abs(found.change).max() > MIN_LAG or float(weights @ values) ** 2 < widening * MIN_GAIN * chance:
        return None
    is_older = np.append(False, best > 0) == (weights @ values < 0)
    age = _age(np.append(0.0, values), is_older)
    if age < MIN_LAG:
        return None
    older = is_older[sector]
    older = rays.with_sharp_ends(older, age)
    for _ in range(N_STEPS):  # a time for each sector, so that ends that are a few rays off do not matter
        found = rays.linearised(np.where(older, -age, 0.0)).estimate(basis)
        age += _age(np.append(0.0, found.change), is_older)
    delays = sensor.ray_delays - sensor.ray_delays[0] - age * older
    timed = replace(
        sensor, delays=delays - delays[0], first_ray_delay=sensor.first_ray_delay + float(delays[0]),
        sweep_time=0.0, interlaced_sweeps=1, sweep_period=0.0,
    )  # fmt: skip
    stderr = float(np.sqrt(np.median(np.diag(found.covariance))))
    return OlderRays(sensor=timed, rays=older, age=age, stderr=stderr)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Rays:
    """The rays of a sensor in pieces of a track."""

    sensor: RangeSensor
    pieces: TurningPieces
    motion: Motion

    def linearised(self, times: Floats) -> LinearisedPieces:
        """Linearise the pieces at other times (n_rays,) [s]; the latest rays keep theirs, as stamps are those of new scans."""
        return self.pieces.linearised(self.sensor.ray_delays + times - times.max(), self.motion)

    def with_sharp_ends(self, older: Bools, age: float) -> Bools:
        """Return the older rays (n_rays,), with ends that the times of single rays show.

        They are sought a sector to either side of the given ends, and of the ends of the scan.
        """
        n, size = self.sensor.n_rays, self.sensor.n_rays // SECTORS
        inner = np.flatnonzero(np.diff(older.astype(np.int8))) + 1
        ends = [(0, bool(older[0])), *((int(at), bool(older[at])) for at in inner), (n, not older[-1])]
        middles = [0, *((a + b) // 2 for (a, _), (b, _) in pairwise(ends)), n]
        near = [
            np.arange(max(at - size, low), min(at + size, high))
            for (at, _), (low, high) in zip(ends, pairwise(middles), strict=True)
        ]
        step = max(2 * size // ENDS, 1)  # rays of a column
        groups = [rays[first : first + step] for rays in near for first in range(0, len(rays), step)]
        basis = np.zeros((n, len(groups)))
        for k, group in enumerate(groups):
            basis[group, k] = 1.0
        times = np.zeros(len(groups))
        for _ in range(N_STEPS):
            times += self.linearised(basis @ times - np.where(older, age, 0.0)).estimate(basis).change
        beyond = np.zeros(n)  # share of the age beyond half of it
        for group, time in zip(groups, -times / age, strict=True):
            beyond[group] = time + older[group] - 0.5
        out = older.copy()
        for rays, (_, is_begin) in zip(near, ends, strict=True):
            cut_of = np.argmin if is_begin else np.argmax
            cut = int(cut_of(np.concatenate([[0.0], np.cumsum(beyond[rays])])))
            out[rays] = (np.arange(len(rays)) >= cut) == is_begin
        return out


def _best_pattern(values: Floats, found: TimeEstimate) -> tuple[Floats, float]:
    """Return the part (SECTORS - 1,), 1 inside, that explains the times of the sectors [s] best, and its share of their gain."""
    weighted = _PATTERNS @ found.information
    gains = (weighted @ values) ** 2 / (weighted * _PATTERNS).sum(axis=1)
    best = int(np.argmax(gains))
    return _PATTERNS[best], float(gains[best] / (values @ found.information @ values))


def _age(times: Floats, is_older: Bools) -> float:
    """Return by how much some sectors are older than the others [s], from the times of all (SECTORS,)."""
    return float(np.median(times[~is_older]) - np.median(times[is_older]))


def _sectors(part: Bools) -> Ints:
    """Return the number of the sector of each ray (n_rays,), so that a part begins and ends with a sector."""
    ends = np.concatenate([[0], np.flatnonzero(np.diff(part.astype(np.int8))) + 1, [len(part)]])
    sizes = np.diff(ends)
    counts = np.maximum(np.rint(SECTORS * sizes / len(part)), 1).astype(np.intp)
    counts[np.argmax(sizes)] += SECTORS - counts.sum()
    first = np.cumsum(counts) - counts
    zones = [np.arange(size) * n // size + at for size, n, at in zip(sizes, counts, first, strict=True)]
    return np.concatenate(zones)


def best_part(pieces: TurningPieces, poses: Floats, delays: Floats, motion: Motion) -> tuple[Bools, float]:
    """Return the rays (n_rays,) and the time [s] with which they match the others best; 0.0 if no other time is better.

    Parameters
    ----------
    poses : (n_frames, 3) of the pieces.
    delays : (n_rays,) [s]
    """
    sector = np.arange(len(delays)) * FINE_SECTORS // len(delays)
    matches = _matches(pieces, poses, delays, motion, sector)
    inside, outside = _PARTS.astype(np.float64), (~_PARTS).astype(np.float64)
    later = np.einsum("ps,dst,pt->pd", inside, matches, outside, optimize=True)
    found = later + np.einsum("pt,dts,ps->pd", outside, matches[::-1], inside, optimize=True)
    gains = found - found[:, len(TIMES) // 2, None]
    part, time = np.unravel_index(np.argmax(gains), gains.shape)
    return np.asarray(_PARTS[part][sector]), float(TIMES[time]) if gains[part, time] > 0 else 0.0


def _matches(pieces: TurningPieces, poses: Floats, delays: Floats, motion: Motion, sector: Ints) -> Floats:
    """Return the counts M (n_times, FINE_SECTORS, FINE_SECTORS). Even and odd frames are compared with each other."""
    placed = [_cells(pieces, poses, delays + time, motion, sector) for time in TIMES]
    out = np.zeros((len(TIMES), FINE_SECTORS, FINE_SECTORS))
    for is_odd in (False, True):
        cells, odd, sectors = placed[len(TIMES) // 2]
        known, index = np.unique(cells[odd == is_odd], return_inverse=True)
        has = np.zeros((len(known) + 1, FINE_SECTORS))  # the last row is for all other cells
        has[index, sectors[odd == is_odd]] = 1.0
        known = np.append(known, np.iinfo(np.int64).max)
        for count, (cells, odd, sectors) in zip(out, placed, strict=True):
            asked = cells[odd != is_odd]
            at = np.searchsorted(known, asked)
            np.add.at(count, sectors[odd != is_odd], has[np.where(known[at] == asked, at, len(known) - 1)])
    return out


def _cells(
    pieces: TurningPieces, poses: Floats, delays: Floats, motion: Motion, sector: Ints
) -> tuple[Ints, Bools, Ints]:
    """Return the cell of each point, whether its frame is odd, and its sector."""
    scans = scan_points(pieces.run, motion, delays=delays)
    frames = FramePoints.of(scans, np.arange(scans.n_scans))
    x, y = np.floor(frames.placed(poses)[0] / CELL).astype(np.int64).T
    return np.asarray(bucket_key(x, y)), frames.frame % 2 == 1, sector[scans.rays]
