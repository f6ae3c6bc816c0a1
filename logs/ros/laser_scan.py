"""Decode LaserScan messages and convert them to one convention: REP-117, counter-clockwise, at most one turn."""

from __future__ import annotations

import struct
from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from logs.errors import LogError
from logs.no_return import CODE_SEARCH, detect_no_return, frequent_nans, nan_text, range_max_text, zero_text
from logs.resampling import resample, resampled_text
from logs.ros import cdr
from logs.ros.recording import Topic, sort_stamps
from logs.sweep import LIMITS
from logs.transforms import Stamps
from logs.types import Floats

_U4, _LIMITS = struct.Struct("<I"), struct.Struct("<7fI")


class ScanShape(NamedTuple):
    """The bearings of a scan."""

    n_rays: int
    angle_min: float
    """[rad]"""
    increment: float
    """[rad]"""

    def rounded(self) -> ScanShape:
        """Return the shape rounded to 1e-5 rad; shapes with equal rounded values count as one."""
        return ScanShape(self.n_rays, round(self.angle_min, 5), round(self.increment, 5))


@dataclass
class ShapeCensus:
    """The number of scans of each shape in a log."""

    counts: Counter[ScanShape] = field(default_factory=Counter)
    """Rounded shape -> number of scans."""
    first: dict[ScanShape, ScanShape] = field(default_factory=dict)
    """Rounded shape -> first exact shape."""

    def add(self, shape: ScanShape, count: int = 1) -> None:
        """Count scans of a shape."""
        key = shape.rounded()
        self.counts[key] += count
        self.first.setdefault(key, shape)


@dataclass
class LaserScans:
    """Scans of one geometry, as the driver sent them."""

    stamps: Stamps
    ranges: Floats
    bearings: Floats
    time_increment: float
    scan_time: float
    range_min: float
    range_max: float
    frame: str
    notes: list[str]
    no_return: str
    """Encoding of a missing return in the log, one of `NO_RETURNS`."""
    cone: float = 0.0
    """[rad] opening angle of each ray."""


@dataclass
class _Group:
    """Messages of one shape."""

    index: list[np.ndarray]
    ranges: list[Floats]
    limits: Floats
    """(7,) angle, time and range fields of the first message."""
    frame: str

    def bearings(self) -> Floats:
        """Return the bearings (n_rays,) [rad]."""
        angle_min, angle_max, increment = self.limits[:3].tolist()
        n = self.ranges[0].shape[1]
        if increment == 0 and n > 1:
            increment = (angle_max - angle_min) / (n - 1)
        if n > 1 and not abs(increment) > 1e-9:
            raise LogError(
                f"scans have {n} rays and angle_increment {increment}; expected an increment other than 0"
            )
        return _bearings(n, angle_min, increment)


def _bearings(n_rays: int, angle_min: float, increment: float) -> Floats:
    return angle_min + increment * np.arange(n_rays, dtype=np.float64)


def shape_of(payload: bytes) -> ScanShape | None:
    """Return the shape of one LaserScan in CDR; None if the message is too short."""
    try:
        (length,) = _U4.unpack_from(payload, 12)
        at = 16 + length
        *limits, n = _LIMITS.unpack_from(payload, at + -(at - 4) % 4)
    except struct.error:
        return None
    return ScanShape(n, limits[0], limits[2])


def read_scans(topic: Topic, no_return: str | None = None, census: ShapeCensus | None = None) -> LaserScans:
    """Decode LaserScan messages; scans of other shapes are resampled to the most common bearings.

    Parameters
    ----------
    no_return : one of `NO_RETURNS`; None: detected from the frequency of readings
    census : census of the whole log, if the topic holds a piece of it

    Raises
    ------
    LogError : If most scans have no rays, or no bearings.
    """
    n = len(topic.payloads)
    stamps = np.array(topic.log_times, dtype=np.int64)
    groups: dict[ScanShape, _Group] = {}
    for block in cdr.unpack(topic.payloads, topic.type, topic.name, topic.encoding):
        stamps[block.index] = block.stamps_ns
        frame, n_rays = block.strings["frame_id"].strip("/"), block.places["ranges"].count
        limits = block["limits"].astype(np.float64)
        _, first, which = np.unique(
            np.round(limits[:, [0, 2]], 5), axis=0, return_index=True, return_inverse=True
        )
        for k, i in enumerate(first.tolist()):
            mine = np.flatnonzero(which.ravel() == k)
            shape = ScanShape(n_rays, float(limits[i, 0]), float(limits[i, 2])).rounded()
            group = groups.setdefault(shape, _Group([], [], limits[i], frame))
            group.index.append(block.index[mine])
            group.ranges.append(block["ranges"][mine].astype(np.float64))
    counts = Counter({shape: sum(map(len, group.index)) for shape, group in groups.items()})
    counts = counts if census is None else census.counts
    most = max(counts, key=lambda shape: counts[shape])
    if most.n_rays == 0:
        raise LogError(f"{topic.name}: most scans have no rays; check the driver, or select another topic")
    main = groups.get(most) or next(iter(groups.values()))
    limits = main.limits
    notes: list[str] = []
    parts = [part for group in groups.values() for part in group.ranges]
    range_min, range_max, no_return = clean_ranges(parts, (limits[5], limits[6]), no_return, notes)
    bearings = (
        _bearings(*census.first[most]) if census is not None and most not in groups else main.bearings()
    )
    ranges = np.empty((n, most.n_rays))
    for shape, group in groups.items():
        part = np.concatenate(group.ranges)
        ranges[np.concatenate(group.index)] = (
            part if shape == most else resample(part, group.bearings(), bearings)
        )
    stamps, order, stamp_notes = sort_stamps(topic.name, stamps, np.array(topic.log_times, dtype=np.int64))
    if len(counts) > 1:
        stamp_notes.append(
            f"{topic.name}: {resampled_text([shape.n_rays for shape in counts], list(counts.values()))}"
        )
    time_increment, scan_time = limits[3:5].tolist()
    return LaserScans(
        stamps, ranges[order], bearings, time_increment, scan_time, range_min, range_max, main.frame,
        stamp_notes + notes, no_return,
    )  # fmt: skip


