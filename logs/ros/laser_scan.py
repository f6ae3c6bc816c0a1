"""LaserScan messages as drivers send them, brought to one convention: REP-117, counter-clockwise, within a turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.errors import LogError
from logs.ros import cdr
from logs.ros.recording import Topic, settle
from logs.transforms import Stamps, wrap
from logs.types import Floats


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


def read_scans(topic: Topic) -> LaserScans:
    """Decode LaserScan messages; those of another geometry than most are dropped and counted."""
    n = len(topic.payloads)
    blocks = list(cdr.unpack(topic.payloads, topic.type, topic.name, topic.encoding))
    shapes: dict[tuple[int, bytes], int] = {}
    keys = np.empty(n, dtype=object)
    for block in blocks:
        n_rays = block.places["ranges"].count
        for i, limits in zip(block.index.tolist(), block["limits"], strict=True):
            keys[i] = (n_rays, np.round(limits[[0, 2, 5, 6]], 5).tobytes())
    for key in keys.tolist():
        shapes[key] = shapes.get(key, 0) + 1
    best = max(shapes, key=lambda key: shapes[key])
    kept = np.array([key == best for key in keys.tolist()], dtype=np.bool_)
    ranges = np.empty((n, best[0]))
    stamps = np.array(topic.log_times, dtype=np.int64)
    limits, frame = np.zeros(7), ""
    for block in blocks:
        if block.places["ranges"].count != best[0]:
            continue
        ranges[block.index] = block["ranges"]
        stamps[block.index] = block.stamps_ns
        mine = np.flatnonzero(kept[block.index])
        if len(mine):
            limits, frame = block["limits"][mine[0]].astype(np.float64), block.strings["frame_id"].strip("/")
    stamps, order, notes = settle(topic.name, stamps[kept], np.array(topic.log_times, dtype=np.int64)[kept])
    if not kept.all():
        notes.append(f"{topic.name}: {int((~kept).sum())} scans of another geometry than most were dropped")
    angle_min, angle_max, increment, time_increment, scan_time, range_min, range_max = limits.tolist()
    if increment == 0 and best[0] > 1:
        increment = (angle_max - angle_min) / (best[0] - 1)
    if not best[0] or (best[0] > 1 and not abs(increment) > 1e-9):
        raise LogError(
            f"{topic.name}: scans have {best[0]} rays and angle_increment {increment}; no bearings"
        )
    return LaserScans(
        stamps, ranges[kept][order], angle_min + increment * np.arange(best[0]), time_increment, scan_time,
        range_min, range_max, frame, notes,
    )  # fmt: skip


def clean_ranges(scans: LaserScans) -> None:
    """Bring missing returns to REP-117, in place; what was changed is noted.

    A range of exactly 0 is what many drivers send for "no measurement": it tells nothing, so it becomes nan.
    """
    ranges = scans.ranges
    finite = np.isfinite(ranges)
    if not (np.isfinite(scans.range_max) and scans.range_max > max(scans.range_min, 0.0)):
        top = float(ranges[finite].max()) if finite.any() else 1.0
        scans.notes.append(
            f"range_max {scans.range_max:g} makes no sense, the largest range {top:g} m was taken"
        )
        scans.range_max = max(top, 1e-3)
    if not 0 <= scans.range_min < scans.range_max:
        scans.notes.append(f"range_min {scans.range_min:g} makes no sense, 0 was taken")
        scans.range_min = 0.0
    zero, above = ranges == 0, finite & (ranges > scans.range_max)
    broken = finite & (ranges < 0)
    near = finite & (ranges > 0) & (ranges < scans.range_min)
    ranges[zero | broken], ranges[near], ranges[above] = np.nan, -np.inf, np.inf
    for count, what in (
        (int(zero.sum()), "are exactly 0, which tells nothing: nan"),
        (int(broken.sum()), "are negative: nan"),
        (int(near.sum()), f"are below range_min {scans.range_min:g} m: -inf"),
        (int(above.sum()), f"are above range_max {scans.range_max:g} m: +inf"),
    ):
        if count:
            scans.notes.append(f"{count} ranges {what}")


def order_rays(scans: LaserScans, *, upside_down: bool) -> None:
    """Make bearings increase, counter-clockwise seen from above, within a turn, in place."""
    if scans.bearings[-1] < scans.bearings[0]:
        _reverse(scans)
        scans.notes.append("the laser sweeps clockwise: rays were reversed")
    if upside_down:
        scans.bearings = -scans.bearings
        _reverse(scans)
        scans.notes.append("the laser hangs upside down: rays were mirrored")
    n_turn = int(np.searchsorted(scans.bearings, scans.bearings[0] + 2 * np.pi - 1e-4))
    if n_turn < len(scans.bearings):
        scans.notes.append(f"{len(scans.bearings) - n_turn} rays repeat others after a full turn, dropped")
        scans.bearings, scans.ranges = scans.bearings[:n_turn], scans.ranges[:, :n_turn]
    inside = wrap(scans.bearings)
    if np.abs(inside - scans.bearings).max() > 1e-3 and scans.time_increment == 0:
        first = int(np.argmin(inside))
        scans.bearings, scans.ranges = np.roll(inside, -first), np.roll(scans.ranges, -first, axis=1)


def _reverse(scans: LaserScans) -> None:
    """Number the rays from the other end; the stamp stays that of ray 0."""
    scans.bearings, scans.ranges = scans.bearings[::-1].copy(), scans.ranges[:, ::-1].copy()
    if scans.time_increment:
        last = round((len(scans.bearings) - 1) * scans.time_increment * 1e9)
        scans.stamps, scans.time_increment = scans.stamps + last, -scans.time_increment
