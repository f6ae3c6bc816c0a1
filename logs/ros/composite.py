"""Combine several sensors into one: each ray keeps the mount of its sensor, and each reading its time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from logs.ros.laser_scan import LaserScans
from logs.transforms import wrap
from logs.types import Floats

SAME_SCAN_NS = 500_000
"""[ns] maximum time between readings of different sensors that form one scan."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CompositeRays:
    """The combined rays of several sensors, in base_link."""

    scans: LaserScans
    origins: Floats
    """(n_rays, 2) [m] origin of each ray."""
    cones: Floats
    """(n_rays,) [rad] opening angle of each ray."""
    delays: Floats
    """(n_rays,) [s] time of each ray after the stamp of its scan; (0,) if no sensor sweeps."""


def join_restarted(
    parts: Sequence[LaserScans], mounts: Sequence[Floats], names: Sequence[str]
) -> dict[int, LaserScans]:
    """Join the scans of a driver that was started again with another frame name.

    Two sensors cannot have one mount, so parts with the same mount, bearings and times of rays are one.

    Returns
    -------
    Index of the first part of each sensor -> all scans of the sensor
    """
    out: dict[int, LaserScans] = {}
    for i, (part, mount, name) in enumerate(zip(parts, mounts, names, strict=True)):
        k = next((k for k, other in out.items() if _are_one((other, mounts[k]), (part, mount))), None)
        if k is None:
            out[i] = part
            continue
        stamps = np.concatenate([out[k].stamps, part.stamps])
        order = np.argsort(stamps, kind="stable")
        out[k] = replace(
            out[k],
            stamps=stamps[order],
            ranges=np.concatenate([out[k].ranges, part.ranges])[order],
            intensities=_joined_intensities(out[k], part, order),
            notes=[
                *out[k].notes,
                *part.notes,
                f"{name} is the same laser under another name: its scans were joined",
            ],
        )
    return out


def _are_one(one: tuple[LaserScans, Floats], other: tuple[LaserScans, Floats]) -> bool:
    """Return whether two parts with their mounts have the same place, bearings and times of rays."""
    (a, at), (b, there) = one, other
    if a.cone or b.cone or a.bearings.shape != b.bearings.shape or a.time_increment != b.time_increment:
        return False
    apart = np.append(at[:2] - there[:2], wrap(at[2] - there[2]))
    return bool(np.allclose(apart, 0.0, atol=1e-3) and np.allclose(a.bearings, b.bearings, atol=1e-5))


def _joined_intensities(a: LaserScans, b: LaserScans, order: np.ndarray) -> Floats | None:
    if a.intensities is None and b.intensities is None:
        return None
    both = [np.full(p.ranges.shape, np.nan) if p.intensities is None else p.intensities for p in (a, b)]
    return np.asarray(np.concatenate(both)[order])


def combine(parts: Sequence[LaserScans], mounts: Sequence[Floats], names: Sequence[str]) -> CompositeRays:
    """Return one sensor in base_link with the rays of all parts, sorted by bearing.

    A scan contains the readings of the sensors that measured at its time; the other rays are nan (not measured).

    Parameters
    ----------
    mounts : (3,) [m, m, rad] mount of each part in base_link
    names : names of the parts for the notes
    """
    bearings = np.concatenate(
        [wrap(part.bearings + mount[2]) for part, mount in zip(parts, mounts, strict=True)]
    )
    delays = np.concatenate([part.time_increment * np.arange(len(part.bearings)) for part in parts])
    owner = np.repeat(np.arange(len(parts)), [len(part.bearings) for part in parts])
    order = np.argsort(bearings, kind="stable")
    stamps = np.concatenate([part.stamps for part in parts])
    by_time = np.argsort(stamps, kind="stable")
    sensor = np.repeat(np.arange(len(parts)), [len(part.stamps) for part in parts])
    row = np.empty(len(stamps), dtype=np.intp)
    row[by_time] = _rows(stamps[by_time], sensor[by_time])
    n_rows = int(row.max(initial=-1)) + 1
    ranges, intensities = np.full((2, n_rows, len(bearings)), np.nan)
    first = 0
    for k, part in enumerate(parts):
        mine = row[first : first + len(part.stamps)]
        ranges[np.ix_(mine, np.flatnonzero(owner == k))] = part.ranges
        if part.intensities is not None:
            intensities[np.ix_(mine, np.flatnonzero(owner == k))] = part.intensities
        first += len(part.stamps)
    notes = [note for part in parts for note in part.notes]
    notes.append(f"{len(parts)} sensors are read as one, each with its own mount: {', '.join(names)}")
    starts = np.full(n_rows, np.iinfo(np.int64).max)
    np.minimum.at(starts, row, stamps)
    codes = {part.no_return for part in parts} - {"inf"}
    merged = LaserScans(
        starts, ranges[:, order], bearings[order], 0.0, max(part.scan_time for part in parts),
        min(part.range_min for part in parts), max(part.range_max for part in parts), "",
        list(dict.fromkeys(notes)), codes.pop() if len(codes) == 1 else "inf",
        intensities=intensities[:, order] if any(part.intensities is not None for part in parts) else None,
    )  # fmt: skip
    return CompositeRays(
        scans=merged,
        origins=np.array([mounts[k][:2] for k in owner[order]]),
        cones=np.array([parts[k].cone for k in owner[order]]),
        delays=delays[order] if delays.any() else np.zeros(0),
    )


def _rows(stamps: np.ndarray, sensor: np.ndarray) -> np.ndarray:
    """Return the scan index of each reading in time order; a new scan starts after a delay or a repeated sensor."""
    out = np.empty(len(stamps), dtype=np.intp)
    row, start, seen = -1, 0, set[int]()
    for i, (at, who) in enumerate(zip(stamps.tolist(), sensor.tolist(), strict=True)):
        if row < 0 or at - start > SAME_SCAN_NS or who in seen:
            row, start, seen = row + 1, at, set()
        seen.add(who)
        out[i] = row
    return out