def clean_ranges(
    parts: list[Floats], limits: tuple[float, float], no_return: str | None, notes: list[str]
) -> tuple[float, float, str]:
    """Convert readings to REP-117, in place, and append notes on the changes.

    A range of exactly 0 becomes nan, an invalid reading, unless 0 encodes a missing return.

    Parameters
    ----------
    parts : arrays (n_scans, n_rays) [m]
    limits : range_min and range_max [m] as stated by the driver
    no_return : one of `NO_RETURNS`; None: detected from the frequency of readings
    notes : list to which the notes are appended

    Returns
    -------
    range_min and range_max [m] as used, and the encoding of a missing return
    """
    range_min, range_max = map(float, limits)
    if not (np.isfinite(range_max) and range_max > max(range_min, 0.0)):
        top = max((float(part[np.isfinite(part)].max(initial=0.0)) for part in parts), default=0.0) or 1.0
        notes.append(f"range_max {range_max:g} is invalid, the largest range {top:g} m was used")
        range_max = max(top, 1e-3)
    if not 0 <= range_min < range_max:
        notes.append(f"range_min {range_min:g} is invalid, 0 was used")
        range_min = 0.0
    if no_return is None:
        no_return = detect_no_return(parts, range_max)
    invalid = "" if no_return == "nan" else frequent_nans(parts)
    total, at_max, zeros, nans = sum(part.size for part in parts), 0, 0, 0
    counts = Counter[str]()
    for part in parts:
        zero, finite = part == 0, np.isfinite(part)
        full = finite & (np.abs(part - range_max) <= CODE_SEARCH.stated_tolerance)
        above = finite & (part > range_max) & ~full
        broken, near = finite & (part < 0), finite & (part > 0) & (part < range_min)
        if no_return == "nan":
            unread = np.isnan(part)
            part[unread], nans = np.inf, nans + int(unread.sum())
        part[zero | broken], part[near], part[above] = np.nan, -np.inf, np.inf
        if no_return == "range_max":
            part[full], at_max = np.inf, at_max + int(full.sum())
        if no_return == "zero":
            part[zero], zeros = np.inf, zeros + int(zero.sum())
        else:
            counts["are exactly 0, an invalid reading: nan"] += int(zero.sum())
        counts["are negative: nan"] += int(broken.sum())
        counts[f"are below range_min {range_min:g} m: -inf"] += int(near.sum())
        counts[f"are above range_max {range_max:g} m: +inf"] += int(above.sum())
    if no_return == "range_max":
        notes.append(range_max_text(range_max, at_max, total))
    if no_return == "zero":
        notes.append(zero_text(zeros, total))
    if no_return == "nan":
        notes.append(nan_text(nans, total))
    if invalid:
        notes.append(invalid)
    notes += [f"{count} ranges {what}" for what, count in counts.items() if count]
    return range_min, range_max, no_return


def check_sweep(scans: LaserScans) -> None:
    """Set the `time_increment` of a sweep that is longer than the scan period to 0, in place, with a note."""
    steps = np.diff(scans.stamps)
    period = float(np.median(steps)) / 1e9 if len(steps) else 0.0
    sweep = abs(scans.time_increment) * len(scans.bearings)
    if not np.isfinite(sweep) or (period > 0 and sweep > LIMITS.max_periods * period):
        scans.notes.append(
            f"time_increment {scans.time_increment:.3g} s is invalid, {len(scans.bearings)} rays would take "
            f"{sweep:.3g} s of the {period:.3g} s between scans: 0 was used"
        )
        scans.time_increment = 0.0


def order_rays(scans: LaserScans, *, upside_down: bool) -> None:
    """Order the rays by increasing bearing, counter-clockwise from above, over less than one turn, in place.

    A laser whose bearings run from 0 to 2 pi keeps the indices of its rays.
    """
    if scans.bearings[-1] < scans.bearings[0]:
        _reverse(scans)
        scans.notes.append("the laser sweeps clockwise: rays were reversed")
    if upside_down:
        scans.bearings = -scans.bearings
        _reverse(scans)
        scans.notes.append("the laser is mounted upside down: rays were mirrored")
    n_turn = int(np.searchsorted(scans.bearings, scans.bearings[0] + 2 * np.pi - 1e-4))
    if n_turn < len(scans.bearings):
        scans.notes.append(
            f"{len(scans.bearings) - n_turn} rays repeat others after a full turn and were dropped"
        )
        scans.bearings, scans.ranges = scans.bearings[:n_turn], scans.ranges[:, :n_turn]


def _reverse(scans: LaserScans) -> None:
    """Reverse the order of the rays; the stamp remains that of ray 0.

    A time increment of 0 becomes -0.0, which marks a clockwise sweep.
    """
    scans.bearings, scans.ranges = scans.bearings[::-1].copy(), scans.ranges[:, ::-1].copy()
    last = round((len(scans.bearings) - 1) * scans.time_increment * 1e9)
    scans.stamps, scans.time_increment = scans.stamps + last, -scans.time_increment
