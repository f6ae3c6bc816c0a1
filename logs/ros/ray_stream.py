"""Cut the rays of a rotating laser into full turns, if its scans begin at another bearing each time.

Some drivers send a scan whenever they have a number of rays, or one sector after the other. The rate of rotation, which the
stamps of successive scans show, gives each ray its time, so that they are sorted into turns as the points of clouds are
(`cloud_turns`). Then each ray has the same bearing, and the same time after its stamp, in all scans.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import tau

import numpy as np
from numpy.typing import NDArray

from logs.ros.cloud_turns import Grid, TurnScans
from logs.ros.laser_scan import ShapeCensus
from logs.ros.point_cloud import turn_messages
from logs.ros.recording import Topic, logged_times
from logs.transforms import wrap
from logs.types import Floats

SHARE = 0.9
"""Share of the scans that must begin where the last one ended; if as many begin at one bearing, nothing is cut."""
SLACK = 2.0
"""[steps] between the end of a scan and the beginning of the next, beyond which rays are missing."""


@dataclass(frozen=True)
class _Stream:
    """The rays of a laser in order of time."""

    stamps: NDArray[np.int64]
    """(n_scans,) [ns]"""
    logged: NDArray[np.int64]
    """(n_scans,) [ns]"""
    lows: Floats
    """(n_scans,) [rad] bearing of the first ray."""
    ranges: list[Floats]
    """n_scans arrays of ranges [m]."""
    intensities: list[Floats]
    """The same of intensities; empty where the driver sent none."""
    limits: Floats
    """(7,) of the first scan."""
    frame: str

    @property
    def step(self) -> float:
        """[rad] between two rays, negative if clockwise."""
        return float(self.limits[2])


def begin_elsewhere(census: ShapeCensus) -> bool:
    """Return whether fewer than `SHARE` of the scans begin at one bearing."""
    shapes = list(census.counts)
    lows = np.repeat([shape.angle_min for shape in shapes], [census.counts[shape] for shape in shapes])
    steps = [abs(shape.increment) for shape in shapes if shape.increment]
    return bool(steps) and _is_spread(np.asarray(lows), float(np.median(steps)))


def _is_spread(lows: Floats, step: float) -> bool:
    """Return whether fewer than `SHARE` of the first bearings agree within `SLACK` steps."""
    angles = np.sort(lows % tau)
    both = np.concatenate([angles, angles + tau])
    most = int(
        (np.searchsorted(both, angles + SLACK * step, side="right") - np.arange(len(angles))).max(initial=0)
    )
    return most < SHARE * len(lows)


def full_turns(topic: Topic) -> tuple[Topic, list[str]]:
    """Return a topic of LaserScan messages cut into full turns, with a note, or unchanged."""
    stream = _stream(topic)
    if stream is None:
        return topic, []
    sign, step = np.sign(stream.step), abs(stream.step)
    n_rays = np.array([len(part) for part in stream.ranges])
    after = sign * wrap(stream.lows[1:] - stream.lows[:-1] - stream.step * n_rays[:-1])
    follows = np.abs(after) <= SLACK * step
    elsewhere = np.abs(wrap(np.diff(stream.lows))) > 0.5 * step  # after a full turn, both are the same
    if follows.mean() < SHARE or elsewhere.mean() < 0.5:
        return topic, []
    advance, seconds = n_rays[:-1] * step + after, np.diff(stream.stamps) / 1e9
    rate = float(np.median(advance[follows] / seconds[follows]))  # [rad/s]
    n = round(tau / step)
    phase = float(np.angle(np.exp(1j * n * stream.lows).mean())) / n
    first = phase + sign * tau / n * np.ceil((-np.pi - sign * phase) * n / tau - 1e-3)  # it looks backwards
    grid = Grid(n, float(first - sign * np.pi / n), int(sign), tau / rate, 1.0)
    turns = TurnScans(grid, np.nan, reach=0.5)
    for k, row in enumerate(stream.ranges):
        along, strengths = np.arange(len(row), dtype=np.float64), stream.intensities[k]
        times = along * step / rate
        turns.add_rays(
            grid.angles(stream.lows[k] + stream.step * along), row,
            strengths if len(strengths) == len(row) else np.full(len(row), np.nan),
            times, (0.0, float(times[-1])), int(stream.stamps[k]), int(stream.logged[k]),
        )  # fmt: skip
    turns.close()
    n_dropped = turns.drop_incomplete()
    low, high = stream.limits[5:].tolist()
    return turn_messages(topic, turns, stream.frame, (low, high)), [
        f"{topic.name}: scans begin where the last one ended, so their rays were cut into {len(turns.scans)} full turns "
        f"of {grid.period:.4g} s ({n_dropped} incomplete turns were left out)"
    ]


def _stream(topic: Topic) -> _Stream | None:
    """Return the rays of a topic; None if its scans begin at one bearing, differ in frame or step, or are in degrees.

    Ranges are decoded only if the scans begin elsewhere.
    """
    blocks = list(topic.blocks())
    if not blocks or len({block.strings["frame_id"] for block in blocks}) > 1:
        return None
    limits = np.concatenate([block["limits"].astype(np.float64) for block in blocks])
    step = float(limits[0, 2])
    if not 0 < abs(step) < 0.5 * np.pi or not np.allclose(limits[:, 2], step, rtol=1e-4, atol=0):
        return None
    if len(limits) < 3 or not _is_spread(limits[:, 0], abs(step)):
        return None
    stamps = np.concatenate([block.stamps_ns for block in blocks])
    index = np.concatenate([block.index for block in blocks])
    ranges = [row for block in blocks for row in block["ranges"].astype(np.float64)]
    if max(map(len, ranges)) * abs(step) > 2 * tau:
        return None
    intensities = [row for block in blocks for row in block["intensities"].astype(np.float64)]
    order = np.lexsort((index, stamps))
    order = order[np.diff(stamps[order], prepend=stamps.min() - 1) > 0]
    if len(order) < 3:
        return None
    return _Stream(
        stamps[order], logged_times(topic)[index[order]], limits[order, 0],
        [ranges[i] for i in order], [intensities[i] for i in order], limits[order[0]],
        blocks[0].strings["frame_id"],
    )  # fmt: skip
