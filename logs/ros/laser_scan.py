"""Decode LaserScan messages and convert them to one convention: REP-117, counter-clockwise, at most one turn."""

from __future__ import annotations

import struct
from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from logs.error_codes import blank_error_codes
from logs.errors import LogError
from logs.intensities import is_varied
from logs.no_return import (
    CODE_SEARCH,
    code_below,
    detect_no_return,
    frequent_nans,
    nan_text,
    range_max_text,
    zero_text,
)
from logs.range_limits import beyond_text, lower_limit
from logs.resampling import resample, resampled_text, take_nearest
from logs.ros import cdr
from logs.ros.bearings import (
    are_contradictory,
    are_degrees,
    bearings_of,
    check_filtered,
    seconds_to_first_ray,
    stated_bearings,
)
from logs.ros.recording import Topic, logged_times, sort_stamps
from logs.sensor import median_step
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
    is_doubtful: bool = False
    """Whether the angles of a scan are not finite or contradict each other, so that the whole log is needed."""

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
    intensities: Floats | None = None
    """(n_scans, n_rays) as the driver sent them, nan where it sent none; None: they carry no information."""


@dataclass
class _Group:
    """Messages of one shape."""

    index: list[np.ndarray]
    ranges: list[Floats]
    intensities: list[Floats]
    stated: list[Floats]
    """(n, 7) angle, time and range fields of the messages."""
    frame: str

    @cached_property
    def limits(self) -> Floats:
        """(7,) Their medians: a driver that measures its times states others while its motor starts."""
        stated = np.concatenate(self.stated)
        return np.concatenate(
            [stated[0, :3], np.sort(stated[:, 3:], axis=0)[len(stated) // 2]]
        )  # nan is last

    def bearings(self) -> Floats:
        """Return the bearings (n_rays,) [rad]."""
        return self.bearings_and_notes()[0]

    def bearings_and_notes(self) -> tuple[Floats, list[str]]:
        """Return the bearings (n_rays,) [rad], and notes on angles that contradict each other."""
        return bearings_of(self.limits, self.ranges)


def count_shape(census: ShapeCensus, payload: bytes, encoding: str = "cdr") -> None:
    """Count the shape of one LaserScan; a message that is too short is ignored, as it is refused later."""
    try:
        (length,) = _U4.unpack_from(payload, 12)  # in both encodings
        at = 16 + length
        *limits, n = _LIMITS.unpack_from(payload, at if encoding == "ros1" else at + -(at - 4) % 4)
    except struct.error:
        return
    if not np.isfinite([limits[0], limits[2]]).all() or are_contradictory(n, *limits[:3]):
        census.is_doubtful = True
        return
    census.add(ScanShape(n, limits[0], limits[2]))


def read_scans(
    topic: Topic, no_return: str | None = None, census: ShapeCensus | None = None
) -> list[LaserScans]:
    """Decode the LaserScan messages of a topic, one result per frame; each frame is a separate sensor.

    Scans of other shapes are resampled to the most common bearings of their sensor.

    Parameters
    ----------
    no_return : one of `NO_RETURNS`; None: detected from the frequency of readings
    census : census of the whole log, if the topic holds a piece of it

    Raises
    ------
    LogError : If most scans have no rays, or no bearings.
    """
    stamps = logged_times(topic)
    frames: dict[str, dict[ScanShape, _Group]] = {}
    n_lost = 0
    for block in topic.blocks():
        stamps[block.index] = block.stamps_ns
        frame, n_rays = block.strings["frame_id"].strip("/"), block.places["ranges"].count
        limits = block["limits"].astype(np.float64)
        limits[~np.isfinite(limits[:, 2]), 2] = 0.0  # as if not stated
        pointed = np.isfinite(limits[:, 0])
        n_lost += int((~pointed).sum())
        _, first, which = np.unique(
            np.round(limits[:, [0, 2]], 5), axis=0, return_index=True, return_inverse=True
        )
        for k, i in enumerate(first.tolist()):
            mine = np.flatnonzero((which.ravel() == k) & pointed)
            if not len(mine):
                continue
            shape = ScanShape(n_rays, float(limits[i, 0]), float(limits[i, 2])).rounded()
            groups = frames.setdefault(frame, {})
            group = groups.setdefault(shape, _Group([], [], [], [], frame))
            group.index.append(block.index[mine])
            group.stated.append(limits[mine])
            group.ranges.append(block["ranges"][mine].astype(np.float64))
            group.intensities.append(_intensities(block, mine))
    if n_lost and not frames:
        raise LogError(
            f"{topic.name}: no scan has a finite angle_min; correct the driver, or state the angles in the log"
        )
    stamps = stamps if topic.stamps is None else topic.stamps
    scans = [_sensor_scans(topic, groups, stamps, no_return, census) for groups in frames.values()]
    for sensor in scans if n_lost else ():
        sensor.notes.append(f"{topic.name}: {n_lost} scans whose angle_min is not finite were left out")
    return scans


def _sensor_scans(
    topic: Topic,
    groups: dict[ScanShape, _Group],
    stamps: Stamps,
    no_return: str | None,
    census: ShapeCensus | None,
) -> LaserScans:
    """Return the scans of one sensor with common bearings, in order of time.

    Parameters
    ----------
    stamps : (n,) [ns] times of all messages of the topic
    """
    counts = Counter({shape: sum(map(len, group.index)) for shape, group in groups.items()})
    counts = counts if census is None else census.counts
    most = max(counts, key=lambda shape: counts[shape])
    if most.n_rays == 0:
        raise LogError(f"{topic.name}: most scans have no rays")
    check_filtered(
        topic.name,
        [(len(one), one.shape[1], group.limits) for group in groups.values() for one in group.ranges],
    )
    main = groups.get(most) or next(iter(groups.values()))
    limits = main.limits
    notes: list[str] = []
    parts = [part for group in groups.values() for part in group.ranges]
    notes += blank_error_codes(parts, limits[5], limits[6])
    range_min, range_max, no_return = clean_ranges(parts, (limits[5], limits[6]), no_return, notes)
    if census is not None and most not in groups:
        bearings, angle_notes = stated_bearings(*census.first[most]), list[str]()
    else:
        bearings, angle_notes = main.bearings_and_notes()
    index = np.concatenate([part for group in groups.values() for part in group.index])
    stamps, period = stamps.copy(), median_step(np.sort(stamps[index]), 0.0)
    for group in groups.values():
        later = 1e9 * seconds_to_first_ray(group.bearings(), group.limits[3], bearings, limits[3])
        own = np.concatenate(group.index)
        if abs(later) <= period:
            stamps[own] += np.where(stamps[own] != 0, round(later), 0)
    ranges, intensities = (
        np.concatenate([
            np.concatenate(getattr(group, name))
            if shape == most
            else fitted(np.concatenate(getattr(group, name)), group.bearings(), bearings)
            for shape, group in groups.items()
        ])
        for name, fitted in (("ranges", resample), ("intensities", take_nearest))
    )  # fmt: skip
    in_file = np.argsort(index)
    index = index[in_file]
    at, order, stamp_notes = sort_stamps(
        topic.name, stamps[index], stamps[index] if topic.stamps is not None else logged_times(topic)[index]
    )
    if are_degrees(most.n_rays, most.increment):
        stamp_notes.append(
            f"{topic.name}: the bearings are in degrees, from {limits[0]:.6g} to {limits[1]:.6g}: converted"
        )
    if len(counts) > 1:
        stamp_notes.append(
            f"{topic.name}: {resampled_text([shape.n_rays for shape in counts], list(counts.values()))}"
        )
    same_count = sum(n for shape, n in counts.items() if shape.n_rays == most.n_rays)
    if 2 * counts[most] < same_count:
        stamp_notes.append(
            f"{topic.name}: scans begin at {len(counts)} bearings, so that the times of their rays are not known: poses "
            "are wrong by up to the robot's turn during a scan"
        )
    time_increment, scan_time = limits[3:5].tolist()
    return LaserScans(
        at, ranges[in_file[order]], bearings, time_increment, scan_time, range_min, range_max, main.frame,
        stamp_notes + angle_notes + notes, no_return,
        intensities=intensities[in_file[order]] if is_varied(intensities) else None,
    )  # fmt: skip


def _intensities(block: cdr.MessageColumns, mine: np.ndarray) -> Floats:
    """Return the intensities (m, n_rays) of some messages; nan if a message has none, or not one for each ray."""
    n_rays = block.places["ranges"].count
    if block.places["intensities"].count != n_rays:
        return np.full((len(mine), n_rays), np.nan)
    return np.asarray(block["intensities"][mine], dtype=np.float64)


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
    range_min, lower = lower_limit(parts, range_min, range_max)
    code = code_below(parts, range_max) if no_return in (None, "range_max") else None
    if code is not None and detect_no_return(parts, range_max) != "range_max":
        notes.append(f"range_max {range_max:g} m: many ranges are exactly {code:g} m, which was used")
        range_max = code
    if no_return is None:
        no_return = detect_no_return(parts, range_max)
    invalid = [lower, beyond_text(parts, range_max), "" if no_return == "nan" else frequent_nans(parts)]
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
    notes += filter(None, invalid)
    notes += [f"{count} ranges {what}" for what, count in counts.items() if count]
    return range_min, range_max, no_return


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
        if scans.intensities is not None:
            scans.intensities = scans.intensities[:, :n_turn]


def _reverse(scans: LaserScans) -> None:
    """Reverse the order of the rays; the stamp remains that of ray 0.

    A time increment of 0 becomes -0.0, which marks a clockwise sweep.
    """
    scans.bearings, scans.ranges = scans.bearings[::-1].copy(), scans.ranges[:, ::-1].copy()
    if scans.intensities is not None:
        scans.intensities = scans.intensities[:, ::-1].copy()
    last = round((len(scans.bearings) - 1) * scans.time_increment * 1e9)
    scans.stamps, scans.time_increment = scans.stamps + last, -scans.time_increment
